"""What is known of a CiA 402 drive between two frames, and what its status word and its heartbeat change."""

from typing import NamedTuple, cast

from handctl.drives.causes import Cause
from handctl.drives.cia402 import codec
from handctl.drives.contract import DriveState, Phase
from handctl.drives.frame import Frame
from handctl.drives.readback import Recheck, Walk

SILENT, CONFIGURING, READY, ENABLED, FAULT = Phase

DROPPED_OUT, MISMATCH, LOST, ENABLED_BY_OTHERS = 0x1_0000, 0x1_0001, 0x1_0002, 0x1_0003
"""Error codes of our own, above the 16 bits of an emergency."""
CAUSES = {
    0x3210: Cause.VOLTAGE, 0x3220: Cause.VOLTAGE, 0x4210: Cause.HOT, 0x4310: Cause.HOT, 0x8130: Cause.WATCHDOG,
    0x8250: Cause.WATCHDOG, 0x8100: Cause.DROPPED_OUT, DROPPED_OUT: Cause.DROPPED_OUT, LOST: Cause.LOST,
    MISMATCH: Cause.MISMATCH, ENABLED_BY_OTHERS: Cause.MISMATCH,
}  # fmt: skip
"""By the code of the emergency, and by our own codes."""
CLEAR_TRIES = 20
REPEAT_NS = 20_000_000


class Progress(NamedTuple):
    """What CiA 402 keeps in ``DriveState.private``.

    Attributes:
        walk: how far its objects are known.
        power: last power state; empty before the first.
        code: error code of the last emergency.
        heard_ns: last heartbeat or status word [ns]; -1 before the first.
        started_ns: when it was told to become operational [ns].
        beat_ns: when it was sent this host's heartbeat last [ns].
        asked: whether it was told to enable, and has not said since that it is disabled.
        disabling_ns: since when it is told to disable [ns]; -1 if it is not.
        clearing: how many status words may still show the fault that is being cleared.
        check: how far its objects were read again while it is enabled.
        serial: its serial number; 0 if it has not told one.
    """

    walk: Walk = Walk()
    power: str = ""
    code: int = 0
    heard_ns: int = -1
    started_ns: int = -REPEAT_NS
    beat_ns: int = -REPEAT_NS
    asked: bool = False
    disabling_ns: int = -1
    clearing: int = 0
    check: Recheck = Recheck()
    serial: int = 0

    @property
    def may_be_enabled(self) -> bool:
        """Whether it was told to enable, or is in a state with its power stage on."""
        return self.asked or (self.power != "" and self.power not in codec.WITHOUT_TORQUE)


def progress_of(state: DriveState) -> Progress:
    """The private part of a state."""
    return cast(Progress, state.private)


def fault(state: DriveState, error: int, text: str) -> DriveState:
    """The state in error."""
    return state._replace(phase=FAULT, error=error, error_text=text)


def judge(state: DriveState, progress: Progress) -> DriveState:
    """What a power state means here."""
    power, known = progress.power, state._replace(private=progress)
    if power == codec.FAULT:
        return _has_fault(known, progress)
    if progress.disabling_ns >= 0:
        off = power in codec.WITHOUT_TORQUE and state.feedback_t_ns >= progress.disabling_ns
        if not off:
            return known._replace(phase=ENABLED)
        quiet = known._replace(private=progress._replace(asked=False, disabling_ns=-1))
        return quiet._replace(phase=FAULT if state.error else READY)
    if state.phase == ENABLED and power != codec.OPERATION_ENABLED:
        return fault(
            known._replace(private=progress._replace(asked=False)), DROPPED_OUT, f"fell to {power!r} by itself"
        )
    if power == codec.OPERATION_ENABLED:
        if progress.asked:
            return known._replace(phase=ENABLED) if state.phase == READY else known
        return fault(known, ENABLED_BY_OTHERS, "enabled, but not by this host") if state.phase != FAULT else known
    if state.phase == CONFIGURING and power in codec.WITHOUT_TORQUE:
        return known._replace(phase=READY, error_text="", private=progress._replace(clearing=0))
    return known


def _has_fault(state: DriveState, progress: Progress) -> DriveState:
    """The drive is in fault: without torque, and it says why in an emergency, if it has been heard."""
    if progress.clearing:
        return state._replace(private=progress._replace(clearing=progress.clearing - 1))
    off = state._replace(private=progress._replace(asked=False, disabling_ns=-1))
    text = codec.error_text(progress.code) if progress.code else "fault, and its emergency message was not heard"
    return fault(off, progress.code or DROPPED_OUT, text)


def take_heartbeat(state: DriveState, frame: Frame) -> DriveState:
    """Sign of life; one that says that it is not operational any more has lost its objects, or was stopped."""
    progress = progress_of(state)._replace(heard_ns=frame.t_ns)
    if frame.data[0] == codec.OPERATIONAL or state.phase not in (READY, ENABLED) or progress.disabling_ns >= 0:
        return state._replace(private=progress)
    if state.phase == ENABLED or progress.asked:
        what = "restarted" if frame.data[0] == codec.BOOT_UP else "left the state operational"
        return fault(state._replace(private=progress), DROPPED_OUT, what)
    return state._replace(phase=SILENT, private=Progress())


def lose(state: DriveState) -> DriveState:
    """No sign of life: enabled, that is an error; else it may have lost power and with it its objects."""
    progress = progress_of(state)
    if state.phase == FAULT or progress.disabling_ns >= 0:
        return state
    if state.phase == ENABLED or progress.asked:
        return fault(state, LOST, "no heartbeat")
    if state.phase == READY:
        return state._replace(phase=SILENT, private=Progress(clearing=progress.clearing))
    return state
