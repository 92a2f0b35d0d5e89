"""Progress of the state machine of a Damiao motor, and the effect of the state nibble in its feedback."""

from typing import NamedTuple

from handctl.drives.contract import DrivePhase, DriveState
from handctl.drives.fault_causes import DriveFaultCause
from handctl.drives.mit import codec
from handctl.drives.readback import ReadbackCursor, RecheckCursor

SILENT, CONFIGURING, READY, ENABLED, FAULT = DrivePhase

# Error codes added by handctl. These codes are larger than the state nibbles of the motor.
#
# In this order, the motor has disabled itself without a command, has a wrong register value,
# reports an unknown state, or was enabled by another host.
DROPPED_OUT_ERROR = 0x100
SETTING_MISMATCH_ERROR = 0x101
UNKNOWN_STATUS_ERROR = 0x102
ENABLED_BY_OTHER_HOST_ERROR = 0x103
CAUSE_BY_ERROR = {
    0x8: DriveFaultCause.VOLTAGE, 0x9: DriveFaultCause.VOLTAGE, 0xB: DriveFaultCause.HOT, 0xC: DriveFaultCause.HOT,
    0xD: DriveFaultCause.WATCHDOG,
    DROPPED_OUT_ERROR: DriveFaultCause.DROPPED_OUT, SETTING_MISMATCH_ERROR: DriveFaultCause.MISMATCH,
    ENABLED_BY_OTHER_HOST_ERROR: DriveFaultCause.MISMATCH,
} | dict.fromkeys(codec.ERROR_TEXTS.keys() - {0x8, 0x9, 0xB, 0xC, 0xD}, DriveFaultCause.OTHER)  # fmt: skip
"""Cause of each error, by the state nibble or by the error code added by handctl."""
WATCHDOG_FIRED = 0xD
"""State nibble of a motor whose watchdog has fired."""
FIRES_WHILE_DISABLED_TEXT = "its watchdog also fires while it is disabled"
"""Text for a disabled motor that has reported WATCHDOG_FIRED.

The host treats this report as no fault, and sends clear commands.
"""
CLEAR_TRIES = 6
"""Number of feedback frames that may still show an error after the clear command.

While the error is being cleared, the motor sends two frames per tick.
"""
SILENCE_TIMEOUT_NS = 250_000_000
"""Time without a frame after which the motor may have lost power, and therefore its register values [ns]."""


class MitProgress(NamedTuple):
    """State of the MIT state machine between frames, stored in ``DriveState.private``.

    Attributes:
        cursor: position in the list of registers to read back.
        configured: True if all registers have their required values. Feedback can be decoded only
            then.
        enabled_by_other: True if the motor reports the state enabled without a command of this
            host.
        enable_sent: True from the enable command until the motor reports the state disabled.
        disabling: True while the motor is being disabled.
        disabling_ns: time of the first disable command [ns].
        clearing: number of feedback frames with an error still to be ignored, while the error is
            being cleared.
        ready_ns: time at which the last register was verified [ns].
        check: position in the repeated read-back of the enabled motor.
        serial: serial number of the motor, 0 if unknown.
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


def progress_of(state: DriveState) -> MitProgress:
    """Return the MIT progress in a drive state."""
    progress: MitProgress = state.private
    return progress


def enter_fault(state: DriveState, error_code: int, text: str) -> DriveState:
    """Return the state in phase FAULT, with the given error code and text."""
    return state._replace(phase=FAULT, error=error_code, error_text=text)


def apply_status(state: DriveState, nibble: int) -> DriveState:
    """Return the state after feedback with a state nibble.

    ``state`` already has the values of the same feedback.
    """
    progress = progress_of(state)
    if nibble == codec.ENABLED:
        return _state_when_enabled(state, progress)
    if nibble == codec.DISABLED:
        return _state_when_disabled(state, progress)
    return _state_after_error(state, progress, nibble)


def _state_when_disabled(state: DriveState, progress: MitProgress) -> DriveState:
    """Return the state after the motor has reported the state disabled."""
    off = progress._replace(enable_sent=False, enabled_by_other=False, clearing=0)
    if progress.disabling:
        # Feedback from before the disable command does not show the effect of this command.
        if state.feedback_t_ns < progress.disabling_ns:
            return state._replace(private=progress)
        return state._replace(phase=FAULT if state.error else READY, private=off)
    if state.phase == ENABLED:
        return enter_fault(state._replace(private=off), DROPPED_OUT_ERROR, "disabled by itself")
    off = off._replace(enable_sent=progress.enable_sent)
    return state._replace(phase=CONFIGURING if state.phase == SILENT else state.phase, private=off)


def _state_when_enabled(state: DriveState, progress: MitProgress) -> DriveState:
    """Return the state after the motor has reported the state enabled."""
    if progress.enable_sent and state.phase != FAULT:
        return state if state.phase == ENABLED else state._replace(phase=ENABLED)
    enabled = state._replace(private=progress._replace(enabled_by_other=True))
    if progress.disabling:
        return enabled._replace(phase=ENABLED)
    if state.phase == READY:
        return enter_fault(enabled, ENABLED_BY_OTHER_HOST_ERROR, "enabled, but not by this host")
    return enabled._replace(phase=CONFIGURING) if state.phase == SILENT else enabled


def _state_after_error(state: DriveState, progress: MitProgress, nibble: int) -> DriveState:
    """Return the state after the motor has reported an error.

    A motor with a known error makes no torque. A motor with an unknown state nibble may still make
    torque.
    """
    if nibble in codec.ERROR_TEXTS and progress.clearing:
        return state._replace(private=progress._replace(clearing=progress.clearing - 1))
    idle = not (progress.enable_sent or progress.enabled_by_other or progress.disabling)
    if nibble == WATCHDOG_FIRED and idle and state.phase in (CONFIGURING, READY):
        # The watchdog has fired, because register requests do not restart it. The motor makes no
        # torque, so no operator has to clear the error.
        return state._replace(
            error_text=FIRES_WHILE_DISABLED_TEXT, private=progress._replace(clearing=CLEAR_TRIES)
        )
    if nibble in codec.ERROR_TEXTS:
        off = state._replace(private=progress._replace(enable_sent=False, enabled_by_other=False))
        return enter_fault(off, nibble, codec.ERROR_TEXTS[nibble])
    unknown = state._replace(private=progress._replace(enabled_by_other=True))
    unknown = enter_fault(unknown, UNKNOWN_STATUS_ERROR, f"unknown state {nibble:#x}")
    return unknown._replace(phase=ENABLED) if progress.disabling else unknown
