"""Frames from the wire, to each protocol's decoder and to the sensor node's; whatever the state it is in.

An input is a state to begin with and up to five frames: three bytes that say which, then its payload. The corpus begins
with what a drive was really told in each state on its way to torque: an answer that is only noise is nobody's.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from fuzz.drives import DRIVES
from handctl.controller.setup import make_controller
from handctl.controller.tick import Controller
from handctl.core import block as s
from handctl.core.gains.gains import Gains
from handctl.core.types import TickIn
from handctl.drives.contract import Drive, DriveState, Phase, Want
from handctl.drives.frame import BRS, ERROR, EXTENDED, FDF, REMOTE, Frame
from handctl.hand.load import load_hand
from handctl.programs.live import LiveProgram
from tests.drives.protocol_bench import Bench, hand_file

Target = Callable[[bytes], bool]
STEP_NS, LONG_NS = 2_000_000, 1_000_000_000
"""From frame to frame, and a silence that is too long for every drive [ns]."""
SILENCE = 240
"""Bytes from here on put one before their frame."""
MARKS = (0, 0, 0, 0, 0, EXTENDED, REMOTE, ERROR)
MOST_FRAMES = 5
WANTS = tuple(Want)
CLEAR = 0x40
"""The bit that has an error cleared."""
LONGEST = 64


def frames(data: bytes, ours: Sequence[int], t_ns: int) -> Iterator[tuple[Frame, int]]:
    """Frames, mostly on an identifier that matters, each with a byte that says what is wanted of the node after it."""
    at, end = 1, len(data)
    for _ in range(MOST_FRAMES):
        if at + 3 > end:
            return
        pick, shape, more = data[at : at + 3]
        can_id = ours[pick % len(ours)] if pick < 240 else (pick << 3 ^ more) & 0x7FF
        size = 8 if shape & 3 else more % (LONGEST + 1)
        payload = data[at + 3 : at + 3 + size]
        t_ns += LONG_NS if more >= SILENCE else STEP_NS
        yield Frame(can_id | MARKS[shape >> 5], payload, FDF | BRS if size > 8 else 0, 0, t_ns), more
        at += 3 + size


class Seen(NamedTuple):
    """A drive before a tick [ns], and what it hears in it."""

    state: DriveState
    t_ns: int
    heard: tuple[Frame, ...]


def way(name: str, folder: Path) -> tuple[Drive, list[Seen]]:
    """A drive of ``DRIVES``, and its way from silence to torque."""
    fuzzed = DRIVES[name]
    path = hand_file(folder, [fuzzed.protocol], fuzzed.options)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if not line.startswith(fuzzed.without)))
    bench = Bench(path)
    motor, seen = bench.drives[0], list[Seen]()
    while bench.states[0].phase != Phase.ENABLED:
        heard = tuple(frame for frame in bench.incoming if frame.can_id in motor.node_ids)
        if heard or not seen:
            seen.append(Seen(bench.states[0], bench.k * bench.period_ns, heard))
        ready = all(state.phase >= Phase.READY for state in bench.states)
        bench.tick(Want.ENABLE if ready else Want.POLL)
    seen.append(Seen(bench.states[0], bench.k * bench.period_ns, ()))
    bench.rig.close()
    return motor, seen


def answers(name: str, folder: Path) -> list[bytes]:
    """What a drive really heard on its way, as inputs."""
    motor, seen = way(name, folder)
    ours, found = sorted(motor.node_ids), []
    for i, (_, _, heard) in enumerate(seen):
        parts = [bytes((ours.index(one.can_id), *_shape(one.data))) + one.data for one in heard[:MOST_FRAMES]]
        found.append(bytes((i,)) + b"".join(parts))
    return [data for data in found if len(data) > 1]


def _shape(payload: bytes) -> tuple[int, int]:
    """Second and third byte before a payload."""
    return (1, int(Want.POLL)) if len(payload) == 8 else (0, len(payload))


def drive(name: str) -> Callable[[Path], Target]:
    """A drive of ``DRIVES``."""

    def make(folder: Path) -> Target:
        motor, seen = way(name, folder)
        ours = sorted(motor.node_ids)
        return lambda data: _walked(motor, seen[data[0] % len(seen)] if data else seen[0], ours, data)

    return make


def _walked(motor: Drive, begin: Seen, ours: Sequence[int], data: bytes) -> bool:
    """Whether any frame was taken in; the drive is asked for something after each."""
    state, taken = begin.state, False
    for frame, more in frames(data, ours, begin.t_ns):
        after = motor.receive(state, frame)
        taken = taken or after is not state
        state, sent = _asked(motor, after, frame.t_ns + STEP_NS, more)
        assert max((len(one.data) for one in sent), default=0) <= LONGEST
        assert state.phase in Phase
    motor.clear(state)
    return taken


def _asked(motor: Drive, state: DriveState, t_ns: int, more: int) -> tuple[DriveState, tuple[Frame, ...]]:
    if state.phase == Phase.FAULT:
        motor.cause(state.error)
        if more & CLEAR:
            return motor.clear(state)
    want = WANTS[more % len(WANTS)]
    return motor.advance(state, t_ns, want, 0.1 if want == Want.ENABLE else 0.0)


def sensors(folder: Path) -> Target:
    """Read load cells and joint encoders by the compiled wire, with the tick's number going on."""
    hand = load_hand(str(hand_file(folder, ["mit"])))
    controller = make_controller(hand, Gains(), 1e9 / STEP_NS, LiveProgram(), None, arm_at_once=False)
    ours = sorted(controller.sensors.node_ids)
    return lambda data: _sensed(controller, ours, data)


def _sensed(controller: Controller, ours: Sequence[int], data: bytes) -> bool:
    """Return whether any frame was taken in; what was read becomes measurements."""
    state, t_ns = controller.initial(), STEP_NS
    for frame, more in frames(data, ours, t_ns):
        state.set_whole(s.SYNC_ASKED, controller.sensors.counter(more) & 0xF)
        state, _ = controller.tick(state, TickIn(state.k + 1, frame.t_ns + STEP_NS, frames=(frame,)))
    return bool(state.view("group_frames").any())
