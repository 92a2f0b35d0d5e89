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

The controller has the priority 60. Therefore a controller with priority 60 never waits for the
simulator.
"""
ORDINARY_PRIORITY_DURATION_S = 5.0
"""Time for which the simulator has no real-time priority after the plant has repeatedly fallen behind the clock [s]."""
MAX_CLOCK_SLIPS = 3
"""Number of clock slips within ``CLOCK_SLIP_WINDOW_S`` after which the simulator gives the real-time priority back."""
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

    The class ensures that the controller gets enough computing time in spite of the priority of the
    simulator.

    A simulator that is behind the clock is always busy. A controller on the same core has no
    real-time priority as long as it imports modules. A simulator with real-time priority would
    leave an importing controller almost no computing time. The simulator therefore takes the
    real-time priority only when the first frame of a host arrives. If the plant repeatedly falls
    behind the clock, the simulator gives the real-time priority back for
    ``ORDINARY_PRIORITY_DURATION_S``. If the plant falls behind only once, because the machine has
    paused, the simulator keeps the real-time priority.

    Attributes:
        active: True while the process has real-time priority.
    """

    def __init__(
        self,
        request_function: Callable[[], bool] = request_realtime_priority,
        restore_function: Callable[[], None] = restore_priority,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start without real-time priority.

        Args:
            request_function: function that requests real-time priority, and returns True if the
                system has granted the priority.
            restore_function: function that gives the process the ordinary priority again.
            now_s: function that returns the present time [s].
        """
        self._request = request_function
        self._restore = restore_function
        self._now_s = now_s
        self.active = False
        self._next_request_s = -math.inf
        self._slips_s: deque[float] = deque(maxlen=MAX_CLOCK_SLIPS)

    def request_priority(self) -> None:
        """Request the real-time priority for this process, because the host has sent frames."""
        if not self.active and self._now_s() >= self._next_request_s:
            self.active = self._request()
            self._next_request_s = (
                self._now_s() + ORDINARY_PRIORITY_DURATION_S
            )  # after the system has refused the priority, the simulator does not request it in every turn

    def count_clock_slip(self) -> None:
        """Count a slip of the clock, which skips the time by which the plant is behind.

        After ``MAX_CLOCK_SLIPS`` slips within ``CLOCK_SLIP_WINDOW_S``, give the real-time priority
        back.
        """
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
            self._next_request_s = now_s + ORDINARY_PRIORITY_DURATION_S
            self._slips_s.clear()
