"""The state machine of a CiA 402 drive's power stage.

Control words are its input. Source: fact sheet cia402.

Bits of the control word: 0 switch on, 1 enable voltage, 2 quick stop (the value 0 stops), 3 enable
operation, 7 fault reset (on its rising edge).

Choices: control word 0x0F in *ready to switch on* executes transitions 3 and 4 together. After a
quick stop, the state becomes *switch on disabled* without a further command. The state *fault
reaction active* is passed within one step.
"""

import ctypes
from typing import Any

from firmware_sim.compiled import inner

OFF, READY, ON, ENABLED, FAULT = range(5)
"""States of the power stage: switch on disabled, ready to switch on, switched on, operation enabled, fault."""
_WORDS = (0x40, 0x21, 0x23, 0x27, 0x08)
"""Bits of the status word that tell the state, by state."""


@inner
def status(power: Any) -> int:
    """Return the status word of a drive.

    Bit 4 is *voltage enabled*, bit 9 *remote*, and bit 12 *drive follows the target torque*. The
    other bits tell the state.
    """
    return _WORDS[power.state] | 1 << 4 | 1 << 9 | (1 << 12 if power.state == ENABLED else 0)


class Power:
    """The state machine of a drive's power stage.

    Attributes:
        state: OFF, READY, ON, ENABLED or FAULT.
        reset_bit: True if the bit fault reset was set in the last control word.
    """

    def __init__(self) -> None:
        """Start in the state *switch on disabled*, with the power stage off."""
        self.state = OFF
        self.reset_bit = False

    def command(self, word: int) -> None:
        """Apply a control word.

        Fault reset acts on its rising edge, all other bits act by their level.
        """
        edge = bool(word & 0x80) and not self.reset_bit
        self.reset_bit = bool(word & 0x80)
        if self.state == FAULT:
            self.state = OFF if edge else FAULT
            return
        if not word & 0x02 or not word & 0x04:
            self.state = OFF  # The control word commands *disable voltage* or *quick stop*.
        elif word & 0x07 == 0x06:
            self.state = READY
        elif self.state != OFF and word & 0x0F == 0x0F:
            self.state = ENABLED
        elif self.state != OFF and word & 0x0F == 0x07:
            self.state = ON

    def fail(self) -> None:
        """Enter the fault state."""
        self.state = FAULT


class PowerStruct(ctypes.Structure, Power):
    """The state machine of the power stage, stored in the row of a drive."""

    _fields_ = [(name, ctypes.c_int64) for name in ("state", "reset_bit")]
