"""Progress of a moteus controller between frames, and the effect of its mode and fault code."""

from typing import NamedTuple

from handctl.drives.causes import Cause
from handctl.drives.contract import DriveState, Phase
from handctl.drives.moteus import codec
from handctl.drives.moteus.settings import Channel
from handctl.drives.readback import Cursor, Recheck

SILENT, CONFIGURING, READY, ENABLED, FAULT = Phase

# Error codes of the host, above the fault codes of the drive.
DROPPED_OUT = 0x100
MISMATCH = 0x101
ENABLED_BY_OTHERS = 0x102
CAUSES = {
    codec.IN_FAULT: Cause.OTHER, codec.TIMED_OUT: Cause.WATCHDOG, 34: Cause.VOLTAGE, 40: Cause.VOLTAGE, 38: Cause.HOT,
    DROPPED_OUT: Cause.DROPPED_OUT, MISMATCH: Cause.MISMATCH, ENABLED_BY_OTHERS: Cause.MISMATCH,
} | dict.fromkeys(codec.FAULTS.keys() - {34, 38, 40}, Cause.OTHER)  # fmt: skip
"""Causes by fault code, by mode, and by the error codes of the host."""
CLEAR_TRIES = 3
"""Feedback frames that may still carry an error after the stop command that clears the error."""
SILENCE_NS = 250_000_000
"""Silence after which a drive may have lost power, and with it its settings [ns]."""
SERIAL_TRIES = 3
"""Requests for the serial number, which no safety depends on."""


class MoteusProgress(NamedTuple):
    """Progress of a moteus controller, the content of ``DriveState.private``.

    Attributes:
        cursor: cursor of the read-back.
        channel: exchange over the text channel.
        configured: True if all settings have their required values.
        mode: latest mode.
        enabled_by_other: True if the drive may make torque without a command of this host.
        enable_sent: True from the enable command to the next report of stopped.
        disabling: True while the drive is being stopped.
        disabling_ns: time of the first stop command [ns].
        clearing: feedback frames that may still carry the error being cleared.
        ready_ns: time at which all settings were right [ns].
        check: cursor of the read-back while enabled.
        serial: serial number, 0 if unknown.
    """

    cursor: Cursor = Cursor()
    channel: Channel = Channel()
    configured: bool = False
    mode: int = codec.STOPPED
    enabled_by_other: bool = False
    enable_sent: bool = False
    disabling: bool = False
    disabling_ns: int = 0
    clearing: int = 0
    ready_ns: int = 0
    check: Recheck = Recheck()
    serial: int = 0


def progress_of(state: DriveState) -> MoteusProgress:
    """Return the private part of a state."""
    progress: MoteusProgress = state.private
    return progress


def to_fault(state: DriveState, error: int, text: str) -> DriveState:
    """Return the state with an error."""
    return state._replace(phase=FAULT, error=error, error_text=text)


def apply_mode(state: DriveState, mode: int, fault: int) -> DriveState:
    """Apply a mode and a fault code to a state that has the values of the same feedback."""
    progress = progress_of(state)
    if progress.mode != mode:
        progress = progress._replace(mode=mode)
        state = state._replace(private=progress)
    if mode == codec.STOPPED:
        return _is_stopped(state, progress)
    if mode in (codec.IN_FAULT, codec.TIMED_OUT):
        return _is_in_error(state, progress, fault if mode == codec.IN_FAULT and fault else mode)
    if mode == codec.POSITION:
        return _is_enabled(state, progress)
    if mode in codec.PREPARING and progress.enable_sent and state.phase == READY:
        return state
    return _is_in_other_mode(state, progress)


def _is_stopped(state: DriveState, progress: MoteusProgress) -> DriveState:
    """Apply a report of stopped."""
    off = progress._replace(enable_sent=False, enabled_by_other=False, clearing=0)
    if progress.disabling:
        # Feedback from before the stop command proves nothing.
        if state.feedback_t_ns < progress.disabling_ns:
            return state
        return state._replace(phase=FAULT if state.error else READY, private=off)
    if state.phase == ENABLED:
        return to_fault(state._replace(private=off), DROPPED_OUT, "stopped by itself")
    off = off._replace(enable_sent=progress.enable_sent)
    return state._replace(phase=CONFIGURING if state.phase == SILENT else state.phase, private=off)


def _is_enabled(state: DriveState, progress: MoteusProgress) -> DriveState:
    """Apply a report of position mode."""
    if progress.enable_sent and state.phase != FAULT:
        return state if state.phase == ENABLED else state._replace(phase=ENABLED)
    return _is_enabled_by_other(state, progress, "enabled, but not by this host")


def _is_in_other_mode(state: DriveState, progress: MoteusProgress) -> DriveState:
    """Apply a report of a mode that the host does not use. The drive may make torque."""
    if state.phase == ENABLED and progress.enable_sent and not progress.disabling:
        enabled = state._replace(private=progress._replace(enabled_by_other=True))
        return to_fault(enabled, DROPPED_OUT, f"went to mode {progress.mode} by itself")
    return _is_enabled_by_other(state, progress, f"in mode {progress.mode}, but not by this host")


def _is_enabled_by_other(state: DriveState, progress: MoteusProgress, text: str) -> DriveState:
    """Apply a report of a mode that another host or a restart has caused."""
    enabled = state._replace(private=progress._replace(enabled_by_other=True))
    if progress.disabling:
        return enabled._replace(phase=ENABLED)
    if state.phase == READY:
        return to_fault(enabled, ENABLED_BY_OTHERS, text)
    return enabled._replace(phase=CONFIGURING) if state.phase == SILENT else enabled


def _is_in_error(state: DriveState, progress: MoteusProgress, error: int) -> DriveState:
    """Apply an error, which has removed the torque."""
    if progress.clearing:
        return state._replace(private=progress._replace(clearing=progress.clearing - 1))
    off = state._replace(private=progress._replace(enable_sent=False, enabled_by_other=False))
    return to_fault(off, error, error_text(error))


def error_text(error: int) -> str:
    """Return an error of the drive in words."""
    if error == codec.TIMED_OUT:
        return "commands were missing: the drive's watchdog fired"
    if error == codec.IN_FAULT:
        return "fault without a code"
    return codec.FAULTS.get(error, f"unknown fault {error}")
