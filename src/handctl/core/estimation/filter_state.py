"""What the tension filter carries from tick to tick."""

from typing import NamedTuple

import numpy as np

from handctl.choose import Array
from handctl.core.estimation.filter_stack import STATES, Regime
from handctl.core.types import Vector


class FilterState(NamedTuple):
    """What the filter carries from tick to tick.

    Attributes:
        x: (7N,) stacked state, the prediction for the coming measurement's instant.
        regimes: per tendon, a ``Regime``.
        stopped: per tendon, whether springs hold its digit on the open stop.
        turning: per tendon, what has spoken of late for leaving (or entering) slack, see ``take_up``.
        measured: per tendon, whether the rope's length is known from a take-up.
        surprise: (N,) last load-cell innovation by its standard deviation; 0 if there was none.
        nis: (N,) normalised innovation squared, averaged over ``DOUBT_S``.
        doubtful: per tendon, whether that is too much.
        lately: (N,) normalised innovation squared by the undoubted model, averaged over ``WARY_S``.
        wary: (N,) time for which the filter still doubts its model [s]; 0 if it does not.
        covariance: (N, 7, 7) of x; None as long as it is the steady one.
        started: False until encoder and load cell of every tendon were read once, be it in different ticks.
    """

    x: Vector
    regimes: tuple[int, ...]
    stopped: tuple[bool, ...]
    turning: tuple[int, ...]
    measured: tuple[bool, ...]
    surprise: Vector
    nis: Vector
    doubtful: tuple[bool, ...]
    lately: Vector
    wary: Vector
    covariance: Array | None
    started: bool = False

    @staticmethod
    def initial(tendons: int) -> "FilterState":
        """Nothing known: slack, hand open."""
        return FilterState.of(np.zeros(STATES * tendons), Regime.SLACK, stopped=True, started=False)

    @staticmethod
    def of(x: Vector, regime: Regime, stopped: bool, started: bool = True) -> "FilterState":
        """Every tendon in one regime, at a stacked state (7N,)."""
        n = len(x) // STATES
        no = (False,) * n
        usual = np.full(n, 2.0)
        none = np.zeros(n)
        judged = (none, usual, no, usual, none)
        return FilterState(x, (int(regime),) * n, (stopped,) * n, (0,) * n, no, *judged, None, started)
