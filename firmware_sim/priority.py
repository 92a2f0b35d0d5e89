"""Real-time priority for a simulator that keeps up with its clock, as real firmware does."""

import math
import os
import sys
import time
from collections import deque
from collections.abc import Callable

PRIORITY = 50
"""Priority below a controller's 60, so that the simulator never delays the host past its deadline."""
ORDINARY_PRIORITY_S = 5.0
"""Time without real-time priority after the plant fell behind its clock [s]."""
MAX_SLIPS = 3
"""Slips within ``SLIP_WINDOW_S`` that end the priority."""
SLIP_WINDOW_S = 1.0
"""Time span of these slips [s]."""


def take_priority() -> bool:
    """Request SCHED_FIFO.

    Returns:
        True if the priority was granted.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    except OSError:
        return False
    return True


def restore_priority() -> None:
    """Return to the ordinary scheduler."""
    if sys.platform.startswith("linux"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class RealTimePriority:
    """Real-time priority while the simulator serves a controller, without starving the controller.

    A simulator that is behind is always busy. With real-time priority it would leave almost no time
    to a controller on the same core that still imports and has no real-time priority yet. The
    priority is therefore taken with the first frame of a host. The priority is given back for
    ``ORDINARY_PRIORITY_S`` if the plant falls behind repeatedly, but not after a single stop of the
    machine.

    Attributes:
        active: True while the process has the priority.
    """

    def __init__(
        self,
        take: Callable[[], bool] = take_priority,
        restore: Callable[[], None] = restore_priority,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start without priority.

        Args:
            take: takes the priority, returns True if granted.
            restore: restores the ordinary priority.
            now_s: clock [s].
        """
        self._take = take
        self._restore = restore
        self._now_s = now_s
        self.active = False
        self._not_before_s = -math.inf
        self._slips_s: deque[float] = deque(maxlen=MAX_SLIPS)

    def note_host_frames(self) -> None:
        """Take the priority because frames of a host arrived."""
        if not self.active and self._now_s() >= self._not_before_s:
            self.active = self._take()
            self._not_before_s = self._now_s() + ORDINARY_PRIORITY_S  # Do not retry in every turn after a refusal.

    def note_slip(self) -> None:
        """Count a slip of the plant, and give the priority back after several."""
        if not self.active:
            return
        now_s = self._now_s()
        self._slips_s.append(now_s)
        if len(self._slips_s) == MAX_SLIPS and now_s - self._slips_s[0] <= SLIP_WINDOW_S:
            self._restore()
            self.active = False
            self._not_before_s = now_s + ORDINARY_PRIORITY_S
            self._slips_s.clear()
