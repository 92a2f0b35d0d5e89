"""The power state machine of CiA 402: control words in, states out. Source: facts, cia402.

Choices: 0x0F out of *ready to switch on* takes transitions 3 and 4 in one; quick stop goes on to *switch on disabled*
by itself; *fault reaction* is passed within one step.
"""

OFF, READY, ON, ENABLED, FAULT = "switch on disabled", "ready", "switched on", "operation enabled", "fault"
_WORDS = {OFF: 0x40, READY: 0x21, ON: 0x23, ENABLED: 0x27, FAULT: 0x08}


class Power:
    """Attributes: state: one of the names above."""

    def __init__(self) -> None:
        """Start with the power stage off."""
        self.state = OFF
        self._reset_bit = False

    @property
    def status(self) -> int:
        """Status word: state, voltage present, remote; in torque mode bit 12 says that the target is followed."""
        return _WORDS[self.state] | 1 << 4 | 1 << 9 | (1 << 12 if self.state == ENABLED else 0)

    def command(self, word: int) -> None:
        """Take a control word; all but fault reset are levels, and depend on the present state only."""
        edge = bool(word & 0x80) and not self._reset_bit
        self._reset_bit = bool(word & 0x80)
        if self.state == FAULT:
            self.state = OFF if edge else FAULT
            return
        if not word & 0x02 or not word & 0x04:
            self.state = OFF  # disable voltage, or quick stop
        elif word & 0x07 == 0x06:
            self.state = READY
        elif self.state != OFF and word & 0x0F == 0x0F:
            self.state = ENABLED
        elif self.state != OFF and word & 0x0F == 0x07:
            self.state = ON

    def fail(self) -> None:
        """Enter fault."""
        self.state = FAULT
