"""The power state machine of CiA 402: control words in, states out. Source: facts, cia402.

Control word: bit 0 switch on, bit 1 enable voltage, bit 2 quick stop (0 stops), bit 3 enable
operation, bit 7 fault reset (rising edge).

Choices: control word 0x0F in *ready to switch on* executes transitions 3 and 4 together. Quick stop
changes to *switch on disabled* without a command. *Fault reaction* is passed within one step.
"""

import ctypes
from typing import Any

from firmware_sim.compiled import inner

OFF, READY, ON, ENABLED, FAULT = range(5)
"""States: switch on disabled, ready to switch on, switched on, operation enabled, fault."""
_WORDS = (0x40, 0x21, 0x23, 0x27, 0x08)
"""State bits of the status word, by state."""


@inner
def status(power: Any) -> int:
    """Return the status word.

    Bit 4 is voltage enabled, bit 9 remote, bit 12 target torque followed. The other bits are the
    state.
    """
    return _WORDS[power.state] | 1 << 4 | 1 << 9 | (1 << 12 if power.state == ENABLED else 0)


class Power:
    """The power state machine.

    Attributes:
        state: OFF, READY, ON, ENABLED or FAULT.
        reset_bit: True if the last control word had the bit of fault reset.
    """

    def __init__(self) -> None:
        """Start with the power stage off."""
        self.state = OFF
        self.reset_bit = False

    def command(self, word: int) -> None:
        """Apply a control word. Only fault reset acts on an edge, all other bits act on their level."""
        edge = bool(word & 0x80) and not self.reset_bit
        self.reset_bit = bool(word & 0x80)
        if self.state == FAULT:
            self.state = OFF if edge else FAULT
            return
        if not word & 0x02 or not word & 0x04:
            self.state = OFF  # The command is disable voltage or quick stop.
        elif word & 0x07 == 0x06:
            self.state = READY
        elif self.state != OFF and word & 0x0F == 0x0F:
            self.state = ENABLED
        elif self.state != OFF and word & 0x0F == 0x07:
            self.state = ON

    def fail(self) -> None:
        """Enter fault."""
        self.state = FAULT


class PowerStruct(ctypes.Structure, Power):
    """The power state machine in the memory of a drive."""

    _fields_ = [(name, ctypes.c_int64) for name in ("state", "reset_bit")]
