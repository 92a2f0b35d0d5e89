"""Firmware does not wait for a desktop: real-time priority for a simulator that keeps up, where it is granted."""

import math
import os
import sys
import time
from collections import deque
from collections.abc import Callable

LEVEL = 50
"""Below a controller's 60, so that the simulated side never keeps the host from its deadline."""
ORDINARY_S = 5.0
"""Time without real-time priority after the plant could not follow its clock [s]."""
SEVERAL, WITHIN_S = 3, 1.0
"""It could not if it gave up time so often within so long [s]."""


def take_priority() -> bool:
    """Ask for SCHED_FIFO; return whether it was granted."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(LEVEL))
    except OSError:
        return False
    return True


def give_back_priority() -> None:
    """Be an ordinary process again."""
    if sys.platform.startswith("linux"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class Urgency:
    """Real-time priority while it serves a controller, and never while it would starve one.

    A simulator that is behind is busy all the time. With real-time priority it would leave next to nothing to a
    controller on the same core that is still importing, and has no such priority yet. So it takes the priority with the
    first frame of a host, and gives it back for ``ORDINARY_S`` where even so the plant falls behind again and again. A
    machine that stood still for a moment is no reason.

    Attributes:
        taken: whether it has the priority.
    """

    def __init__(
        self,
        take: Callable[[], bool] = take_priority,
        give_back: Callable[[], None] = give_back_priority,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Args: what takes the priority, what gives it back, and the clock [s]."""
        self._take, self._give_back, self._now_s = take, give_back, now_s
        self.taken = False
        self._not_before_s = -math.inf
        self._slips_s: deque[float] = deque(maxlen=SEVERAL)

    def heard(self) -> None:
        """Note frames of a host."""
        if not self.taken and self._now_s() >= self._not_before_s:
            self.taken = self._take()
            self._not_before_s = self._now_s() + ORDINARY_S  # where it is refused it is not asked for in every turn

    def behind(self) -> None:
        """Note that the plant has given up time."""
        if not self.taken:
            return
        now_s = self._now_s()
        self._slips_s.append(now_s)
        if len(self._slips_s) == SEVERAL and now_s - self._slips_s[0] <= WITHIN_S:
            self._give_back()
            self.taken = False
            self._not_before_s = now_s + ORDINARY_S
            self._slips_s.clear()
