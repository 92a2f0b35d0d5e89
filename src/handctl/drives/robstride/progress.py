"""Progress of the state machine of a RobStride motor, and the effect of mode and faults in its feedback."""

from typing import NamedTuple

from handctl.drives.contract import DrivePhase, DriveState
from handctl.drives.fault_causes import DriveFaultCause
from handctl.drives.readback import ReadbackCursor, RecheckCursor
from handctl.drives.robstride import codec

SILENT, CONFIGURING, READY, ENABLED, FAULT = DrivePhase

# Error codes added by handctl. These codes use the two bits between the faults in feedback and
# those in the fault report.
DROPPED_OUT_ERROR = 1 << 6
SETTING_MISMATCH_ERROR = 1 << 7
ENABLED_BY_OTHER_HOST_ERROR = 3 << 6
CAUSE_BY_ERROR = {
    DROPPED_OUT_ERROR: DriveFaultCause.DROPPED_OUT,
    SETTING_MISMATCH_ERROR: DriveFaultCause.MISMATCH,
    ENABLED_BY_OTHER_HOST_ERROR: DriveFaultCause.MISMATCH,
}
"""Cause of each error code added by handctl."""
CAUSE_BY_FAULT_BIT = {
    0: DriveFaultCause.VOLTAGE,
    10: DriveFaultCause.VOLTAGE,
    11: DriveFaultCause.VOLTAGE,
    2: DriveFaultCause.HOT,
    8: DriveFaultCause.HOT,
}
"""Cause of fault bits of the motor. All other bits have the cause OTHER."""
CLEAR_TRIES = 3
"""Number of feedback frames that may still show a fault after the clear command."""
SILENCE_TIMEOUT_NS = 250_000_000
"""Time without a frame after which the motor may have lost power, and therefore its parameters [ns]."""
WATCHDOG_TEXT = "disabled by itself: it restarted, or its watchdog fired"
"""Error text for a motor that has left the running mode without reporting a reason."""


class RobstrideProgress(NamedTuple):
    """State of the RobStride state machine between frames, stored in ``DriveState.private``.

    Attributes:
        cursor: position in the list of parameters to read back.
        configured: True if all parameters have their required values.
        enabled_by_other: True if the motor may make torque without a command of this host.
        enable_sent: True from the enable command until the motor reports reset mode.
        disabling: True while the motor is being stopped.
        disabling_ns: time of the first stop command [ns].
        clearing: number of feedback frames with a fault still to be ignored, while the fault is
            being cleared.
        ready_ns: time at which the last parameter was verified [ns].
        check: position in the repeated read-back of the enabled motor.
        serial: identifier of the motor's processor, 0 if unknown.
    """

    cursor: ReadbackCursor = ReadbackCursor()
    configured: bool = False
    enabled_by_other: bool = False
    enable_sent: bool = False
    disabling: bool = False
    disabling_ns: int = 0
    clearing: int = 0
    ready_ns: int = 0
    check: RecheckCursor = RecheckCursor()
    serial: int = 0

    @property
    def may_be_enabled(self) -> bool:
        """Return True if an enable command was sent, or the motor may make torque without one."""
        return self.enable_sent or self.enabled_by_other


def progress_of(state: DriveState) -> RobstrideProgress:
    """Return the RobStride progress in a drive state."""
    progress: RobstrideProgress = state.private
    return progress


def enter_fault(state: DriveState, error_code: int, text: str) -> DriveState:
    """Return the state in phase FAULT, with the given error code and text."""
    return state._replace(phase=FAULT, error=error_code, error_text=text)


def apply_status(state: DriveState, mode: int, fault: int) -> DriveState:
    """Return the state after feedback with a mode and faults.

    ``state`` already has the values of the same feedback.
    """
    progress = progress_of(state)
    if fault:
        return apply_fault(state, mode, fault)
    if mode == codec.RESET_MODE:
        return _state_when_stopped(state, progress)
    if mode == codec.RUNNING_MODE:
        return _state_when_running(state, progress)
    return _state_when_enabled_by_other(state, progress, "calibrating, but not by this host")


def apply_fault(state: DriveState, mode: int, fault: int) -> DriveState:
    """Return the state after a fault.

    A motor in reset mode makes no torque. In any other mode, it may still make torque.
    """
    progress = progress_of(state)
    if progress.clearing:
        return state._replace(private=progress._replace(clearing=progress.clearing - 1))
    off = mode == codec.RESET_MODE
    updated = progress._replace(
        enable_sent=progress.enable_sent and not off, enabled_by_other=not off
    )
    in_error = enter_fault(state._replace(private=updated), fault, fault_text(fault))
    return in_error._replace(phase=ENABLED) if progress.disabling and not off else in_error


def _state_when_stopped(state: DriveState, progress: RobstrideProgress) -> DriveState:
    """Return the state after the motor has reported reset mode without a fault."""
    off = progress._replace(enable_sent=False, enabled_by_other=False, clearing=0)
    if progress.disabling:
        # Feedback from before the stop command does not show the effect of this command.
        if state.feedback_t_ns < progress.disabling_ns:
            return state
        return state._replace(phase=FAULT if state.error else READY, private=off)
    if state.phase == ENABLED:
        return enter_fault(state._replace(private=off), DROPPED_OUT_ERROR, WATCHDOG_TEXT)
    off = off._replace(enable_sent=progress.enable_sent)
    return state._replace(phase=CONFIGURING if state.phase == SILENT else state.phase, private=off)


def _state_when_running(state: DriveState, progress: RobstrideProgress) -> DriveState:
    """Return the state after the motor has reported running mode."""
    if progress.enable_sent and state.phase != FAULT:
        return state if state.phase == ENABLED else state._replace(phase=ENABLED)
    return _state_when_enabled_by_other(state, progress, "enabled, but not by this host")


def _state_when_enabled_by_other(
    state: DriveState, progress: RobstrideProgress, text: str
) -> DriveState:
    """Return the state after the motor has reported a mode that another host has caused."""
    enabled = state._replace(private=progress._replace(enabled_by_other=True))
    if progress.disabling:
        return enabled._replace(phase=ENABLED)
    if state.phase in (READY, ENABLED):
        return enter_fault(enabled, ENABLED_BY_OTHER_HOST_ERROR, text)
    return enabled._replace(phase=CONFIGURING) if state.phase == SILENT else enabled


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
