"""How far a loop is from trouble: gain, phase and disk margin, bandwidth, and the step response.

Source: classical margins by ``control`` on the frequency response; balanced disk margin 1 / max |S - 1/2| (Seiler,
Packard, Gahinet, 2020).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handctl.controller.model import HandModel
from handctl.tune.linear import LoopKind, Matrix, PlantFactors, System, loop, plant

GAIN_MARGIN_DB = 6.0
PHASE_MARGIN_DEG = 45.0
"""What tuned gains are to keep on every plant of an ensemble."""
LOWEST_HZ = 0.3
POINTS = 600
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


def grid(period: float) -> Matrix:
    """Angular frequencies from a third of a hertz to just below half the sampling rate (POINTS,) [rad/s]."""
    return np.geomspace(2.0 * math.pi * LOWEST_HZ, 0.999 * math.pi / period, POINTS)


def margins(system: System) -> Margins:
    """Margins of a loop L with 1 + L in the denominator."""
    from control import frd, stability_margins

    omega = grid(system.period)
    L: NDArray[np.complex128] = system.response(omega)[:, 0, 0]
    radius = float(np.abs(np.linalg.eigvals(system.A - system.B @ system.C)).max())
    sensitivity = 1.0 / (1.0 + L)
    response = frd(L, omega, smooth=True)
    gains, phases, _, _, crossings, _ = stability_margins(response, returnall=True)
    factors = [20.0 * abs(math.log10(gain)) for gain in gains if gain > 0]
    angles = [abs(float(phase)) for phase in phases]
    delays = [math.radians(phase) / w for phase, w in zip(angles, crossings, strict=True)]
    return Margins(
        gain_db=min(factors, default=math.inf),
        phase_deg=min(angles, default=180.0),
        disk=1.0 / float(np.abs(sensitivity - 0.5).max()) if radius <= STABLE else 0.0,
        delay_s=min(delays, default=math.inf),
        crossover_hz=max((float(w) for w in crossings), default=math.nan) / (2.0 * math.pi),
        peak=float(np.abs(sensitivity).max()),
        stable=radius <= STABLE,
    )


def all_margins(model: HandModel, factors: PlantFactors = PlantFactors()) -> dict[tuple[str, LoopKind], Margins]:
    """Margins of every tendon's two loops."""
    names = model.hand.tendon_names
    return {
        (name, kind): margins(loop(model, i, kind, factors)) for i, name in enumerate(names) for kind in LoopKind
    }


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
    return times, np.array(values)
