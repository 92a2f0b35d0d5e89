"""What is known of an ODrive between two frames, and what its heartbeat changes: nothing else tells what it does."""

from typing import NamedTuple, cast

from handctl.drives.causes import Cause
from handctl.drives.contract import DriveState, Phase
from handctl.drives.frame import Frame
from handctl.drives.odrive import codec
from handctl.drives.odrive import firmware_05 as odrive_05
from handctl.drives.readback import Recheck, Walk

SILENT, CONFIGURING, READY, ENABLED, FAULT = Phase
DROPPED_OUT, MISMATCH, REFUSED, ENABLED_BY_OTHERS, LOST = (1 << 32 | number for number in range(5))
"""Error codes of our own, above the drive's 32 bits."""
CAUSES = {
    DROPPED_OUT: Cause.DROPPED_OUT, MISMATCH: Cause.MISMATCH, REFUSED: Cause.OTHER,
    ENABLED_BY_OTHERS: Cause.MISMATCH, LOST: Cause.LOST,
}  # fmt: skip
CAUSES_OF_BITS = {
    8: Cause.VOLTAGE, 9: Cause.VOLTAGE, 11: Cause.VOLTAGE, 13: Cause.HOT, 14: Cause.HOT, 24: Cause.WATCHDOG,
}  # fmt: skip
"""By our own codes, and by the bit of the heartbeat's error."""
REPEAT_NS, TEMPERATURE_NS = 20_000_000, 200_000_000
VERSION_TRIES, CLEAR_TRIES, SERIAL_TRIES = 10, 3, 3
ORDERS = 5
"""Orders to enable that may be lost."""
HEARTBEATS_MISSED = 3.5
"""So many periods without a heartbeat and the drive counts as lost."""
SETTLE_NS = 5_000_000
"""A heartbeat that comes sooner than this after an order may have been sent before it [ns]."""


class Progress(NamedTuple):
    """What CANSimple keeps in ``DriveState.private``.

    Attributes:
        version: whether the protocol version is the one spoken here.
        serial: its serial number; 0 if it has not told one.
        asked_serial: how often it was asked for it; ``SERIAL_TRIES`` and it is not asked again.
        walk: how far the endpoints are known.
        configured: whether mode and limits were sent.
        axis: last axis state.
        heard_ns: last heartbeat [ns]; -1 before the first.
        asked_ns: since when it is told to enable [ns]; -1 if it is not.
        disabling_ns: since when it is told to disable [ns]; -1 if it is not.
        sent_ns: when the last request was sent that is repeated now and then [ns].
        tries: how often.
        warmed_ns: when the temperature was asked for last [ns].
        clearing: how many heartbeats may still carry the error that is being cleared.
        fresh: whether all settings were found to be right in the last tick, too short ago for a restart.
        orders: how often it was told to enable in vain.
        check: how far its settings were read again while it is enabled.
    """

    version: bool = False
    serial: int = 0
    asked_serial: int = 0
    walk: Walk = Walk()
    configured: bool = False
    axis: int = 0
    heard_ns: int = -1
    asked_ns: int = -1
    disabling_ns: int = -1
    sent_ns: int = -REPEAT_NS
    tries: int = 0
    warmed_ns: int = -TEMPERATURE_NS
    clearing: int = 0
    fresh: bool = False
    orders: int = 0
    check: Recheck = Recheck()

    @property
    def may_be_enabled(self) -> bool:
        """Whether it was told to enable, or is in a state that is not idle."""
        return self.asked_ns >= 0 or self.axis > codec.IDLE


def progress_of(state: DriveState) -> Progress:
    """The private part of a state."""
    return cast(Progress, state.private)


def fault(state: DriveState, error: int, text: str) -> DriveState:
    """The state in error."""
    return state._replace(phase=FAULT, error=error, error_text=text)


def take_heartbeat(state: DriveState, frame: Frame, old: bool) -> DriveState:
    """Take in a heartbeat of 8 bytes, of firmware 0.5 if ``old``."""
    beat = odrive_05.heartbeat(frame.data) if old else codec.heartbeat(frame.data)
    progress = progress_of(state)._replace(axis=beat.state, heard_ns=frame.t_ns)
    if beat.errors and progress.clearing:
        return state._replace(private=progress._replace(clearing=progress.clearing - 1))
    known = state._replace(private=progress._replace(clearing=0))
    if beat.errors:
        return _is_wrong(known, progress, beat, old)
    if beat.state == codec.CLOSED_LOOP:
        return _is_enabled(known, progress)
    return _is_disabled(known, progress, beat) if beat.state == codec.IDLE else _is_elsewhere(known, progress)


def _is_wrong(state: DriveState, progress: Progress, beat: codec.Heartbeat, old: bool) -> DriveState:
    """An error disarms; a drive that reports one and is not idle may still make torque."""
    words = odrive_05.error_text if old else codec.error_text
    wrong = fault(state, beat.errors, words(beat.errors))
    if beat.state == codec.IDLE:
        return wrong._replace(private=progress._replace(asked_ns=-1, disabling_ns=-1, clearing=0))
    return wrong._replace(phase=ENABLED) if progress.disabling_ns >= 0 else wrong


def _is_enabled(state: DriveState, progress: Progress) -> DriveState:
    """It says that it is in closed loop."""
    if progress.disabling_ns >= 0 or (progress.asked_ns >= 0 and state.phase != FAULT):
        return state._replace(phase=ENABLED, private=progress._replace(orders=0, clearing=0))
    if state.phase == READY:
        return fault(state, ENABLED_BY_OTHERS, "in closed loop, but not by this host")
    return state


def _is_elsewhere(state: DriveState, progress: Progress) -> DriveState:
    """It says that it does something else, a calibration for instance: then it makes torque that nobody here asks."""
    if state.phase == ENABLED and progress.disabling_ns < 0:
        return fault(state, DROPPED_OUT, f"went to axis state {progress.axis} by itself")
    if state.phase == READY and progress.asked_ns < 0 and progress.axis > codec.IDLE:
        return fault(state, ENABLED_BY_OTHERS, f"in axis state {progress.axis}, but not by this host")
    return state


def _is_disabled(state: DriveState, progress: Progress, beat: codec.Heartbeat) -> DriveState:
    """It says that it is idle; too soon after an order that says nothing yet."""
    off = state._replace(private=progress._replace(asked_ns=-1, disabling_ns=-1))
    if progress.disabling_ns >= 0:
        if progress.heard_ns < progress.disabling_ns + SETTLE_NS:
            return state
        return off._replace(phase=FAULT if state.error else READY)
    if state.phase == ENABLED:
        why = f": {codec.result_text(beat.result)}" if beat.result else ""
        return fault(off, DROPPED_OUT, f"disabled by itself{why}")
    if 0 <= progress.asked_ns < progress.heard_ns - SETTLE_NS and beat.result != codec.BUSY:
        return _did_not_enable(state, progress, beat)
    return state._replace(phase=CONFIGURING) if state.phase == SILENT else state


def _did_not_enable(state: DriveState, progress: Progress, beat: codec.Heartbeat) -> DriveState:
    """Idle although told to enable: it says why; or the order was lost, or the drive has restarted.

    A restart shows in no other way, so everything is set and verified anew before the next order.
    """
    if beat.result != codec.SUCCESS:
        off = state._replace(private=progress._replace(asked_ns=-1))
        return fault(off, REFUSED, f"refuses to enable: {codec.result_text(beat.result)}")
    if progress.orders >= ORDERS:
        off = state._replace(private=progress._replace(asked_ns=-1, orders=0))
        return fault(off, REFUSED, f"told to enable {ORDERS} times, and stays idle: it restarts, or takes no orders")
    fresh = Progress(version=progress.version, serial=progress.serial, asked_serial=progress.asked_serial,
                     axis=progress.axis, heard_ns=progress.heard_ns, orders=progress.orders)  # fmt: skip
    return state._replace(phase=CONFIGURING, private=fresh)


def lose(state: DriveState, old: bool) -> DriveState:
    """No heartbeat: enabled, that is an error; else it may have lost power and with it its mode."""
    progress = progress_of(state)
    if state.phase == ENABLED or progress.asked_ns >= 0:
        return fault(state, LOST, "no heartbeat")
    return state._replace(phase=SILENT, private=Progress(version=old, clearing=progress.clearing))


def begin_disabling(state: DriveState, progress: Progress, t_ns: int) -> DriveState:
    """From here on idle is what is wanted: until a heartbeat says idle, what may be enabled counts as enabled."""
    phase = ENABLED if progress.may_be_enabled else state.phase
    since = progress.disabling_ns if progress.disabling_ns >= 0 else t_ns
    return state._replace(phase=phase, private=progress._replace(disabling_ns=since))


def cause_of(error: int) -> Cause:
    """What is behind an error that is not 0."""
    if error in CAUSES:
        return CAUSES[error]
    bits = [bit for bit in range(32) if error >> bit & 1]
    if any(bit not in codec.ERRORS for bit in bits):
        return Cause.UNKNOWN
    causes = [CAUSES_OF_BITS.get(bit, Cause.OTHER) for bit in bits]
    return next((cause for cause in causes if cause == Cause.WATCHDOG), causes[0])
