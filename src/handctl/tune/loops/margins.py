"""Margins of a control loop: gain, phase, disk and delay margin, crossover frequency and step response.

A search needs thousands of margins. To keep a search fast, this module calculates each margin from
a frequency response. The tests compare the calculated margins with the results of the Python
package `control`. The eigenvalues of the closed loop confirm the reported margins. If the gain, the
phase or the delay of a loop changes by less than its margin, no pole reaches the unit circle.
Source: balanced disk margin 1 / max |S - 1/2| (Seiler, Packard, Gahinet, 2020).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from handctl.core.hand_model import HandModel
from handctl.tune.loops.linear_models import (
    NOMINAL_FACTORS,
    LinearSystem,
    LoopKind,
    Matrix,
    PlantFactors,
    open_loop,
    plant_system,
)

MIN_GAIN_MARGIN_DB = 6.0
"""Smallest gain margin allowed for tuned gains on any plant of an ensemble [dB]."""
MIN_PHASE_MARGIN_DEG = 45.0
"""Smallest phase margin allowed for tuned gains on any plant of an ensemble [deg]."""
LOWEST_FREQUENCY_HZ = 0.3
"""Lowest frequency of the calculated frequency responses [Hz]."""
SEARCH_GRID_POINTS = 300
"""Number of frequencies of a frequency response that is calculated for a search."""
FINE_GRID_POINTS = 3000
"""Number of frequencies of a frequency response that is calculated for reported margins."""
MAX_OPEN_LOOP_GAIN = 1e-6
"""Largest gain over all frequencies at which a loop counts as open and has no margins."""
MAX_GAIN_DB = 60.0
"""Largest reported gain margin [dB]. Larger margins are not confirmed."""
MAX_DELAY_S = 0.1
"""Largest reported delay margin [s]. Larger margins are not confirmed."""
MARGIN_STEP_COUNT = 10
"""Number of fractions of a margin for which the eigenvalues are calculated."""
DISK_DIRECTION_COUNT = 6
"""Number of directions on the edge of the disk at which the eigenvalues are calculated."""


@dataclass(frozen=True, slots=True)
class LoopMargins:
    """Stability margins of a control loop.

    Attributes:
        gain_db: gain margin, the largest factor by which the gain of the stable loop can be
            multiplied or divided [dB]. The gain margin is the smaller of both factors. The gain
            margin is 0 if the loop is unstable.
        phase_deg: smallest difference between the phase and -180 degrees at a gain of one [deg].
        disk: balanced disk margin, from 0 (unstable loop) to 2.
        delay_s: largest additional delay with which the loop stays stable [s].
        crossover_hz: highest frequency at which the gain of the loop is one [Hz]. If the gain is
            never one, the value is NaN.
        peak: largest value of the sensitivity function [1].
        stable: True if the closed loop is stable.
    """

    gain_db: float
    phase_deg: float
    disk: float
    delay_s: float
    crossover_hz: float
    peak: float
    stable: bool

    @property
    def are_sufficient(self) -> bool:
        """Return True if all margins are large enough for tuned gains."""
        return (
            self.stable
            and self.gain_db >= MIN_GAIN_MARGIN_DB
            and self.phase_deg >= MIN_PHASE_MARGIN_DEG
        )

    @property
    def shortfall(self) -> float:
        """Return the larger of two shortfalls: of the gain margin and of the phase margin.

        The shortfall of a margin is the fraction of the required margin that is missing. If the
        gain margin and the phase margin are both sufficient, the returned shortfall is 0 or less.
        If the loop is unstable, the returned shortfall is 1 or more.
        """
        if not self.stable:
            return 1.0 + min(self.peak, 100.0)
        return max(
            1.0 - self.gain_db / MIN_GAIN_MARGIN_DB, 1.0 - self.phase_deg / MIN_PHASE_MARGIN_DEG
        )


def zeroed_margins(linear_margins: LoopMargins) -> LoopMargins:
    """Return margins that are zero.

    If the hand oscillates in a simulation, margins of zero replace the margins of the linear model.
    """
    return _zero_margins(linear_margins.crossover_hz, linear_margins.peak, is_stable_loop=False)


def minimum_margins(first_margins: LoopMargins, second_margins: LoopMargins) -> LoopMargins:
    """Combine two sets of margins: for each margin, return the smaller value.

    For the crossover frequency and the peak, return the larger value.
    """
    return LoopMargins(
        gain_db=min(first_margins.gain_db, second_margins.gain_db),
        phase_deg=min(first_margins.phase_deg, second_margins.phase_deg),
        disk=min(first_margins.disk, second_margins.disk),
        delay_s=min(first_margins.delay_s, second_margins.delay_s),
        crossover_hz=float(np.fmax(first_margins.crossover_hz, second_margins.crossover_hz)),
        peak=max(first_margins.peak, second_margins.peak),
        stable=first_margins.stable and second_margins.stable,
    )


def frequency_grid(period: float, point_count: int = SEARCH_GRID_POINTS) -> Matrix:
    """Return angular frequencies (points,) from `LOWEST_FREQUENCY_HZ` to almost half of the sampling rate [rad/s]."""
    return np.geomspace(2.0 * math.pi * LOWEST_FREQUENCY_HZ, 0.999 * math.pi / period, point_count)


def margins_of_loop(system: LinearSystem, point_count: int = SEARCH_GRID_POINTS) -> LoopMargins:
    """Return the margins of an open loop L. The closed loop has the denominator 1 + L.

    If the loop is unstable or has no gain, all margins are zero.
    """
    omega = frequency_grid(system.period, point_count)
    if not (np.isfinite(system.A).all() and np.isfinite(system.C).all()):
        return _zero_margins(math.nan, math.inf, is_stable_loop=False)
    L: NDArray[np.complex128] = system.frequency_response(omega)
    if not (stable := is_stable(system)) or float(np.abs(L).max()) <= MAX_OPEN_LOOP_GAIN:
        return _zero_margins(math.nan, float(np.abs(1.0 / (1.0 + L)).max()), stable)
    sensitivity = 1.0 / (1.0 + L)
    factors = _gain_factors(L)
    angles = _phase_angles(L, omega)
    return LoopMargins(
        gain_db=min((20.0 * abs(math.log10(gain)) for gain in factors), default=math.inf),
        phase_deg=min((math.degrees(angle) for angle, _ in angles), default=180.0),
        disk=1.0 / float(np.abs(sensitivity - 0.5).max()),
        delay_s=min((angle / w for angle, w in angles), default=math.inf),
        crossover_hz=max((w for _, w in angles), default=math.nan) / (2.0 * math.pi),
        peak=float(np.abs(sensitivity).max()),
        stable=True,
    )


def _zero_margins(crossover_hz: float, peak: float, is_stable_loop: bool) -> LoopMargins:
    """Return margins that are all zero."""
    return LoopMargins(0.0, 0.0, 0.0, 0.0, crossover_hz, peak, is_stable_loop)


def is_stable(system: LinearSystem, loop_factor: complex = 1.0, delay_ticks: int = 0) -> bool:
    """Return True if all eigenvalues of the closed loop are inside the unit circle.

    Args:
        system: open loop.
        loop_factor: factor by which the gain of the loop is multiplied. A complex factor changes the
            phase.
        delay_ticks: additional delay in the loop [ticks].
    """
    n = len(system.A)
    A = np.zeros((n + delay_ticks, n + delay_ticks), dtype=complex)
    A[:n, :n] = system.A
    if (
        delay_ticks
    ):  # The output of the loop returns to the input of the loop after `delay_ticks` ticks.
        A[n, :n] = system.C[0]
        A[np.arange(n + 1, n + delay_ticks), np.arange(n, n + delay_ticks - 1)] = 1.0
        A[:n, n + delay_ticks - 1] = -loop_factor * system.B[:, 0]
    else:
        A -= loop_factor * (system.B @ system.C)
    return bool(np.isfinite(A).all() and np.abs(np.linalg.eigvals(A)).max() < 1.0)


def confirmed_margins(system: LinearSystem) -> LoopMargins:
    """Return margins that the eigenvalues of the closed loop confirm.

    The function changes the loop within each margin, and computes the eigenvalues of the closed
    loop. If an eigenvalue leaves the unit circle, the function reduces the margin.

    The frequency response is known only on a grid of frequencies. Only the eigenvalues show a
    resonance between two frequencies of the grid.
    """
    result = margins_of_loop(system, FINE_GRID_POINTS)
    if not result.stable or result.phase_deg == 0.0:
        return result
    ticks = int(min(result.delay_s, MAX_DELAY_S) / system.period)
    delays_ticks = np.unique(np.linspace(0, ticks, MARGIN_STEP_COUNT + 1).astype(int))[1:].tolist()
    first_unstable = next(
        (i for i, k in enumerate(delays_ticks) if not is_stable(system, delay_ticks=k)), None
    )
    return replace(
        result,
        gain_db=_largest_confirmed_margin(
            min(result.gain_db, MAX_GAIN_DB),
            lambda x: _is_stable_with_factors(system, (10.0 ** (x / 20.0), 10.0 ** (-x / 20.0))),
        ),
        phase_deg=_largest_confirmed_margin(
            result.phase_deg,
            lambda x: _is_stable_with_factors(system, (np.exp(1j * math.radians(x)),)),
        ),
        disk=_largest_confirmed_margin(
            result.disk,
            lambda x: _is_stable_with_factors(system, _disk_margin_factors(x)),
            MARGIN_STEP_COUNT // 3,
        ),
        delay_s=min(result.delay_s, MAX_DELAY_S)
        if first_unstable is None
        else [0, *delays_ticks][first_unstable] * system.period,
    )


def _is_stable_with_factors(
    system: LinearSystem, loop_factors: Sequence[complex] | NDArray[np.complex128]
) -> bool:
    """Return True if the loop is stable with every given factor of its gain."""
    return all(is_stable(system, complex(factor)) for factor in loop_factors)


def _disk_margin_factors(disk_size: float) -> NDArray[np.complex128]:
    """Return complex factors for the gain of the loop that lie on the edge of a balanced disk.

    Complex conjugate factors have the same stability. Therefore the function returns factors on
    only one half of the edge.
    """
    disk_points = disk_size * np.exp(1j * np.linspace(0.0, np.pi, DISK_DIRECTION_COUNT))
    return np.asarray((2.0 + disk_points) / (2.0 - disk_points))


def _largest_confirmed_margin(
    linear_margin: float,
    is_confirmed: Callable[[float], bool],
    step_count: int = MARGIN_STEP_COUNT,
) -> float:
    """Reduce the margin of a linear model to the largest value that the eigenvalues confirm, and return the value.

    The function tests several fractions of the linear margin, in ascending order. The eigenvalues
    confirm every tested fraction up to the result. The function does not test the last hundredth of
    a margin, because the frequency response is interpolated.
    """
    tried_margins = linear_margin * np.linspace(0.0, 0.99, step_count + 1)[1:]
    for previous_margin, tried_margin in zip(
        [0.0, *tried_margins[:-1]], tried_margins, strict=True
    ):
        if not is_confirmed(float(tried_margin)):
            return float(previous_margin)
    return linear_margin


def _gain_factors(L: NDArray[np.complex128]) -> list[float]:
    """Return 1 / |L| at each frequency at which the open loop L crosses the negative real axis.

    The frequencies of the crossings are interpolated.
    """
    # At a crossing of the negative real axis, the imaginary part of L changes its sign between two
    # frequencies with negative real parts.
    i = np.flatnonzero((np.diff(np.sign(L.imag)) != 0.0) & (L.real[:-1] < 0.0) & (L.real[1:] < 0.0))
    fraction = L.imag[i] / (L.imag[i] - L.imag[i + 1])
    return [
        1.0 / abs(value) for value in (L.real[i] + fraction * (L.real[i + 1] - L.real[i])).tolist()
    ]


def _phase_angles(L: NDArray[np.complex128], omega: Matrix) -> list[tuple[float, float]]:
    """Return, for each crossing of the gain 1, the angle from -180 degrees [rad] and the frequency [rad/s].

    The angle and the frequency are interpolated.
    """
    log_gain = np.log(np.maximum(np.abs(L), MAX_OPEN_LOOP_GAIN))
    i = np.flatnonzero(np.diff(np.sign(log_gain)) != 0.0)
    fraction = log_gain[i] / (log_gain[i] - log_gain[i + 1])
    # The logarithm of the magnitude and the phase are interpolated, because both quantities are
    # almost linear in frequency.
    angle = np.abs(np.angle(-L[i] * (L[i + 1] / L[i]) ** fraction))
    return list(
        zip(
            angle.tolist(), (omega[i] * (omega[i + 1] / omega[i]) ** fraction).tolist(), strict=True
        )
    )


def margins_by_loop(
    model: HandModel, factors: PlantFactors = NOMINAL_FACTORS
) -> dict[tuple[str, LoopKind], LoopMargins]:
    """Return the margins of both loops of every tendon, confirmed by the eigenvalues of the closed loops."""
    names = model.hand.tendon_names
    return {
        (name, kind): confirmed_margins(open_loop(model, i, kind, factors))
        for i, name in enumerate(names)
        for kind in LoopKind
    }


def worst_loop(
    margins_by_loop: dict[tuple[str, LoopKind], LoopMargins],
) -> tuple[tuple[str, LoopKind], LoopMargins]:
    """Return tendon, kind and margins of the loop that lacks the largest fraction of a required margin."""
    return max(margins_by_loop.items(), key=lambda loop_and_margins: loop_and_margins[1].shortfall)


def step_response(
    model: HandModel, tendon: int, kind: LoopKind, duration: float
) -> tuple[Matrix, Matrix]:
    """Return the response of a closed loop to a disturbance force on the rotor that rises by 1 N.

    Args:
        model: model of the hand.
        tendon: index of the tendon.
        kind: kind of the loop, motion or tension.
        duration: duration of the response to compute [s].

    Returns:
        The times (k,) [s], and the travel [m] of a motion loop or the tension [N] of a tension
        loop, (k,).
    """
    L = open_loop(model, tendon, kind)
    P = plant_system(model, tendon, kind)
    closed_loop_matrix = L.A - L.B @ L.C
    row = np.zeros(len(L.A))
    row[: len(P.A)] = P.C[0 if kind == LoopKind.MOTION else 1]
    state = np.zeros(len(L.A))
    values = []
    times = np.arange(round(duration / L.period)) * L.period
    for _ in times:
        values.append(float(row @ state))
        state = closed_loop_matrix @ state + L.B[:, 0]
    return np.asarray(times, dtype=np.float64), np.array(values)
