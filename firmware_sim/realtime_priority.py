"""Real-time priority for the simulator.

The simulator must keep up with the wall clock, as the firmware of a real drive does.
"""

import math
import os
import sys
import time
from collections import deque
from collections.abc import Callable

REALTIME_PRIORITY = 50
"""Real-time priority of the simulator.

The controller has the priority 60. Therefore the simulator never delays the controller.
"""
ORDINARY_PRIORITY_DURATION_S = 5.0
"""Time without real-time priority after the plant fell behind the clock [s]."""
MAX_CLOCK_SLIPS = 3
"""Number of clock slips within ``CLOCK_SLIP_WINDOW_S`` after which the priority is given back."""
CLOCK_SLIP_WINDOW_S = 1.0
"""Time span within which ``MAX_CLOCK_SLIPS`` are counted [s]."""


def request_realtime_priority() -> bool:
    """Request real-time priority (SCHED_FIFO) for this process.

    Returns:
        True if the priority was granted.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        os.sched_setscheduler(
            0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(REALTIME_PRIORITY)
        )
    except OSError:
        return False
    return True


def restore_priority() -> None:
    """Give this process the ordinary priority again."""
    if sys.platform.startswith("linux"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class RealTimePriority:
    """Real-time priority for a simulator that serves a controller.

    The class ensures that the controller still gets enough computing time.

    A simulator that is behind the clock is always busy. A controller on the same core has no
    real-time priority as long as it imports modules. A simulator with real-time priority would then
    leave the controller almost no time. The simulator therefore takes the priority only when the
    first frame of a host arrives. If the plant repeatedly falls behind the clock, the simulator
    gives the priority back for ``ORDINARY_PRIORITY_DURATION_S``. After a single stop of the
    machine, the simulator keeps the priority.

    Attributes:
        active: True while the process has the priority.
    """

    def __init__(
        self,
        request_function: Callable[[], bool] = request_realtime_priority,
        restore_function: Callable[[], None] = restore_priority,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start without real-time priority.

        Args:
            request_function: function that requests the priority, and returns True if the
                system has granted it.
            restore_function: function that gives the process the ordinary priority again.
            now_s: function that returns the present time [s].
        """
        self._take = request_function
        self._restore = restore_function
        self._now_s = now_s
        self.active = False
        self._not_before_s = -math.inf
        self._slips_s: deque[float] = deque(maxlen=MAX_CLOCK_SLIPS)

    def request_priority(self) -> None:
        """Take the real-time priority, because the host has sent frames."""
        if not self.active and self._now_s() >= self._not_before_s:
            self.active = self._take()
            self._not_before_s = (
                self._now_s() + ORDINARY_PRIORITY_DURATION_S
            )  # if the priority has been refused, it is not requested in every turn

    def count_clock_slip(self) -> None:
        """Count a slip of the clock. After ``MAX_CLOCK_SLIPS`` slips, give the priority back."""
        if not self.active:
            return
        now_s = self._now_s()
        self._slips_s.append(now_s)
        if (
            len(self._slips_s) == MAX_CLOCK_SLIPS
            and now_s - self._slips_s[0] <= CLOCK_SLIP_WINDOW_S
        ):
            self._restore()
            self.active = False
            self._not_before_s = now_s + ORDINARY_PRIORITY_DURATION_S
            self._slips_s.clear()
