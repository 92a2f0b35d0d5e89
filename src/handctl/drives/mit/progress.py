"""What is known of an MIT motor between two frames, and what the state nibble of its feedback changes."""

from typing import NamedTuple

from handctl.drives.causes import Cause
from handctl.drives.contract import DriveState, Phase
from handctl.drives.mit import codec
from handctl.drives.readback import Recheck, Walk

SILENT, CONFIGURING, READY, ENABLED, FAULT = Phase

DROPPED_OUT, MISMATCH, UNKNOWN, ENABLED_BY_OTHERS = 0x100, 0x101, 0x102, 0x103
"""Error codes of our own: disabled by itself, a register that does not read back, an unknown state, and that."""
CAUSES = {
    0x8: Cause.VOLTAGE, 0x9: Cause.VOLTAGE, 0xB: Cause.HOT, 0xC: Cause.HOT, 0xD: Cause.WATCHDOG,
    DROPPED_OUT: Cause.DROPPED_OUT, MISMATCH: Cause.MISMATCH, ENABLED_BY_OTHERS: Cause.MISMATCH,
} | dict.fromkeys(codec.ERRORS.keys() - {0x8, 0x9, 0xB, 0xC, 0xD}, Cause.OTHER)  # fmt: skip
"""By the state nibble of the feedback, and by our own codes."""
CLEAR_TRIES = 3
GONE_NS = 250_000_000
"""After this silence a motor may have lost power, and with it what was written into its registers [ns]."""


class Progress(NamedTuple):
    """What MIT mode keeps in ``DriveState.private``.

    Attributes:
        walk: how far its registers are known.
        configured: whether all registers read as wanted, so that feedback can be decoded.
        found_enabled: whether it says that it is enabled although it was not told to.
        asked: whether it was told to enable, and has not said since that it is disabled.
        disabling: whether it is being told to disable.
        disabling_ns: since when [ns].
        clearing: how many answers may still carry the error that is being cleared.
        ready_ns: when its registers were known [ns].
        check: how far its registers were read again while it is enabled.
        serial: its serial number; 0 if it has not told one.
    """

    walk: Walk = Walk()
    configured: bool = False
    found_enabled: bool = False
    asked: bool = False
    disabling: bool = False
    disabling_ns: int = 0
    clearing: int = 0
    ready_ns: int = 0
    check: Recheck = Recheck()
    serial: int = 0


def progress_of(state: DriveState) -> Progress:
    """The private part of a state."""
    progress: Progress = state.private
    return progress


def fault(state: DriveState, error: int, text: str) -> DriveState:
    """The state in error."""
    return state._replace(phase=FAULT, error=error, error_text=text)


def judge(state: DriveState, nibble: int) -> DriveState:
    """What a state nibble means to a state that has the values of the same feedback already."""
    progress = progress_of(state)
    if nibble == codec.ENABLED:
        return _is_enabled(state, progress)
    if nibble == codec.DISABLED:
        return _is_disabled(state, progress)
    return _is_wrong(state, progress, nibble)


def _is_disabled(state: DriveState, progress: Progress) -> DriveState:
    off = progress._replace(asked=False, found_enabled=False, clearing=0)
    if progress.disabling:
        if state.feedback_t_ns < progress.disabling_ns:
            return state._replace(private=progress)
        return state._replace(phase=FAULT if state.error else READY, private=off)
    if state.phase == ENABLED:
        return fault(state._replace(private=off), DROPPED_OUT, "disabled by itself")
    off = off._replace(asked=progress.asked)
    return state._replace(phase=CONFIGURING if state.phase == SILENT else state.phase, private=off)


def _is_enabled(state: DriveState, progress: Progress) -> DriveState:
    if progress.asked and state.phase != FAULT:
        return state if state.phase == ENABLED else state._replace(phase=ENABLED)
    found = state._replace(private=progress._replace(found_enabled=True))
    if progress.disabling:
        return found._replace(phase=ENABLED)
    if state.phase == READY:
        return fault(found, ENABLED_BY_OTHERS, "enabled, but not by this host")
    return found._replace(phase=CONFIGURING) if state.phase == SILENT else found


def _is_wrong(state: DriveState, progress: Progress, nibble: int) -> DriveState:
    """An error takes the torque away; a state that nobody knows may leave it there."""
    if nibble in codec.ERRORS and progress.clearing:
        return state._replace(private=progress._replace(clearing=progress.clearing - 1))
    if nibble in codec.ERRORS:
        off = state._replace(private=progress._replace(asked=False, found_enabled=False))
        return fault(off, nibble, codec.ERRORS[nibble])
    unknown = state._replace(private=progress._replace(found_enabled=True))
    unknown = fault(unknown, UNKNOWN, f"unknown state {nibble:#x}")
    return unknown._replace(phase=ENABLED) if progress.disabling else unknown
