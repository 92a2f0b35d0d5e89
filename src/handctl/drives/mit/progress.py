"""State of the Damiao state machine, and the effect of the state nibble in feedback on this state."""

from typing import NamedTuple

from handctl.drives.contract import DriveFaultCause, DrivePhase, DriveState
from handctl.drives.mit import codec
from handctl.drives.readback import ReadbackCursor
from handctl.drives.state_machine import enter_fault, state_when_off, state_when_on

SILENT, CONFIGURING, READY, ENABLED, FAULT = DrivePhase

# Error codes added by handctl. The added error codes are larger than the state nibbles of the
# motor.
#
# Meaning of the added error codes, in the order of the constants: the motor has disabled itself
# without a command, has a wrong register value, reports an unknown state, or was enabled by another
# host.
DROPPED_OUT_ERROR = 0x100
SETTING_MISMATCH_ERROR = 0x101
UNKNOWN_STATUS_ERROR = 0x102
ENABLED_BY_OTHER_HOST_ERROR = 0x103
CAUSE_BY_ERROR = {
    0x8: DriveFaultCause.VOLTAGE, 0x9: DriveFaultCause.VOLTAGE, 0xB: DriveFaultCause.OVERHEATED,
    0xC: DriveFaultCause.OVERHEATED, 0xD: DriveFaultCause.WATCHDOG,
    DROPPED_OUT_ERROR: DriveFaultCause.DROPPED_OUT, SETTING_MISMATCH_ERROR: DriveFaultCause.SETTING_MISMATCH,
    ENABLED_BY_OTHER_HOST_ERROR: DriveFaultCause.SETTING_MISMATCH,
} | dict.fromkeys(codec.ERROR_TEXTS.keys() - {0x8, 0x9, 0xB, 0xC, 0xD}, DriveFaultCause.OTHER)  # fmt: skip
"""Cause of each error, by the state nibble or by the error code added by handctl."""
WATCHDOG_FIRED = 0xD
"""State nibble of a motor whose watchdog has fired."""
WATCHDOG_FIRES_WHILE_DISABLED_TEXT = "its watchdog also fires while it is disabled"
"""Text shown for a disabled motor that has reported WATCHDOG_FIRED.

If a disabled motor reports WATCHDOG_FIRED, the host does not report a fault, and sends clear
commands.
"""
IGNORED_FAULT_COUNT = 6
"""Largest number of feedback frames with an error that the host ignores after the clear command.

While the error is being cleared, the motor sends two frames per tick.
"""


class MitProgress(NamedTuple):
    """State of the MIT state machine between frames, stored in ``DriveState.protocol_state``.

    Attributes:
        cursor: position in the list of registers to read back.
        is_configured: True if all registers have their required values. The feedback can be decoded
            only after all registers have their required values.
        enabled_by_other_host: True if the motor reports the state enabled without a command of this
            host.
        is_enable_sent: True from the enable command until the motor reports the state disabled.
        is_disabling: True while the motor is being disabled.
        disable_command_ns: time of the first disable command [ns].
        errors_to_ignore: number of further feedback frames with an error that the host ignores,
            because the error is being cleared.
        ready_ns: time at which the host verified the last register [ns].
        serial: serial number of the motor, 0 if the serial number is unknown.
    """

    cursor: ReadbackCursor = ReadbackCursor()
    is_configured: bool = False
    enabled_by_other_host: bool = False
    is_enable_sent: bool = False
    is_disabling: bool = False
    disable_command_ns: int = 0
    errors_to_ignore: int = 0
    ready_ns: int = 0
    serial: int = 0

    @property
    def may_be_enabled(self) -> bool:
        """Return True if this host or another host may have enabled the motor."""
        return self.is_enable_sent or self.enabled_by_other_host


def get_progress(state: DriveState) -> MitProgress:
    """Return the ``MitProgress`` in the state of a drive."""
    progress: MitProgress = state.protocol_state
    return progress


def apply_status(state: DriveState, status_nibble: int) -> DriveState:
    """Return the drive state after feedback with a state nibble.

    The argument ``state`` already contains the values of the same feedback.
    """
    progress = get_progress(state)
    if status_nibble == codec.ENABLED:
        return state_when_on(state, ENABLED_BY_OTHER_HOST_ERROR, "enabled, but not by this host")
    if status_nibble == codec.DISABLED:
        has_dropped_out = state.phase == ENABLED
        return state_when_off(state, has_dropped_out, DROPPED_OUT_ERROR, "disabled by itself")
    return _state_after_error(state, progress, status_nibble)


def _state_after_error(state: DriveState, progress: MitProgress, status_nibble: int) -> DriveState:
    """Return the drive state after the motor has reported an error.

    A motor with a known error makes no torque. A motor with an unknown state nibble may still make
    torque.
    """
    if status_nibble in codec.ERROR_TEXTS and progress.errors_to_ignore:
        return state._replace(
            protocol_state=progress._replace(errors_to_ignore=progress.errors_to_ignore - 1)
        )
    is_idle = not (
        progress.is_enable_sent or progress.enabled_by_other_host or progress.is_disabling
    )
    if status_nibble == WATCHDOG_FIRED and is_idle and state.phase in (CONFIGURING, READY):
        # The motor's watchdog has fired, because register requests do not restart the watchdog. The
        # motor makes no torque, so no operator has to clear the error.
        return state._replace(
            error_text=WATCHDOG_FIRES_WHILE_DISABLED_TEXT,
            protocol_state=progress._replace(errors_to_ignore=IGNORED_FAULT_COUNT),
        )
    if status_nibble in codec.ERROR_TEXTS:
        off_state = state._replace(
            protocol_state=progress._replace(is_enable_sent=False, enabled_by_other_host=False)
        )
        return enter_fault(off_state, status_nibble, codec.ERROR_TEXTS[status_nibble])
    enabled_by_other_state = state._replace(
        protocol_state=progress._replace(enabled_by_other_host=True)
    )
    enabled_by_other_state = enter_fault(
        enabled_by_other_state, UNKNOWN_STATUS_ERROR, f"unknown state {status_nibble:#x}"
    )
    return (
        enabled_by_other_state._replace(phase=ENABLED)
        if progress.is_disabling
        else enabled_by_other_state
    )
