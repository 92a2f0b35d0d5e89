"""Limit for the time during which a fault may make the hand hold its position, in a run that no operator watches.

While the hand holds its position because of a fault, the time of the motion program stands still.
Some gains make a hand oscillate. The fault N07 (noisy encoder) then makes the hand hold its
position while it oscillates. Without a limit, such a run might never end.
"""

from dataclasses import dataclass, field

from handctl.core.tick_types import HandMode, TickIn, TickOut
from handctl.errors import DriveError
from handctl.runtime.mailbox import STOP_REQUEST
from handctl.safety.action import SafetyAction

MAX_HOLD_S = 5.0
"""Longest time for which a fault may hold the hand in a run that no operator watches [s]."""


@dataclass
class HoldLimit:
    """Observer of a run that no operator watches.

    If a fault makes the hand hold its position for too long, the observer stops the run.

    Attributes:
        stop_reason: fault because of which this observer has stopped the run. If it has not stopped
            the run, the text is empty.
    """

    stop_reason: str = ""
    _fault: str = ""
    _since_ns: int = -1
    _requests: list[str] = field(default_factory=list)

    def poll_requests(self) -> tuple[str, ...]:
        """Return the requests of this tick, see ``RunObserver``."""
        requests = tuple(self._requests)
        self._requests.clear()
        return requests

    def on_tick(self, entry: TickIn, out: TickOut) -> None:
        """Observe a tick, see ``RunObserver``."""
        for event in out.events:
            if event.name == "fault":
                self._fault = event.text
        if out.mode != HandMode.ACTIVE or out.action < SafetyAction.HOLD:
            self._since_ns = -1
            return
        if self._since_ns < 0:
            self._since_ns = entry.t_ns
        if entry.t_ns - self._since_ns > MAX_HOLD_S * 1e9 and not self.stop_reason:
            self.stop_reason = self._fault or "a fault"
            self._requests.append(STOP_REQUEST)

    def refuse_stopped(self, where: str) -> None:
        """Raise an error if this observer has stopped the run.

        Raises:
            DriveError: a fault made the hand hold its position for too long.
        """
        if self.stop_reason:
            right = "a hand without this fault; if it oscillates, try handctl tune design, then handctl gains apply"
            raise DriveError(f"held for {MAX_HOLD_S:g} s by {self.stop_reason}", where, right)
