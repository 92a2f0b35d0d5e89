"""Provide a clock for the simulator. A test sets the time of the clock."""


class ManualClock:
    """A clock that shows the time that a test has set.

    Attributes:
        t_ns: present time [ns].
        sent: number of ticks for which a controller has sent its frames. answered: number of ticks
            for which the simulator has sent all replies, as the bus server reports. reached_ns:
            time up to which the bus server has simulated [ns].
    """

    scale = 1.0

    def __init__(self, t_ns: int) -> None:
        """Create a clock that shows the time ``t_ns`` [ns]."""
        self.t_ns = t_ns
        self.sent = self.answered = self.reached_ns = 0

    def now_ns(self) -> int:
        return self.t_ns

    def sent_tick_count(self) -> int:
        return self.sent

    def publish_answered_ticks(self, ticks: int) -> None:
        self.answered = ticks

    def publish_reached_time(self, t_ns: int) -> None:
        self.reached_ns = t_ns
