"""State of the ODrive state machine, and the effect of heartbeats on this state.

Only heartbeats report the state of the drive.
"""

from typing import NamedTuple, cast

from handctl.drives.contract import DriveFaultCause, DrivePhase, DriveState
from handctl.drives.frame import Frame
from handctl.drives.odrive import codec
from handctl.drives.odrive import firmware_05 as odrive_05
from handctl.drives.readback import ReadbackCursor
from handctl.drives.state_machine import enter_fault

SILENT, CONFIGURING, READY, ENABLED, FAULT = DrivePhase
(
    DROPPED_OUT_ERROR,
    SETTING_MISMATCH_ERROR,
    ENABLE_REFUSED_ERROR,
    ENABLED_BY_OTHER_HOST_ERROR,
    DRIVE_LOST_ERROR,
) = (1 << 32 | number for number in range(5))
"""Error codes added by handctl. The added error codes are larger than the 32 error bits of the drive."""
CAUSE_BY_ERROR = {
    DROPPED_OUT_ERROR: DriveFaultCause.DROPPED_OUT, SETTING_MISMATCH_ERROR: DriveFaultCause.SETTING_MISMATCH,
    ENABLE_REFUSED_ERROR: DriveFaultCause.OTHER,
    ENABLED_BY_OTHER_HOST_ERROR: DriveFaultCause.SETTING_MISMATCH, DRIVE_LOST_ERROR: DriveFaultCause.COMMUNICATION_LOST,
}  # fmt: skip
"""Cause of each error code added by handctl."""
CAUSE_BY_ERROR_BIT = {
    8: DriveFaultCause.VOLTAGE, 9: DriveFaultCause.VOLTAGE, 11: DriveFaultCause.VOLTAGE, 13: DriveFaultCause.OVERHEATED,
    14: DriveFaultCause.OVERHEATED, 24: DriveFaultCause.WATCHDOG,
}  # fmt: skip
"""Cause of error bits in a heartbeat. Error bits that are not in this table have the cause OTHER."""
# Time after which the host repeats a request, and time between two temperature requests [ns].
REPEAT_PERIOD_NS = 20_000_000
TEMPERATURE_PERIOD_NS = 200_000_000
# Largest number of requests for the version, of heartbeats with an error that the host ignores
# after the clear command, and of requests for the serial number.
VERSION_TRIES = 10
IGNORED_FAULT_COUNT = 3
SERIAL_NUMBER_TRIES = 3
ENABLE_COMMANDS = 5
"""Number of enable commands without effect after which the drive is in fault."""
MAX_MISSED_HEARTBEATS = 3.5
"""Number of heartbeat periods after which a drive without a heartbeat counts as lost."""
SETTLE_TIME_NS = 5_000_000
"""Time after a command in which a received heartbeat may be older than the command [ns]."""


class OdriveProgress(NamedTuple):
    """State of the ODrive state machine between frames, stored in ``DriveState.protocol_state``.

    Attributes:
        version: True if the drive has reported the protocol version supported by handctl.
        serial: serial number of the drive, 0 if the serial number is unknown.
        serial_requests: number of requests for the serial number. If the number equals
            ``SERIAL_NUMBER_TRIES``, the host sends no more requests, because the drive has answered
            or does not answer.
        cursor: position in the list of endpoints to read back.
        is_configured: True if the host has sent control mode and limits.
        axis: axis state in the latest heartbeat.
        heartbeat_ns: time of the latest heartbeat [ns], -1 before the first heartbeat.
        enable_command_ns: time of the latest enable command [ns], -1 if the host has sent no enable
            command.
        disable_command_ns: time of the first disable command [ns], or -1 if the host has sent no
            disable command.
        sent_ns: time of the latest request for version or serial number [ns].
        tries: number of requests for the version that the host has sent.
        temperature_request_ns: time of the latest temperature request [ns].
        errors_to_ignore: number of further heartbeats with an error that the host ignores, because
            the error is being cleared.
        is_just_verified: True if the host verified all settings in the last tick. A drive cannot
            restart within one tick.
        enable_attempts: number of enable commands not obeyed by the drive.
    """

    version: bool = False
    serial: int = 0
    serial_requests: int = 0
    cursor: ReadbackCursor = ReadbackCursor()
    is_configured: bool = False
    axis: int = 0
    heartbeat_ns: int = -1
    enable_command_ns: int = -1
    disable_command_ns: int = -1
    sent_ns: int = -REPEAT_PERIOD_NS
    tries: int = 0
    temperature_request_ns: int = -TEMPERATURE_PERIOD_NS
    errors_to_ignore: int = 0
    is_just_verified: bool = False
    enable_attempts: int = 0

    @property
    def may_be_enabled(self) -> bool:
        """Return True if this host has sent an enable command, or if the reported axis state is not idle."""
        return self.enable_command_ns >= 0 or self.axis > codec.IDLE


def get_progress(state: DriveState) -> OdriveProgress:
    """Return the ``OdriveProgress`` in the state of a drive."""
    return cast(OdriveProgress, state.protocol_state)


def on_heartbeat(state: DriveState, frame: Frame, firmware_05: bool) -> DriveState:
    """Return the state of the drive after a heartbeat of 8 bytes.

    Args:
        state: state of the drive.
        frame: the heartbeat.
        firmware_05: True for firmware 0.5.
    """
    heartbeat = (
        odrive_05.decode_heartbeat(frame.data)
        if firmware_05
        else codec.decode_heartbeat(frame.data)
    )
    progress = get_progress(state)._replace(axis=heartbeat.state, heartbeat_ns=frame.t_ns)
    if heartbeat.errors and progress.errors_to_ignore:
        return state._replace(
            protocol_state=progress._replace(errors_to_ignore=progress.errors_to_ignore - 1)
        )
    next_state = state._replace(protocol_state=progress._replace(errors_to_ignore=0))
    if heartbeat.errors:
        return _state_after_error(next_state, progress, heartbeat, firmware_05)
    if heartbeat.state == codec.CLOSED_LOOP:
        return _state_when_enabled(next_state, progress)
    if heartbeat.state == codec.IDLE:
        return _state_when_disabled(next_state, progress, heartbeat)
    return _state_when_in_other_axis_state(next_state, progress)


def _state_after_error(
    state: DriveState, progress: OdriveProgress, heartbeat: codec.Heartbeat, firmware_05: bool
) -> DriveState:
    """Return the drive state after a heartbeat that reports an error.

    An ODrive with an error disables itself. Until the axis state is idle, the drive may still make
    torque.
    """
    error_text = odrive_05.error_text if firmware_05 else codec.error_text
    fault_state = enter_fault(state, heartbeat.errors, error_text(heartbeat.errors))
    if heartbeat.state == codec.IDLE:
        return fault_state._replace(
            protocol_state=progress._replace(
                enable_command_ns=-1, disable_command_ns=-1, errors_to_ignore=0
            )
        )
    return fault_state._replace(phase=ENABLED) if progress.disable_command_ns >= 0 else fault_state


def _state_when_enabled(state: DriveState, progress: OdriveProgress) -> DriveState:
    """Return the drive state after a heartbeat that reports closed loop control."""
    if progress.disable_command_ns >= 0 or (
        progress.enable_command_ns >= 0 and state.phase != FAULT
    ):
        return state._replace(
            phase=ENABLED, protocol_state=progress._replace(enable_attempts=0, errors_to_ignore=0)
        )
    if state.phase == READY:
        return enter_fault(
            state, ENABLED_BY_OTHER_HOST_ERROR, "in closed loop, but not by this host"
        )
    return state


def _state_when_in_other_axis_state(state: DriveState, progress: OdriveProgress) -> DriveState:
    """Return the drive state after a heartbeat with any other axis state, such as a calibration.

    In an axis state other than idle and closed loop control, the drive may make torque that the
    host does not control.
    """
    if state.phase == ENABLED and progress.disable_command_ns < 0:
        return enter_fault(
            state, DROPPED_OUT_ERROR, f"went to axis state {progress.axis} by itself"
        )
    if state.phase == READY and progress.enable_command_ns < 0 and progress.axis > codec.IDLE:
        return enter_fault(
            state,
            ENABLED_BY_OTHER_HOST_ERROR,
            f"in axis state {progress.axis}, but not by this host",
        )
    return state


def _state_when_disabled(
    state: DriveState, progress: OdriveProgress, heartbeat: codec.Heartbeat
) -> DriveState:
    """Return the drive state after a heartbeat that reports the axis state idle.

    Shortly after a command, the host may receive a heartbeat that the drive has sent before the
    command.
    """
    state_when_off = state._replace(
        protocol_state=progress._replace(enable_command_ns=-1, disable_command_ns=-1)
    )
    if progress.disable_command_ns >= 0:
        if progress.heartbeat_ns < progress.disable_command_ns + SETTLE_TIME_NS:
            return state
        return state_when_off._replace(phase=FAULT if state.error else READY)
    if state.phase == ENABLED:
        reason = f": {codec.result_text(heartbeat.result)}" if heartbeat.result else ""
        return enter_fault(state_when_off, DROPPED_OUT_ERROR, f"disabled by itself{reason}")
    if (
        0 <= progress.enable_command_ns < progress.heartbeat_ns - SETTLE_TIME_NS
        and heartbeat.result != codec.PROCEDURE_BUSY
    ):
        return _state_when_enable_failed(state, progress, heartbeat)
    return state._replace(phase=CONFIGURING) if state.phase == SILENT else state


def _state_when_enable_failed(
    state: DriveState, progress: OdriveProgress, heartbeat: codec.Heartbeat
) -> DriveState:
    """Return the drive state after a heartbeat that reports idle although an enable command was sent.

    A heartbeat that reports idle after an enable command has three possible causes: the drive has
    refused the command, the command was lost, or the drive has restarted.

    Because the host has no other sign of a restart, it verifies and writes all settings again
    before the next enable command.
    """
    if heartbeat.result != codec.PROCEDURE_SUCCESS:
        state_when_off = state._replace(protocol_state=progress._replace(enable_command_ns=-1))
        return enter_fault(
            state_when_off,
            ENABLE_REFUSED_ERROR,
            f"refuses to enable: {codec.result_text(heartbeat.result)}",
        )
    if progress.enable_attempts >= ENABLE_COMMANDS:
        state_when_off = state._replace(
            protocol_state=progress._replace(enable_command_ns=-1, enable_attempts=0)
        )
        return enter_fault(
            state_when_off,
            ENABLE_REFUSED_ERROR,
            f"stays idle after {ENABLE_COMMANDS} enable commands: it restarts, or ignores commands",
        )
    next_progress = OdriveProgress(
        version=progress.version,
        serial=progress.serial,
        serial_requests=progress.serial_requests,
        axis=progress.axis,
        heartbeat_ns=progress.heartbeat_ns,
        enable_attempts=progress.enable_attempts,
    )
    return state._replace(phase=CONFIGURING, protocol_state=next_progress)


def state_after_timeout(state: DriveState, firmware_05: bool) -> DriveState:
    """Return the state of a drive whose heartbeats have been missing for too long.

    An enabled drive goes into fault after the timeout. A disabled drive may have lost its power and
    thus its control mode.
    """
    progress = get_progress(state)
    if state.phase == ENABLED or progress.enable_command_ns >= 0:
        return enter_fault(state, DRIVE_LOST_ERROR, "no heartbeat")
    return state._replace(
        phase=SILENT,
        protocol_state=OdriveProgress(
            version=firmware_05, errors_to_ignore=progress.errors_to_ignore
        ),
    )


def start_disabling(state: DriveState, progress: OdriveProgress, t_ns: int) -> DriveState:
    """Return the state of a drive that is being disabled.

    If the drive may be enabled (``OdriveProgress.may_be_enabled``), the drive counts as enabled
    until a heartbeat reports idle.
    """
    if progress.disable_command_ns < 0:
        state = state._replace(protocol_state=progress._replace(disable_command_ns=t_ns))
    return state._replace(phase=ENABLED) if progress.may_be_enabled else state


def cause_of_error(error_code: int) -> DriveFaultCause:
    """Return the cause of a nonzero error code."""
    if error_code in CAUSE_BY_ERROR:
        return CAUSE_BY_ERROR[error_code]
    bits = [bit for bit in range(32) if error_code >> bit & 1]
    if any(bit not in codec.ERROR_TEXTS for bit in bits):
        return DriveFaultCause.UNKNOWN
    causes = [CAUSE_BY_ERROR_BIT.get(bit, DriveFaultCause.OTHER) for bit in bits]
    # If the watchdog has fired, the other errors are consequences of the missing commands.
    return next((cause for cause in causes if cause == DriveFaultCause.WATCHDOG), causes[0])
