"""State of the CiA 402 state machine, and the effects of status words and heartbeats on this state."""

from typing import NamedTuple, cast

from handctl.drives.canopen.codec import BOOT_UP, OPERATIONAL
from handctl.drives.canopen.setup import REPEAT_PERIOD_NS
from handctl.drives.cia402 import codec
from handctl.drives.contract import DriveFaultCause, DrivePhase, DriveState
from handctl.drives.frame import Frame
from handctl.drives.readback import ReadbackCursor
from handctl.drives.state_machine import enter_fault

SILENT, CONFIGURING, READY, ENABLED, FAULT = DrivePhase

# Error codes added by handctl. The added error codes are larger than the 16-bit error codes of
# emergencies.
DROPPED_OUT_ERROR = 0x1_0000
SETTING_MISMATCH_ERROR = 0x1_0001
DRIVE_LOST_ERROR = 0x1_0002
ENABLED_BY_OTHER_HOST_ERROR = 0x1_0003
CAUSE_BY_ERROR = {
    0x3210: DriveFaultCause.VOLTAGE, 0x3220: DriveFaultCause.VOLTAGE, 0x4210: DriveFaultCause.OVERHEATED,
    0x4310: DriveFaultCause.OVERHEATED, 0x8130: DriveFaultCause.WATCHDOG,
    0x8250: DriveFaultCause.WATCHDOG, 0x8100: DriveFaultCause.DROPPED_OUT,
    DROPPED_OUT_ERROR: DriveFaultCause.DROPPED_OUT, DRIVE_LOST_ERROR: DriveFaultCause.COMMUNICATION_LOST,
    SETTING_MISMATCH_ERROR: DriveFaultCause.SETTING_MISMATCH,
    ENABLED_BY_OTHER_HOST_ERROR: DriveFaultCause.SETTING_MISMATCH,
}  # fmt: skip
"""Cause of error codes, from emergencies or added by handctl.

A documented error code that is not in this table has the cause OTHER.
"""
IGNORED_FAULT_COUNT = 20
"""Largest number of status words with a fault that the host ignores after the clear command."""


class Cia402Progress(NamedTuple):
    """State of the CiA 402 state machine between frames, stored in ``DriveState.protocol_state``.

    Attributes:
        cursor: position in the list of objects to read back.
        power_state: power state in the latest status word, or an empty text before the first status word.
        error_code: error code in the latest emergency frame.
        life_sign_ns: time of the latest heartbeat or status word of the drive [ns], -1 before the
            first life sign.
        started_ns: time of the latest NMT start [ns].
        heartbeat_sent_ns: time of this host's latest heartbeat [ns].
        is_enable_sent: True from the enable command until the drive reports the state disabled.
        disable_command_ns: time of the first disable command [ns], or -1 if the host has sent no
            disable command.
        errors_to_ignore: number of further status words with a fault that the host ignores, because
            the fault is being cleared.
        serial: serial number of the drive, 0 if the serial number is unknown.
    """

    cursor: ReadbackCursor = ReadbackCursor()
    power_state: str = ""
    error_code: int = 0
    life_sign_ns: int = -1
    started_ns: int = -REPEAT_PERIOD_NS
    heartbeat_sent_ns: int = -REPEAT_PERIOD_NS
    is_enable_sent: bool = False
    disable_command_ns: int = -1
    errors_to_ignore: int = 0
    serial: int = 0

    @property
    def may_be_enabled(self) -> bool:
        """Return True if the drive may be enabled.

        The drive may be enabled after an enable command of this host, or in a power state with
        torque.
        """
        return self.is_enable_sent or (
            self.power_state != "" and self.power_state not in codec.STATES_WITHOUT_TORQUE
        )


def get_progress(state: DriveState) -> Cia402Progress:
    """Return the ``Cia402Progress`` in the state of a drive."""
    return cast(Cia402Progress, state.protocol_state)


def apply_power_state(state: DriveState, progress: Cia402Progress) -> DriveState:
    """Return the state of a drive after a status word.

    The argument ``progress`` already contains the power state of the received status word.
    """
    power = progress.power_state
    next_state = state._replace(protocol_state=progress)
    if power == codec.FAULT:
        return _state_when_fault(next_state, progress)
    if progress.disable_command_ns >= 0:
        is_off = (
            power in codec.STATES_WITHOUT_TORQUE
            and state.feedback_t_ns >= progress.disable_command_ns
        )
        if not is_off:
            return next_state._replace(phase=ENABLED)
        disabled_state = next_state._replace(
            protocol_state=progress._replace(is_enable_sent=False, disable_command_ns=-1)
        )
        return disabled_state._replace(phase=FAULT if state.error else READY)
    if state.phase == ENABLED and power != codec.OPERATION_ENABLED:
        return enter_fault(
            next_state._replace(protocol_state=progress._replace(is_enable_sent=False)),
            DROPPED_OUT_ERROR,
            f"fell to {power!r} by itself",
        )
    if power == codec.OPERATION_ENABLED:
        if progress.is_enable_sent:
            return next_state._replace(phase=ENABLED) if state.phase == READY else next_state
        return (
            enter_fault(next_state, ENABLED_BY_OTHER_HOST_ERROR, "enabled, but not by this host")
            if state.phase != FAULT
            else next_state
        )
    if state.phase == CONFIGURING and power in codec.STATES_WITHOUT_TORQUE:
        return next_state._replace(
            phase=READY, error_text="", protocol_state=progress._replace(errors_to_ignore=0)
        )
    return next_state


def _state_when_fault(state: DriveState, progress: Cia402Progress) -> DriveState:
    """Return the drive state after the drive has reported a fault, with the error code of the latest emergency."""
    if progress.errors_to_ignore:
        return state._replace(
            protocol_state=progress._replace(errors_to_ignore=progress.errors_to_ignore - 1)
        )
    state_when_off = state._replace(
        protocol_state=progress._replace(is_enable_sent=False, disable_command_ns=-1)
    )
    text = (
        codec.error_text(progress.error_code)
        if progress.error_code
        else "fault, and its emergency message was not heard"
    )
    return enter_fault(state_when_off, progress.error_code or DROPPED_OUT_ERROR, text)


def on_heartbeat(state: DriveState, frame: Frame) -> DriveState:
    """Return the drive state after a heartbeat of the drive.

    If the drive has left the NMT state operational, the drive was stopped or has restarted. A drive
    that has restarted has lost its settings.
    """
    progress = get_progress(state)._replace(life_sign_ns=frame.t_ns)
    if (
        frame.data[0] == OPERATIONAL
        or state.phase not in (READY, ENABLED)
        or progress.disable_command_ns >= 0
    ):
        return state._replace(protocol_state=progress)
    if state.phase == ENABLED or progress.is_enable_sent:
        problem = "restarted" if frame.data[0] == BOOT_UP else "left the state operational"
        return enter_fault(state._replace(protocol_state=progress), DROPPED_OUT_ERROR, problem)
    return state._replace(phase=SILENT, protocol_state=Cia402Progress())


def state_after_timeout(state: DriveState) -> DriveState:
    """Return the state of a drive from which no frame has arrived for too long.

    An enabled drive goes into fault after the timeout. A disabled drive may have restarted during
    the timeout, so the host reads back the objects of the drive again.
    """
    progress = get_progress(state)
    if state.phase == FAULT or progress.disable_command_ns >= 0:
        return state
    if state.phase == ENABLED or progress.is_enable_sent:
        return enter_fault(state, DRIVE_LOST_ERROR, "no heartbeat")
    if state.phase == READY:
        return state._replace(
            phase=SILENT, protocol_state=Cia402Progress(errors_to_ignore=progress.errors_to_ignore)
        )
    return state
