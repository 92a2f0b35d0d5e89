"""Frames from the wire, to each protocol's decoder and to the sensor node's; whatever the state it is in."""

from collections.abc import Callable, Sequence
from pathlib import Path

from fuzz.mutate import Source
from handctl.drives.contract import Drive, DriveState, Phase, Want
from handctl.drives.frame import BRS, ERROR, EXTENDED, FDF, REMOTE, Frame
from handctl.drives.sensor_node import SensorNode, SensorState
from tests.drives.protocol_bench import Bench, hand_file

Target = Callable[[bytes], bool]
STEP_NS = 2_000_000
MARKS = (0, 0, 0, 0, 0, EXTENDED, REMOTE, ERROR)
MOST_FRAMES = 32


def frame(source: Source, ours: Sequence[int], t_ns: int) -> Frame:
    """A frame, mostly on an identifier that matters."""
    pick = source.number(256)
    can_id = ours[pick % len(ours)] if pick < 240 else source.number(0x800)
    shape = source.number(256)
    size = 8 if shape & 1 else source.number(65)
    return Frame(can_id | MARKS[shape >> 5], source.take(size), FDF | BRS if size > 8 else 0, 0, t_ns)


def _states(bench: Bench) -> list[DriveState]:
    return [bench.drives[0].initial(), bench.states[0]]


def drive(protocol: str) -> Callable[[Path], Target]:
    """A drive, from silence, while it is being configured, ready and enabled."""

    def make(folder: Path) -> Target:
        bench = Bench(hand_file(folder, [protocol]))
        states = _states(bench)
        for _ in range(3):
            bench.tick(Want.POLL)
            states.append(bench.states[0])
        bench.until(Want.POLL, Phase.READY)
        states.append(bench.states[0])
        bench.until(Want.ENABLE, Phase.ENABLED)
        states.append(bench.states[0])
        begin, motor = bench.k * bench.period_ns, bench.drives[0]
        bench.rig.close()
        return lambda data: _walked(motor, states, begin, data)

    return make


def _walked(motor: Drive, states: Sequence[DriveState], t_ns: int, data: bytes) -> bool:
    """Whether any frame was taken in; the drive is asked for something after each."""
    source, ours, taken = Source(data), sorted(motor.node_ids), False
    state = states[source.number(len(states))]
    for _ in range(MOST_FRAMES):
        if source.empty:
            break
        after = motor.receive(state, frame(source, ours, t_ns))
        taken = taken or after is not state
        t_ns += STEP_NS
        want = Want(source.number(len(Want)))
        state, frames = motor.advance(after, t_ns, want, 0.1 if want == Want.ENABLE else 0.0)
        assert all(len(one.data) <= 64 for one in frames)
        assert state.phase in Phase
    motor.clear(state)
    return taken


def sensors(folder: Path) -> Target:
    """The sensor node, with the tick's number going on."""
    bench = Bench(hand_file(folder, ["mit"]))
    bench.rig.close()
    return lambda data: _sensed(bench.node, bench.sensors, data)


def _sensed(node: SensorNode, state: SensorState, data: bytes) -> bool:
    source, ours, taken = Source(data), sorted(node.node_ids), False
    for _ in range(MOST_FRAMES):
        if source.empty:
            break
        state, _sync = node.sync(state, source.number(256))
        after = node.receive(state, frame(source, ours, STEP_NS))
        taken, state = taken or after is not state, after
    return taken
