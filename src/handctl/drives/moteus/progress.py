"""State of the moteus state machine, and the effect of mode and fault code in feedback on this state."""

from typing import NamedTuple

from handctl.drives.contract import DriveFaultCause, DrivePhase, DriveState
from handctl.drives.moteus import codec
from handctl.drives.moteus.settings import DiagnosticChannel
from handctl.drives.readback import ReadbackCursor
from handctl.drives.state_machine import (
    enter_fault,
    state_enabled_by_other_host,
    state_when_off,
    state_when_on,
)

SILENT, CONFIGURING, READY, ENABLED, FAULT = DrivePhase

# Error codes added by handctl. The added error codes are larger than the fault codes of the drive.
DROPPED_OUT_ERROR = 0x100
SETTING_MISMATCH_ERROR = 0x101
ENABLED_BY_OTHER_HOST_ERROR = 0x102
CAUSE_BY_ERROR = {
    codec.FAULT_MODE: DriveFaultCause.OTHER, codec.TIMED_OUT: DriveFaultCause.WATCHDOG, 34: DriveFaultCause.VOLTAGE,
    40: DriveFaultCause.VOLTAGE, 38: DriveFaultCause.OVERHEATED,
    DROPPED_OUT_ERROR: DriveFaultCause.DROPPED_OUT, SETTING_MISMATCH_ERROR: DriveFaultCause.SETTING_MISMATCH,
    ENABLED_BY_OTHER_HOST_ERROR: DriveFaultCause.SETTING_MISMATCH,
} | dict.fromkeys(codec.FAULT_TEXTS.keys() - {34, 38, 40}, DriveFaultCause.OTHER)  # fmt: skip
"""Cause of each error, by the fault code, the mode, or the error code added by handctl."""
IGNORED_FAULT_COUNT = 3
"""Largest number of feedback frames with an error that the host ignores after the clear command."""
SERIAL_NUMBER_TRIES = 3
"""Largest number of requests for the serial number. Safety does not depend on the serial number."""


class MoteusProgress(NamedTuple):
    """State of the moteus state machine between frames, stored in ``DriveState.protocol_state``.

    Attributes:
        cursor: position in the list of settings to read back.
        channel: state of the exchange over the diagnostic text channel.
        is_configured: True if all settings have their required values.
        mode: mode of the drive in the latest feedback.
        enabled_by_other_host: True if the drive may make torque without a command of this host.
        is_enable_sent: True from the enable command until the drive reports the state stopped.
        is_disabling: True while the drive is being stopped.
        disable_command_ns: time of the first stop command [ns].
        errors_to_ignore: number of further feedback frames with an error that the host ignores,
            because the error is being cleared.
        ready_ns: time at which the host verified the last setting [ns].
        serial: serial number of the drive, 0 if the serial number is unknown.
    """

    cursor: ReadbackCursor = ReadbackCursor()
    channel: DiagnosticChannel = DiagnosticChannel()
    is_configured: bool = False
    mode: int = codec.STOPPED
    enabled_by_other_host: bool = False
    is_enable_sent: bool = False
    is_disabling: bool = False
    disable_command_ns: int = 0
    errors_to_ignore: int = 0
    ready_ns: int = 0
    serial: int = 0

    @property
    def may_be_enabled(self) -> bool:
        """Return True if this host or another host may have enabled the drive."""
        return self.is_enable_sent or self.enabled_by_other_host


def get_progress(state: DriveState) -> MoteusProgress:
    """Return the ``MoteusProgress`` in the state of a drive."""
    progress: MoteusProgress = state.protocol_state
    return progress


def apply_mode(state: DriveState, mode: int, fault: int) -> DriveState:
    """Return the drive state after feedback with a mode and a fault code.

    The argument ``state`` already contains the values of the same feedback.
    """
    progress = get_progress(state)
    was_preparing_control = progress.mode in codec.PREPARING_MODES
    if progress.mode != mode:
        progress = progress._replace(mode=mode)
        state = state._replace(protocol_state=progress)
    if mode == codec.STOPPED:
        # If this host had enabled the drive, or was enabling the drive, the drive has stopped
        # without a command.
        has_dropped_out = state.phase == ENABLED or (
            was_preparing_control and progress.is_enable_sent
        )
        return state_when_off(state, has_dropped_out, DROPPED_OUT_ERROR, "stopped by itself")
    if mode in (codec.FAULT_MODE, codec.TIMED_OUT):
        return _state_after_error(
            state, progress, fault if mode == codec.FAULT_MODE and fault else mode
        )
    if mode == codec.POSITION:
        return state_when_on(state, ENABLED_BY_OTHER_HOST_ERROR, "enabled, but not by this host")
    if mode in codec.PREPARING_MODES and progress.is_enable_sent and state.phase == READY:
        return state
    return _state_when_in_other_mode(state, progress)


def _state_when_in_other_mode(state: DriveState, progress: MoteusProgress) -> DriveState:
    """Return the drive state after feedback with a mode that this host does not use.

    In a mode that this host does not use, the drive may make torque.
    """
    if state.phase == ENABLED and progress.is_enable_sent and not progress.is_disabling:
        enabled_by_other_state = state._replace(
            protocol_state=progress._replace(enabled_by_other_host=True)
        )
        return enter_fault(
            enabled_by_other_state, DROPPED_OUT_ERROR, f"went to mode {progress.mode} by itself"
        )
    # Another host or a restart of the drive has caused the reported mode.
    return state_enabled_by_other_host(
        state, ENABLED_BY_OTHER_HOST_ERROR, f"in mode {progress.mode}, but not by this host"
    )


def _state_after_error(state: DriveState, progress: MoteusProgress, error_code: int) -> DriveState:
    """Return the drive state after the drive has reported an error.

    A drive with an error makes no torque.
    """
    if progress.errors_to_ignore:
        return state._replace(
            protocol_state=progress._replace(errors_to_ignore=progress.errors_to_ignore - 1)
        )
    off_state = state._replace(
        protocol_state=progress._replace(is_enable_sent=False, enabled_by_other_host=False)
    )
    return enter_fault(off_state, error_code, error_text(error_code))


def error_text(error_code: int) -> str:
    """Return the text that describes an error code of the drive."""
    if error_code == codec.TIMED_OUT:
        return "commands were missing: the drive's watchdog fired"
    if error_code == codec.FAULT_MODE:
        return "fault without a code"
    return codec.FAULT_TEXTS.get(error_code, f"unknown fault {error_code}")
