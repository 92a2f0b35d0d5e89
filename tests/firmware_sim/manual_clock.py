"""A clock for the simulator. The test sets its time."""


class ManualClock:
    """A clock that shows the time that a test has set.

    Attributes:
        t_ns: present time [ns].
        sent: number of ticks that a controller has sent.
        answered: number of ticks that the server has reported as answered.
        reached_ns: time that the server has reported as reached [ns].
    """

    scale = 1.0

    def __init__(self, t_ns: int) -> None:
        """Create a clock that shows the time ``t_ns`` [ns]."""
        self.t_ns = t_ns
        self.sent = self.answered = self.reached_ns = 0

    def now_ns(self) -> int:
        return self.t_ns

    def ticks_sent(self) -> int:
        return self.sent

    def note_answered(self, ticks: int) -> None:
        self.answered = ticks

    def note_reached(self, t_ns: int) -> None:
        self.reached_ns = t_ns
