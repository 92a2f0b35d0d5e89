"""State of the RobStride state machine, and the effect of mode and faults in feedback on this state."""

from typing import NamedTuple

from handctl.drives.contract import DriveFaultCause, DrivePhase, DriveState
from handctl.drives.readback import ReadbackCursor
from handctl.drives.robstride import codec
from handctl.drives.state_machine import (
    enter_fault,
    state_enabled_by_other_host,
    state_when_off,
    state_when_on,
)

SILENT, CONFIGURING, READY, ENABLED, FAULT = DrivePhase

# Error codes added by handctl. The added error codes use the two bits between the bits of the
# faults in feedback and the bits of the fault report.
DROPPED_OUT_ERROR = 1 << 6
SETTING_MISMATCH_ERROR = 1 << 7
ENABLED_BY_OTHER_HOST_ERROR = 3 << 6
CAUSE_BY_ERROR = {
    DROPPED_OUT_ERROR: DriveFaultCause.DROPPED_OUT,
    SETTING_MISMATCH_ERROR: DriveFaultCause.SETTING_MISMATCH,
    ENABLED_BY_OTHER_HOST_ERROR: DriveFaultCause.SETTING_MISMATCH,
}
"""Cause of each error code added by handctl."""
CAUSE_BY_FAULT_BIT = {
    0: DriveFaultCause.VOLTAGE,
    10: DriveFaultCause.VOLTAGE,
    11: DriveFaultCause.VOLTAGE,
    2: DriveFaultCause.OVERHEATED,
    8: DriveFaultCause.OVERHEATED,
}
"""Cause of fault bits of the motor. Fault bits that are not in this table have the cause OTHER."""
IGNORED_FAULT_COUNT = 3
"""Largest number of feedback frames with a fault that the host ignores after the clear command."""
WATCHDOG_TEXT = "disabled by itself: it restarted, or its watchdog fired"
"""Error text for a motor that has left the running mode without reporting a reason."""


class RobstrideProgress(NamedTuple):
    """State of the RobStride state machine between frames, stored in ``DriveState.protocol_state``.

    Attributes:
        cursor: position in the list of parameters to read back.
        is_configured: True if all parameters have their required values.
        enabled_by_other_host: True if the motor may make torque without a command of this host.
        is_enable_sent: True from the enable command until the motor reports reset mode.
        is_disabling: True while the motor is being stopped.
        disable_command_ns: time of the first stop command [ns].
        errors_to_ignore: number of further feedback frames with a fault that the host ignores,
            because the fault is being cleared.
        ready_ns: time at which the host verified the last parameter [ns].
        serial: identifier of the motor's processor, 0 if the identifier is unknown.
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


def get_progress(state: DriveState) -> RobstrideProgress:
    """Return the ``RobstrideProgress`` in the state of a drive."""
    progress: RobstrideProgress = state.protocol_state
    return progress


def apply_status(state: DriveState, mode: int, fault: int) -> DriveState:
    """Return the drive state after feedback with a mode and faults.

    The argument ``state`` already contains the values of the same feedback.
    """
    if fault:
        return apply_fault(state, mode, fault)
    if mode == codec.RESET_MODE:
        return state_when_off(state, state.phase == ENABLED, DROPPED_OUT_ERROR, WATCHDOG_TEXT)
    if mode == codec.RUNNING_MODE:
        return state_when_on(state, ENABLED_BY_OTHER_HOST_ERROR, "enabled, but not by this host")
    return state_enabled_by_other_host(
        state, ENABLED_BY_OTHER_HOST_ERROR, "calibrating, but not by this host"
    )


def apply_fault(state: DriveState, mode: int, fault: int) -> DriveState:
    """Return the drive state after the motor has reported a fault.

    A motor in reset mode makes no torque. In any other mode, a motor with a fault may still make
    torque.
    """
    progress = get_progress(state)
    if progress.errors_to_ignore:
        return state._replace(
            protocol_state=progress._replace(errors_to_ignore=progress.errors_to_ignore - 1)
        )
    is_off = mode == codec.RESET_MODE
    next_progress = progress._replace(
        is_enable_sent=progress.is_enable_sent and not is_off, enabled_by_other_host=not is_off
    )
    fault_state = enter_fault(
        state._replace(protocol_state=next_progress), fault, fault_text(fault)
    )
    return (
        fault_state._replace(phase=ENABLED) if progress.is_disabling and not is_off else fault_state
    )


def fault_text(fault: int) -> str:
    """Return the texts of the faults in an error code."""
    names = [
        codec.FAULT_TEXTS.get(bit, f"unknown fault bit {bit}")
        for bit in range(32)
        if fault >> bit & 1
    ]
    return ", ".join(dict.fromkeys(names))


def cause_of_error(error_code: int) -> DriveFaultCause:
    """Return the cause of a nonzero error code."""
    if error_code in CAUSE_BY_ERROR:
        return CAUSE_BY_ERROR[error_code]
    bits = [bit for bit in range(32) if error_code >> bit & 1]
    if not bits or any(bit not in codec.FAULT_TEXTS for bit in bits):
        return DriveFaultCause.UNKNOWN
    causes = [CAUSE_BY_FAULT_BIT.get(bit, DriveFaultCause.OTHER) for bit in bits]
    return next(
        (cause for cause in causes if cause != DriveFaultCause.OTHER), DriveFaultCause.OTHER
    )
