"""Time limit for the safety reaction HOLD, in which a fault stops the motion of the hand.

The time limit for HOLD applies only to runs that no operator watches. While a fault holds the hand,
the time of the motion program does not advance. If the gains make a hand oscillate, the controller
reports fault N07 (noisy encoder), and holds the hand until the oscillation ends. Without a time
limit, a run with an oscillation might never end.
"""

from dataclasses import dataclass, field

from handctl.core.tick_types import HandMode, TickIn, TickOut
from handctl.errors import DriveError
from handctl.runtime.mailbox import STOP_REQUEST
from handctl.safety.safety_action import SafetyAction

MAX_HOLD_S = 5.0
"""Longest time for which a fault is allowed to hold the hand in a run that no operator watches [s]."""


@dataclass
class HoldTimeout:
    """Observer that stops a run if a fault causes the reaction HOLD for longer than ``MAX_HOLD_S``.

    Attributes:
        stop_reason: fault that made this observer stop the run. The text is empty if the run was
            not stopped.
    """

    stop_reason: str = ""
    _fault: str = ""
    _hold_start_ns: int = -1
    _requests: list[str] = field(default_factory=list)

    def poll_requests(self) -> tuple[str, ...]:
        """Return the requests of this tick, see ``RunObserver``."""
        requests = tuple(self._requests)
        self._requests.clear()
        return requests

    def on_tick(self, tick_input: TickIn, tick_output: TickOut) -> None:
        """Observe a tick, see ``RunObserver``."""
        for event in tick_output.events:
            if event.name == "fault":
                self._fault = event.text
        if tick_output.mode != HandMode.ACTIVE or tick_output.action < SafetyAction.HOLD:
            self._hold_start_ns = -1
            return
        if self._hold_start_ns < 0:
            self._hold_start_ns = tick_input.t_ns
        if tick_input.t_ns - self._hold_start_ns > MAX_HOLD_S * 1e9 and not self.stop_reason:
            self.stop_reason = self._fault or "a fault"
            self._requests.append(STOP_REQUEST)

    def raise_if_stopped(self, location: str) -> None:
        """Raise an error if this observer has stopped the run.

        Raises:
            DriveError: a fault held the hand for too long.
        """
        if self.stop_reason:
            expected = "a hand without this fault; if it oscillates, try handctl tune design, then handctl gains apply"
            raise DriveError(f"held for {MAX_HOLD_S:g} s by {self.stop_reason}", location, expected)
