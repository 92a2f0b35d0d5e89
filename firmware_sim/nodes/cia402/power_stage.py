"""The state machine of the power stage of a CiA 402 drive.

The inputs of the state machine are control words. Source: fact sheet cia402.

Bits of the control word: 0 switch on, 1 enable voltage, 2 quick stop (the value 0 stops), 3 enable
operation, 7 fault reset (on its rising edge).

The fact sheet cia402 does not determine the following behaviour. In the state *ready to switch on*,
the control word 0x0F executes the transitions 3 and 4 together. After a quick stop, the drive
changes to the state *switch on disabled* without a further command. The drive leaves the state
*fault reaction active* within one step.
"""

import ctypes
from typing import Any

from firmware_sim.compiled import kernel_helper

OFF_STATE, READY_STATE, ON_STATE, ENABLED_STATE, FAULT_STATE = range(5)
"""States of the power stage: switch on disabled, ready to switch on, switched on, operation enabled, fault."""
_STATUS_WORD_BITS = (0x40, 0x21, 0x23, 0x27, 0x08)
"""Bits of the status word that encode each state."""


@kernel_helper
def status_word(power_stage: Any) -> int:
    """Return the status word of a drive.

    In the status word, bit 4 is *voltage enabled*, bit 9 *remote*, and bit 12 *drive follows the
    target torque*. The other bits of the status word encode the state.
    """
    return (
        _STATUS_WORD_BITS[power_stage.state]
        | 1 << 4
        | 1 << 9
        | (1 << 12 if power_stage.state == ENABLED_STATE else 0)
    )


class PowerStage:
    """The state machine of a drive's power stage.

    Attributes:
        state: OFF_STATE, READY_STATE, ON_STATE, ENABLED_STATE or FAULT_STATE.
        reset_bit: True if the last control word contained the bit *fault reset*.
    """

    def __init__(self) -> None:
        """Start in the state *switch on disabled*, with the power stage off."""
        self.state = OFF_STATE
        self.reset_bit = False

    def command(self, control_word: int) -> None:
        """Apply a control word.

        The bit *fault reset* (bit 7) acts on its rising edge. All other bits of the control word
        act by their level.
        """
        is_reset_edge = bool(control_word & 0x80) and not self.reset_bit
        self.reset_bit = bool(control_word & 0x80)
        if self.state == FAULT_STATE:
            self.state = OFF_STATE if is_reset_edge else FAULT_STATE
            return
        if not control_word & 0x02 or not control_word & 0x04:
            self.state = OFF_STATE  # In the branch below, the control word commands *disable voltage* or *quick stop*.
        elif control_word & 0x07 == 0x06:
            self.state = READY_STATE
        elif self.state != OFF_STATE and control_word & 0x0F == 0x0F:
            self.state = ENABLED_STATE
        elif self.state != OFF_STATE and control_word & 0x0F == 0x07:
            self.state = ON_STATE

    def enter_fault_state(self) -> None:
        """Enter the fault state."""
        self.state = FAULT_STATE


class PowerStruct(ctypes.Structure, PowerStage):
    """The state machine of a power stage. The state is stored in the array row of the drive."""

    _fields_ = [(name, ctypes.c_int64) for name in ("state", "reset_bit")]
