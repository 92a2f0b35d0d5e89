"""Progress of an MIT motor between frames, and the effect of the state nibble of its feedback."""

from typing import NamedTuple

from handctl.drives.causes import Cause
from handctl.drives.contract import DriveState, Phase
from handctl.drives.mit import codec
from handctl.drives.readback import Cursor, Recheck

SILENT, CONFIGURING, READY, ENABLED, FAULT = Phase

# Error codes of the host, above the nibbles of the drive.
#
# In order: disabled without a command, a wrong register value, an unknown state, enabled by another
# host.
DROPPED_OUT = 0x100
MISMATCH = 0x101
UNKNOWN = 0x102
ENABLED_BY_OTHERS = 0x103
CAUSES = {
    0x8: Cause.VOLTAGE, 0x9: Cause.VOLTAGE, 0xB: Cause.HOT, 0xC: Cause.HOT, 0xD: Cause.WATCHDOG,
    DROPPED_OUT: Cause.DROPPED_OUT, MISMATCH: Cause.MISMATCH, ENABLED_BY_OTHERS: Cause.MISMATCH,
} | dict.fromkeys(codec.ERRORS.keys() - {0x8, 0x9, 0xB, 0xC, 0xD}, Cause.OTHER)  # fmt: skip
"""Causes by state nibble, and by the error codes of the host."""
CLEAR_TRIES = 6
"""Feedback frames that may still carry an error after the command to clear the error, two in each tick."""
SILENCE_NS = 250_000_000
"""Silence after which a motor may have lost power, and with it its register values [ns]."""


class MitProgress(NamedTuple):
    """Progress of MIT mode, the content of ``DriveState.private``.

    Attributes:
        cursor: cursor of the register read-back.
        configured: True if all registers have their required values. Feedback can be decoded then.
        enabled_by_other: True if the motor reports enabled without a command of this host.
        enable_sent: True from the enable command to the next report of disabled.
        disabling: True while the motor is being disabled.
        disabling_ns: time of the first disable command [ns].
        clearing: feedback frames that may still carry the error being cleared.
        ready_ns: time at which all registers were right [ns].
        check: cursor of the read-back while enabled.
        serial: serial number, 0 if unknown.
    """

    cursor: Cursor = Cursor()
    configured: bool = False
    enabled_by_other: bool = False
    enable_sent: bool = False
    disabling: bool = False
    disabling_ns: int = 0
    clearing: int = 0
    ready_ns: int = 0
    check: Recheck = Recheck()
    serial: int = 0


def progress_of(state: DriveState) -> MitProgress:
    """Return the private part of a state."""
    progress: MitProgress = state.private
    return progress


def to_fault(state: DriveState, error: int, text: str) -> DriveState:
    """Return the state with an error."""
    return state._replace(phase=FAULT, error=error, error_text=text)


def apply_status(state: DriveState, nibble: int) -> DriveState:
    """Apply a state nibble to a state that has the values of the same feedback."""
    progress = progress_of(state)
    if nibble == codec.ENABLED:
        return _is_enabled(state, progress)
    if nibble == codec.DISABLED:
        return _is_disabled(state, progress)
    return _is_in_error(state, progress, nibble)


def _is_disabled(state: DriveState, progress: MitProgress) -> DriveState:
    """Apply a report of disabled."""
    off = progress._replace(enable_sent=False, enabled_by_other=False, clearing=0)
    if progress.disabling:
        # Feedback from before the disable command proves nothing.
        if state.feedback_t_ns < progress.disabling_ns:
            return state._replace(private=progress)
        return state._replace(phase=FAULT if state.error else READY, private=off)
    if state.phase == ENABLED:
        return to_fault(state._replace(private=off), DROPPED_OUT, "disabled by itself")
    off = off._replace(enable_sent=progress.enable_sent)
    return state._replace(phase=CONFIGURING if state.phase == SILENT else state.phase, private=off)


def _is_enabled(state: DriveState, progress: MitProgress) -> DriveState:
    """Apply a report of enabled."""
    if progress.enable_sent and state.phase != FAULT:
        return state if state.phase == ENABLED else state._replace(phase=ENABLED)
    enabled = state._replace(private=progress._replace(enabled_by_other=True))
    if progress.disabling:
        return enabled._replace(phase=ENABLED)
    if state.phase == READY:
        return to_fault(enabled, ENABLED_BY_OTHERS, "enabled, but not by this host")
    return enabled._replace(phase=CONFIGURING) if state.phase == SILENT else enabled


def _is_in_error(state: DriveState, progress: MitProgress, nibble: int) -> DriveState:
    """Apply an error. Known errors remove the torque, an unknown state may leave torque on."""
    if nibble in codec.ERRORS and progress.clearing:
        return state._replace(private=progress._replace(clearing=progress.clearing - 1))
    if nibble in codec.ERRORS:
        off = state._replace(private=progress._replace(enable_sent=False, enabled_by_other=False))
        return to_fault(off, nibble, codec.ERRORS[nibble])
    unknown = state._replace(private=progress._replace(enabled_by_other=True))
    unknown = to_fault(unknown, UNKNOWN, f"unknown state {nibble:#x}")
    return unknown._replace(phase=ENABLED) if progress.disabling else unknown
