"""What a rope has been through: when it was taut, since when it is slack, and what it bore when the torque was cut."""

import math
from collections.abc import Iterable
from typing import NamedTuple

from handctl.safety.signals import Named

TAUT_N, SLACK_N = 2.5, 2.0
SNAP_SHARE, SNAP_LEAST_N, SNAP_SPEED, SNAP_MEMORY_S = 0.2, 8.0, 0.03, 0.1
"""A rope has snapped if it bears less than this share of at least so much, its spool winds at least so fast [m/s], and
it was taut not longer ago than this [s]: a rope that is taken up was not taut, one that lost its load is still taut."""
LIMP_AFTER_S, LIMP_SHARE, LIMP_LEAST_N = 0.1, 0.5, 10.0
"""A rope that still bears this share, and so much, so long after the torque was cut is being pulled.

Let go in a grasp, the packaged hands' ropes bear at most a third by then, and a motor that holds on at least 0.74.
"""
LIMP_SEEN_S = 0.08
"""From so long after the cut on a load cell's last reading counts, if the latest one is missing."""


class Ropes(NamedTuple):
    """Per tendon; empty as long as nothing is wanted of any.

    Attributes:
        taut_ago: ticks since the rope was taut; -1 if it was not since tension is wanted.
        slack: ticks for which it has been slack.
        cut: ticks since the torque was cut; -1 if it is not.
        cut_from: tension back then [N]; NaN if no load cell has told it yet.
        bears: what each bore last, of the readings that count [N]; NaN if there was none.
    """

    taut_ago: tuple[int, ...] = ()
    slack: tuple[int, ...] = ()
    cut: int = -1
    cut_from: tuple[float, ...] = ()
    bears: tuple[float, ...] = ()


def step(state: Ropes, tension: list[float], wanted: list[float]) -> Ropes:
    """One tick under torque.

    Args:
        state: from the last tick.
        tension: load cells, filtered [N].
        wanted: tension commanded [N]; NaN for a limp tendon.
    """
    n = len(tension)
    if min(tension) > TAUT_N and not math.isnan(sum(wanted)):  # nearly always: all are wanted taut, and are
        return Ropes((0,) * n, (0,) * n)
    taut_ago, slack = [], []
    rows = zip(tension, wanted, state.taut_ago or (-1,) * n, state.slack or (0,) * n, strict=True)
    for cell, goal, ago, ticks in rows:
        if goal != goal:
            ago, ticks = -1, 0
        elif cell > TAUT_N:
            ago, ticks = 0, 0
        elif ago >= 0:
            ago += 1
            ticks = ticks + 1 if cell < SLACK_N and goal > TAUT_N else 0
        taut_ago.append(ago)
        slack.append(ticks)
    return Ropes(tuple(taut_ago), tuple(slack))


def cut(state: Ropes, tension: list[float], last: list[float], period: float) -> Ropes:
    """One tick after the torque was cut.

    Args:
        state: from the last tick.
        tension: load cells [N]; NaN if missing, as many a frame is where a cut was needed.
        last: reading of each before the cut, which counts if the first one after it is missing; NaN if there was none,
            and then the first that comes counts [N].
        period: control period [s].
    """
    first, second = (tension, last) if state.cut < 0 else (state.cut_from, tension)
    bears = () if (state.cut + 1) * period < LIMP_SEEN_S else _known(tension, state.bears or (math.nan,) * len(tension))
    return Ropes(cut=state.cut + 1, cut_from=_known(first, second), bears=bears)


def _known(first: Iterable[float], second: Iterable[float]) -> tuple[float, ...]:
    """The first of two where it is a number."""
    return tuple([a if a == a else b for a, b in zip(first, second, strict=True)])


def slack(state: Ropes, names: tuple[str, ...], period: float) -> Named:
    """Slack tendons and for how long [s]."""
    if not any(state.slack):
        return ()
    return tuple([(name, ticks * period) for name, ticks in zip(names, state.slack, strict=True) if ticks])


def snapped(
    state: Ropes, names: tuple[str, ...], tension: list[float], wanted: list[float], speed: list[float], period: float
) -> Named:
    """Tendons that lost their tension while their spool runs [m/s]."""
    if True not in [v > SNAP_SPEED for v in speed]:
        return ()
    rows = zip(names, state.taut_ago, tension, wanted, speed, strict=False)
    return tuple(
        [
            (name, v)
            for name, ago, cell, goal, v in rows
            if v > SNAP_SPEED and goal > SNAP_LEAST_N and cell < SNAP_SHARE * goal and 0 <= ago * period < SNAP_MEMORY_S
        ]
    )


def limp(state: Ropes, names: tuple[str, ...], period: float) -> Named:
    """Tendons that somebody still pulls after the cut [N]."""
    if state.cut * period < LIMP_AFTER_S:
        return ()
    rows = zip(names, state.cut_from, state.bears, strict=True)
    return tuple([(name, f) for name, before, f in rows if f > LIMP_LEAST_N and f > LIMP_SHARE * before])
