"""Frames from the wire, to each protocol's decoder and to the sensor node's; whatever the state it is in.

An input is a state to begin with and up to four frames: three bytes that say which, then its payload.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from handctl.drives.contract import Drive, DriveState, Phase, Want
from handctl.drives.frame import BRS, ERROR, EXTENDED, FDF, REMOTE, Frame
from handctl.drives.sensor_node import SensorNode, SensorState
from tests.drives.protocol_bench import Bench, hand_file

Target = Callable[[bytes], bool]
STEP_NS = 2_000_000
MARKS = (0, 0, 0, 0, 0, EXTENDED, REMOTE, ERROR)
MOST_FRAMES = 4
WANTS = tuple(Want)
LONGEST = 64


def frames(data: bytes, ours: Sequence[int], t_ns: int) -> Iterator[tuple[Frame, int]]:
    """Frames, mostly on an identifier that matters, each with a byte that says what is wanted of the node after it."""
    at, end = 1, len(data)
    for i in range(MOST_FRAMES):
        if at + 3 > end:
            return
        pick, shape, more = data[at : at + 3]
        can_id = ours[pick % len(ours)] if pick < 240 else (pick << 3 ^ more) & 0x7FF
        size = 8 if shape & 3 else more % (LONGEST + 1)
        payload = data[at + 3 : at + 3 + size]
        yield Frame(can_id | MARKS[shape >> 5], payload, FDF | BRS if size > 8 else 0, 0, t_ns + i * STEP_NS), more
        at += 3 + size


def _states(bench: Bench) -> list[DriveState]:
    """A drive from silence, while it is being configured, ready and enabled."""
    states = [bench.drives[0].initial(), bench.states[0]]
    for _ in range(3):
        bench.tick(Want.POLL)
        states.append(bench.states[0])
    bench.until(Want.POLL, Phase.READY)
    states.append(bench.states[0])
    bench.until(Want.ENABLE, Phase.ENABLED)
    return [*states, bench.states[0]]


def drive(protocol: str) -> Callable[[Path], Target]:
    """A drive of a protocol."""

    def make(folder: Path) -> Target:
        bench = Bench(hand_file(folder, [protocol]))
        states, motor = _states(bench), bench.drives[0]
        begin_ns, ours = bench.k * bench.period_ns, sorted(motor.node_ids)
        bench.rig.close()
        return lambda data: _walked(motor, states, ours, begin_ns, data)

    return make


def _walked(motor: Drive, states: Sequence[DriveState], ours: Sequence[int], t_ns: int, data: bytes) -> bool:
    """Whether any frame was taken in; the drive is asked for something after each."""
    state, taken = states[data[0] % len(states) if data else 0], False
    for frame, more in frames(data, ours, t_ns):
        after = motor.receive(state, frame)
        taken = taken or after is not state
        want = WANTS[more % len(WANTS)]
        state, sent = motor.advance(after, frame.t_ns + STEP_NS, want, 0.1 if want == Want.ENABLE else 0.0)
        assert max((len(one.data) for one in sent), default=0) <= LONGEST
        assert state.phase in Phase
    motor.clear(state)
    return taken


def sensors(folder: Path) -> Target:
    """The sensor node, with the tick's number going on."""
    bench = Bench(hand_file(folder, ["mit"]))
    bench.rig.close()
    node, state, ours = bench.node, bench.sensors, sorted(bench.node.node_ids)
    return lambda data: _sensed(node, state, ours, data)


def _sensed(node: SensorNode, state: SensorState, ours: Sequence[int], data: bytes) -> bool:
    taken = False
    for frame, more in frames(data, ours, STEP_NS):
        state, _sync = node.sync(state, more)
        after = node.receive(state, frame)
        taken, state = taken or after is not state, after
    return taken
