"""The power state machine of CiA 402: control words in, states out. Source: facts, cia402.

Choices: 0x0F out of *ready to switch on* takes transitions 3 and 4 in one; quick stop goes on to *switch on disabled*
by itself; *fault reaction* is passed within one step.
"""

import ctypes
from typing import Any

from firmware_sim.compiled import inner

OFF, READY, ON, ENABLED, FAULT = range(5)
"""Switch on disabled, ready to switch on, switched on, operation enabled, fault."""
_WORDS = (0x40, 0x21, 0x23, 0x27, 0x08)


@inner
def status(power: Any) -> int:
    """Return the status word: state, voltage present, remote; bit 12 says that the target torque is followed."""
    return _WORDS[power.state] | 1 << 4 | 1 << 9 | (1 << 12 if power.state == ENABLED else 0)


class Power:
    """Attributes: state: one of those above. reset_bit: whether the last control word had the bit of fault reset."""

    def __init__(self) -> None:
        """Start with the power stage off."""
        self.state = OFF
        self.reset_bit = False

    def command(self, word: int) -> None:
        """Take a control word; all but fault reset are levels, and depend on the present state only."""
        edge = bool(word & 0x80) and not self.reset_bit
        self.reset_bit = bool(word & 0x80)
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


class PowerRow(ctypes.Structure, Power):
    """The power state machine in a row of a drive."""

    _fields_ = [(name, ctypes.c_int64) for name in ("state", "reset_bit")]
