"""What the load cells' innovations say: which sample cannot be right, and whether the filter's model fits at all."""

import numpy as np

from handctl.choose import known
from handctl.core.estimation.filter_stack import MEASUREMENTS, Stacked
from handctl.core.estimation.filter_state import FilterState
from handctl.core.types import Event, Vector

GATE, SURPRISE = 5.0, 2.5
"""Standard deviations of its innovation beyond which a load-cell sample is left out if it is alone; and beyond which
two in a row on the same side are believed, and not smoothed."""
BELIEVED = 0.8
"""Share of the second innovation that is believed at once."""
DOUBT_S, DOUBT_ABOVE, DOUBT_BELOW = 1.0, 8.0, 4.0
"""Time over which NIS is averaged, mean from which on the model does not fit, and below which it does; 2 is right."""
WARY_S, WARY_ABOVE, WARY_FOR_S = 0.25, 3.2, 20.0
"""Time over which NIS is averaged to adapt the filter's noise, mean from which on it is adapted, and for how long."""
WARY_PERIOD_S = 5e-3
"""Longest control period at which noise is adapted [s]. At 100 Hz the quicker filter hands an encoder's noise on to the
torque: jamia11 with ODrives swung up to 234 N instead of 147, and took it for a snapped tendon."""
WARY_HAND = 2.5
"""The same mean of all tendons of the hand: friction that is wrong in all of them shows sooner than in one."""
MOST_NIS = 100.0
"""More counts as this, so that one sample alone raises no doubt."""


def gate(
    filters: Stacked, cell_sigma: Vector, before: Vector, innovation: Vector
) -> tuple[Vector, Vector, list[tuple[int, float]]]:
    """Leave out a load-cell sample that is alone in being far off; believe two in a row on the same side.

    Args:
        filters: of this tick.
        cell_sigma: (N,) standard deviations of the load cells' innovations [N].
        before: (N,) innovations of the last tick by their standard deviations; 0 if there was none.
        innovation: (3N,) measurements less what the filter expects; NaN where missing.

    Returns:
        innovations to use (3N,), those of the load cells by their standard deviations (N,), and changes of tension [N],
        by tendon, to be made beside the update.
    """
    cell = innovation[1::MEASUREMENTS]
    surprise = known(cell / cell_sigma)
    strange = np.abs(surprise) > SURPRISE
    if not np.count_nonzero(strange):
        return innovation, surprise, []
    again = strange & (before * surprise > 0.0) & (np.abs(before) > SURPRISE)
    believed = []
    for i in np.flatnonzero(again & ~filters.slack):
        gain = float(filters.tension[i] @ filters.K[:, MEASUREMENTS * i + 1])
        believed.append((int(i), max(BELIEVED - gain, 0.0) * float(cell[i])))
    alone = (np.abs(surprise) > GATE) & ~again
    if alone.any():
        innovation = innovation.copy()
        innovation[1::MEASUREMENTS][alone] = np.nan
    return innovation, surprise, believed


def watch(period: float, mean: Vector, doubtful: tuple[bool, ...], nis: Vector) -> tuple[Vector, tuple[bool, ...]]:
    """Average NIS and judge whether the model still fits.

    Args:
        period: [s].
        mean: (N,) average so far.
        doubtful: per tendon, whether it did not fit.
        nis: (N,) of this tick; NaN where nothing was measured.
    """
    mean = mean + period / DOUBT_S * known(np.minimum(nis, MOST_NIS) - mean)
    if max(mean.tolist()) < DOUBT_BELOW and True not in doubtful:
        return mean, doubtful
    limits = [DOUBT_BELOW if before else DOUBT_ABOVE for before in doubtful]
    return mean, tuple((mean > limits).tolist())


def caution(period: float, lately: Vector, wary: Vector, nis: Vector) -> tuple[Vector, Vector]:
    """Judge by the last innovations which tendons need more process noise.

    The doubt outlasts its cause: friction that is wrong shows only while a tendon moves, and does most harm when it
    turns next.

    Args:
        period: [s].
        lately: (N,) average of NIS over ``WARY_S`` so far.
        wary: (N,) time for which the filter still doubts its model [s].
        nis: (N,) of this tick by the undoubted model; NaN where nothing was measured.
    """
    if period > WARY_PERIOD_S:
        return lately, wary
    lately = lately + period / WARY_S * known(np.minimum(nis, MOST_NIS) - lately)
    each = lately.tolist()
    above = lately > (WARY_ABOVE if sum(each) < WARY_HAND * len(each) else 0.0)
    if not np.count_nonzero(above) and not np.count_nonzero(wary):
        return lately, wary
    return lately, np.where(above, WARY_FOR_S, np.maximum(wary - period, 0.0))


def doubts(names: tuple[str, ...], before: FilterState, after: FilterState) -> tuple[Event, ...]:
    """Lines for the log where the filter's model has ceased to fit a tendon, or fits again.

    Args:
        names: of the tendons.
        before, after: of the last tick and of this one.
    """
    if before.doubtful == after.doubtful:
        return ()
    events = []
    for name, was, now, nis in zip(names, before.doubtful, after.doubtful, after.nis.tolist(), strict=True):
        if was != now:
            verdict = "the estimate is not to be trusted" if now else "the estimate is good again"
            text = f"{name}: NIS {nis:.1f} over {DOUBT_S:g} s, 2 is right: {verdict}"
            events.append(Event("warn" if now else "info", "estimate", name, text))
    return tuple(events)
