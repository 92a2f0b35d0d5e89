"""How far a loop is from trouble: gain, phase and disk margin, bandwidth, and the step response.

A search asks for thousands of margins, so they are read from one frequency response each; ``control``'s own are the
oracle in the tests. Source: balanced disk margin 1 / max |S - 1/2| (Seiler, Packard, Gahinet, 2020).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handctl.controller.model import HandModel
from handctl.tune.linear import NOMINAL, LoopKind, Matrix, PlantFactors, System, loop, plant

GAIN_MARGIN_DB = 6.0
PHASE_MARGIN_DEG = 45.0
"""What tuned gains are to keep on every plant of an ensemble."""
LOWEST_HZ = 0.3
POINTS = 300
STABLE = 1.0 + 1e-6
"""Largest modulus of a closed-loop pole; set-points and forgotten offsets sit at one."""


@dataclass(frozen=True, slots=True)
class Margins:
    """Of one loop.

    Attributes:
        gain_db: factor by which the loop's gain may rise or fall; the smaller of both [dB].
        phase_deg: smallest distance of the phase from -180 degrees where the gain is one.
        disk: balanced disk margin; 0 is unstable, 2 the largest.
        delay_s: further delay that the loop bears [s].
        crossover_hz: highest frequency at which the loop's gain is one; NaN if it never is.
        peak: largest sensitivity [1].
        stable: whether the closed loop is.
    """

    gain_db: float
    phase_deg: float
    disk: float
    delay_s: float
    crossover_hz: float
    peak: float
    stable: bool

    @property
    def enough(self) -> bool:
        """Whether the loop keeps what tuned gains are to keep."""
        return self.stable and self.gain_db >= GAIN_MARGIN_DB and self.phase_deg >= PHASE_MARGIN_DEG

    @property
    def shortfall(self) -> float:
        """How much is missing, as a share of what is asked; 0 or less if nothing is."""
        if not self.stable:
            return 1.0 + min(self.peak, 100.0)
        return max(1.0 - self.gain_db / GAIN_MARGIN_DB, 1.0 - self.phase_deg / PHASE_MARGIN_DEG)


def worse(one: Margins, other: Margins) -> Margins:
    """Of each kind of margin the smaller; crossover and peak the larger."""
    return Margins(
        gain_db=min(one.gain_db, other.gain_db),
        phase_deg=min(one.phase_deg, other.phase_deg),
        disk=min(one.disk, other.disk),
        delay_s=min(one.delay_s, other.delay_s),
        crossover_hz=float(np.fmax(one.crossover_hz, other.crossover_hz)),
        peak=max(one.peak, other.peak),
        stable=one.stable and other.stable,
    )


def grid(period: float) -> Matrix:
    """Angular frequencies from a third of a hertz to just below half the sampling rate (POINTS,) [rad/s]."""
    return np.geomspace(2.0 * math.pi * LOWEST_HZ, 0.999 * math.pi / period, POINTS)


def margins(system: System) -> Margins:
    """Margins of a loop L with 1 + L in the denominator."""
    omega = grid(system.period)
    L: NDArray[np.complex128] = system.response(omega)[:, 0, 0]
    radius = float(np.abs(np.linalg.eigvals(system.A - system.B @ system.C)).max())
    sensitivity = 1.0 / (1.0 + L)
    factors, angles = _gain_factors(L), _phase_angles(L, omega)
    return Margins(
        gain_db=min((20.0 * abs(math.log10(gain)) for gain in factors), default=math.inf),
        phase_deg=min((math.degrees(angle) for angle, _ in angles), default=180.0),
        disk=1.0 / float(np.abs(sensitivity - 0.5).max()) if radius <= STABLE else 0.0,
        delay_s=min((angle / w for angle, w in angles), default=math.inf),
        crossover_hz=max((w for _, w in angles), default=math.nan) / (2.0 * math.pi),
        peak=float(np.abs(sensitivity).max()),
        stable=radius <= STABLE,
    )


def _gain_factors(L: NDArray[np.complex128]) -> list[float]:
    """1 / |L| wherever L crosses the negative real axis, interpolated."""
    i = np.flatnonzero((np.diff(np.sign(L.imag)) != 0.0) & (L.real[:-1] < 0.0) & (L.real[1:] < 0.0))
    share = L.imag[i] / (L.imag[i] - L.imag[i + 1])
    return [1.0 / abs(value) for value in (L.real[i] + share * (L.real[i + 1] - L.real[i])).tolist()]


def _phase_angles(L: NDArray[np.complex128], omega: Matrix) -> list[tuple[float, float]]:
    """(angle from -180 degrees [rad], frequency [rad/s]) wherever the gain crosses one, interpolated."""
    size = np.log(np.abs(L))
    i = np.flatnonzero(np.diff(np.sign(size)) != 0.0)
    share = size[i] / (size[i] - size[i + 1])
    angle = np.abs(np.angle(-L[i] * (L[i + 1] / L[i]) ** share))
    return list(zip(angle.tolist(), (omega[i] * (omega[i + 1] / omega[i]) ** share).tolist(), strict=True))


def all_margins(model: HandModel, factors: PlantFactors = NOMINAL) -> dict[tuple[str, LoopKind], Margins]:
    """Margins of every tendon's two loops."""
    names = model.hand.tendon_names
    return {(name, kind): margins(loop(model, i, kind, factors)) for i, name in enumerate(names) for kind in LoopKind}


def worst(found: dict[tuple[str, LoopKind], Margins]) -> tuple[tuple[str, LoopKind], Margins]:
    """The loop with the largest shortfall, and its name."""
    return max(found.items(), key=lambda item: item[1].shortfall)


def step_response(model: HandModel, tendon: int, kind: LoopKind, duration: float) -> tuple[Matrix, Matrix]:
    """Answer of the closed loop to a step of force on the rotor: how it pushes a disturbance of 1 N away.

    Args:
        model: the hand.
        tendon: index.
        kind: of loop.
        duration: [s].

    Returns:
        times (k,) [s], and travel [m] (motion) or tension [N] (tension), (k,).
    """
    L, P = loop(model, tendon, kind), plant(model, tendon, kind)
    closed = L.A - L.B @ L.C
    row = np.zeros(len(L.A))
    row[: len(P.A)] = P.C[0 if kind == LoopKind.MOTION else 1]
    state, values = np.zeros(len(L.A)), []
    times = np.arange(round(duration / L.period)) * L.period
    for _ in times:
        values.append(float(row @ state))
        state = closed @ state + L.B[:, 0]
    return np.asarray(times, dtype=np.float64), np.array(values)
