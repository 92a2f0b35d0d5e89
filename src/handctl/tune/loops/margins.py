"""How far a loop is from trouble: gain, phase and disk margin, bandwidth, and the step response.

A search asks for thousands of margins, so they are read from one frequency response each; ``control``'s own are the
oracle in the tests. A margin that is reported is confirmed by the closed loop's eigenvalues: within it no change of
gain, phase or delay has a pole on the unit circle. Source: balanced disk margin 1 / max |S - 1/2| (Seiler, Packard,
Gahinet, 2020).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from handctl.core.model import HandModel
from handctl.tune.loops.linear import NOMINAL, LoopKind, Matrix, PlantFactors, System, loop, plant

GAIN_MARGIN_DB = 6.0
PHASE_MARGIN_DEG = 45.0
"""What tuned gains are to keep on every plant of an ensemble."""
LOWEST_HZ = 0.3
POINTS = 300
FINE_POINTS = 3000
"""Frequencies of a margin that is reported."""
NO_GAIN = 1e-6
"""A loop whose gain never exceeds this feeds nothing back, and has no margin."""
MOST_DB, MOST_DELAY_S = 60.0, 0.1
"""Margins beyond these are reported as these: further ones are not confirmed."""
SIZES, DIRECTIONS = 10, 6
"""Parts of a margin, and directions of a disk, at which eigenvalues are computed."""


@dataclass(frozen=True, slots=True)
class Margins:
    """Of one loop.

    Attributes:
        gain_db: factor by which the loop's gain may rise or fall; the smaller of both [dB]. Zero if it is unstable.
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


def unproven(one: Margins) -> Margins:
    """Return no margins: what linear loops promise and a simulation does not show."""
    return _none(one.crossover_hz, one.peak, stable=False)


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


def grid(period: float, points: int = POINTS) -> Matrix:
    """Angular frequencies from a third of a hertz to just below half the sampling rate (points,) [rad/s]."""
    return np.geomspace(2.0 * math.pi * LOWEST_HZ, 0.999 * math.pi / period, points)


def margins(system: System, points: int = POINTS) -> Margins:
    """Compute the margins of a loop L with 1 + L in the denominator.

    An unstable loop and a loop without gain have none.
    """
    omega = grid(system.period, points)
    if not (np.isfinite(system.A).all() and np.isfinite(system.C).all()):
        return _none(math.nan, math.inf, stable=False)
    L: NDArray[np.complex128] = system.response(omega)[:, 0, 0]
    if not (stable := is_stable(system)) or float(np.abs(L).max()) <= NO_GAIN:
        return _none(math.nan, float(np.abs(1.0 / (1.0 + L)).max()), stable)
    sensitivity = 1.0 / (1.0 + L)
    factors, angles = _gain_factors(L), _phase_angles(L, omega)
    return Margins(
        gain_db=min((20.0 * abs(math.log10(gain)) for gain in factors), default=math.inf),
        phase_deg=min((math.degrees(angle) for angle, _ in angles), default=180.0),
        disk=1.0 / float(np.abs(sensitivity - 0.5).max()),
        delay_s=min((angle / w for angle, w in angles), default=math.inf),
        crossover_hz=max((w for _, w in angles), default=math.nan) / (2.0 * math.pi),
        peak=float(np.abs(sensitivity).max()),
        stable=True,
    )


def _none(crossover_hz: float, peak: float, stable: bool) -> Margins:
    return Margins(0.0, 0.0, 0.0, 0.0, crossover_hz, peak, stable)


def is_stable(system: System, factor: complex = 1.0, delay: int = 0) -> bool:
    """Return whether all closed-loop eigenvalues are inside the unit circle.

    Args:
        system: loop.
        factor: on its gain, complex for a change of phase.
        delay: further ticks in it.
    """
    n = len(system.A)
    A = np.zeros((n + delay, n + delay), dtype=complex)
    A[:n, :n] = system.A
    if delay:  # L's answer goes through a chain of ticks before it comes back
        A[n, :n] = system.C[0]
        A[np.arange(n + 1, n + delay), np.arange(n, n + delay - 1)] = 1.0
        A[:n, n + delay - 1] = -factor * system.B[:, 0]
    else:
        A -= factor * (system.B @ system.C)
    return bool(np.isfinite(A).all() and np.abs(np.linalg.eigvals(A)).max() < 1.0)


def confirmed(system: System) -> Margins:
    """Compute margins that frequency response and eigenvalues agree on.

    A margin within which an eigenvalue leaves the unit circle is cut down to where it does. The frequency response
    alone misses a resonance between two of its points.
    """
    found = margins(system, FINE_POINTS)
    if not found.stable or found.phase_deg == 0.0:
        return found
    ticks = int(min(found.delay_s, MOST_DELAY_S) / system.period)
    delays = np.unique(np.linspace(0, ticks, SIZES + 1).astype(int))[1:].tolist()
    lost = next((i for i, k in enumerate(delays) if not is_stable(system, delay=k)), None)
    return replace(
        found,
        gain_db=_kept(min(found.gain_db, MOST_DB), lambda x: _bears(system, (10.0 ** (x / 20.0), 10.0 ** (-x / 20.0)))),
        phase_deg=_kept(found.phase_deg, lambda x: _bears(system, (np.exp(1j * math.radians(x)),))),
        disk=_kept(found.disk, lambda x: _bears(system, _disk(x)), SIZES // 3),
        delay_s=min(found.delay_s, MOST_DELAY_S) if lost is None else [0, *delays][lost] * system.period,
    )


def _bears(system: System, factors: Sequence[complex] | NDArray[np.complex128]) -> bool:
    return all(is_stable(system, complex(factor)) for factor in factors)


def _disk(size: float) -> NDArray[np.complex128]:
    """Return factors on the rim of a balanced disk; those of its mirror image have the same eigenvalues."""
    delta = size * np.exp(1j * np.linspace(0.0, np.pi, DIRECTIONS))
    return np.asarray((2.0 + delta) / (2.0 - delta))


def _kept(margin: float, bears: Callable[[float], bool], sizes: int = SIZES) -> float:
    """Return the largest part of a margin up to which the loop bears everything.

    The last hundredth is interpolation of the frequency response, and is not tried.
    """
    tried = margin * np.linspace(0.0, 0.99, sizes + 1)[1:]
    for before, at in zip([0.0, *tried[:-1]], tried, strict=True):
        if not bears(float(at)):
            return float(before)
    return margin


def _gain_factors(L: NDArray[np.complex128]) -> list[float]:
    """1 / |L| wherever L crosses the negative real axis, interpolated."""
    i = np.flatnonzero((np.diff(np.sign(L.imag)) != 0.0) & (L.real[:-1] < 0.0) & (L.real[1:] < 0.0))
    share = L.imag[i] / (L.imag[i] - L.imag[i + 1])
    return [1.0 / abs(value) for value in (L.real[i] + share * (L.real[i + 1] - L.real[i])).tolist()]


def _phase_angles(L: NDArray[np.complex128], omega: Matrix) -> list[tuple[float, float]]:
    """(angle from -180 degrees [rad], frequency [rad/s]) wherever the gain crosses one, interpolated."""
    size = np.log(np.maximum(np.abs(L), NO_GAIN))
    i = np.flatnonzero(np.diff(np.sign(size)) != 0.0)
    share = size[i] / (size[i] - size[i + 1])
    angle = np.abs(np.angle(-L[i] * (L[i + 1] / L[i]) ** share))
    return list(zip(angle.tolist(), (omega[i] * (omega[i + 1] / omega[i]) ** share).tolist(), strict=True))


def all_margins(model: HandModel, factors: PlantFactors = NOMINAL) -> dict[tuple[str, LoopKind], Margins]:
    """Margins of every tendon's two loops."""
    names = model.hand.tendon_names
    return {(name, kind): confirmed(loop(model, i, kind, factors)) for i, name in enumerate(names) for kind in LoopKind}


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
