"""The sensor node's frames against its DBC file, as a foreign decoder reads it, and the host's view of them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

import cantools
import pytest
from cantools.database import Database
from hypothesis import given
from hypothesis import strategies as st

from handctl.drives.frame import Frame
from handctl.drives.sensors.node import TENSION_TOP_N, TENSION_ZERO_N, SensorNode, SensorState, counters, saturated

RAW = st.integers(0, 4095)
CHANNELS = 11
TENDONS = tuple(f"t{i}" for i in range(CHANNELS))
JOINTS = tuple(f"j{i}" for i in range(CHANNELS))


@dataclass(frozen=True)
class Section:
    """The hand file's section."""

    sync_id: int = 0x080
    base_id: int = 0x1A0
    tendons: tuple[str, ...] = TENDONS
    joints: tuple[str, ...] = JOINTS
    joint_decimation: int = 4


def read_dbc() -> Database:
    text = files("handctl.drives.sensors").joinpath("sensor_node.dbc").read_text(encoding="ascii")
    database = cantools.database.load_string(text, "dbc", strict=True)
    assert isinstance(database, Database)
    return database


DBC = read_dbc()


@pytest.fixture
def node() -> SensorNode:
    return SensorNode.of(Section(), 0, TENDONS, JOINTS)


def encoded(first_id: int, prefix: str, counter: int, values: Sequence[float], t_ns: int = 0) -> list[Frame]:
    """Frames as the DBC has them, each as long as its channels need."""
    frames = []
    for group in range(math.ceil(len(values) / 5)):
        part = values[5 * group : 5 * group + 5]
        message = DBC.get_message_by_frame_id(first_id + group)
        signals: dict[str, float] = {f"{prefix}_{5 * group + i}": 0 for i in range(5)}
        signals |= {f"{prefix}_{5 * group + i}": value for i, value in enumerate(part)}
        data = message.encode({**signals, "counter": counter}, scaling=False)
        frames.append(Frame(first_id + group, data[: (4 + 12 * len(part) + 7) // 8], t_ns=t_ns))
    return frames


def tick_of(node: SensorNode, nibble: int) -> int:
    """Return the first tick whose SYNC has these low four bits."""
    return next(k for k, counter in enumerate(node.counters) if counter & 0xF == nibble)


@pytest.mark.parametrize("decimation", [1, 2, 3, 4, 5, 7, 8, 12, 16, 100, 256])
def test_counters_keep_the_turn_of_the_joints(decimation: int) -> None:
    made = counters(decimation)
    assert len(made) % decimation == 0
    assert all(counter % decimation == k % decimation for k, counter in enumerate(made))


@pytest.mark.parametrize("decimation", [1, 2, 3, 4, 5, 6, 7])
def test_no_age_of_a_frame_makes_it_fresh(decimation: int) -> None:
    """Less than 8 ticks old never, older ones by chance: more than 40 of 100 are lost then, which relaxes (B03b)."""
    nibbles = [counter & 0xF for counter in counters(decimation)]
    n = len(nibbles)
    for age in range(1, 200):
        same = [k >= age and nibbles[k] == nibbles[k - age] for k in range(n)]  # but for the seam
        assert sum(same) <= (0 if age < 8 else 0.4 * n), age
        worst = max(sum(same[k : k + 100]) for k in range(n - 100))
        assert worst < 60, age


def received(node: SensorNode, state: SensorState, frames: Sequence[Frame]) -> SensorState:
    for frame in frames:
        state = node.receive(state, frame)
    return state


@given(st.lists(RAW, min_size=1, max_size=CHANNELS), st.lists(RAW, max_size=CHANNELS), st.integers(0, 2**40))
def test_every_value_reads_as_the_dbc_says(tensions: list[int], joints: list[int], k: int) -> None:
    node = SensorNode.of(Section(tendons=TENDONS[: len(tensions)], joints=JOINTS[: len(joints)]), 0, TENDONS, JOINTS)
    before, sync = node.sync(node.initial(), k)
    assert DBC.decode_message(sync.can_id, sync.data) == {"counter": sync.data[0]}
    nibble = sync.data[0] % 16
    frames = encoded(0x1A0, "tension", nibble, tensions) + encoded(0x1B0, "joint", nibble, joints)
    now = received(node, before, frames)
    told: dict[str, Any] = {}
    for frame in frames:
        told.update(DBC.decode_message(frame.can_id, frame.data, allow_truncated=True))  # type: ignore[arg-type]
    assert dict(node.new_tensions(before, now)) == {i: told[f"tension_{i}"] for i in range(len(tensions))}
    angles = dict(node.new_joints(before, now))
    assert angles == pytest.approx({i: told[f"joint_{i}"] for i in range(len(joints))}, abs=1e-12)
    assert (now.stale, now.misread) == (0, 0)


def test_golden_frames() -> None:
    """By hand: 0 N is raw 96 = 0x060, 10 N raw 256 = 0x100, rail 0xFFF; 0 rad is raw 0x800; counter 7."""
    node = SensorNode.of(Section(tendons=TENDONS[:3], joints=("j4",)), 0, TENDONS, JOINTS)
    before, sync = node.sync(node.initial(), tick_of(node, 7))
    assert sync == Frame(0x080, sync.data)
    assert sync.data[0] & 0xF == 7
    now = received(node, before, [Frame(0x1A0, bytes.fromhex("070600f1ff"))])
    assert list(node.new_tensions(before, now)) == [(0, 0.0), (1, 10.0), (2, 249.9375)]
    now = received(node, before, [Frame(0x1B0, bytes.fromhex("0780"))])
    assert list(node.new_joints(before, now)) == [(4, 0.0)]


@given(st.integers(0, 255), st.integers(0, 15))
def test_only_the_answer_to_the_last_sync_counts(k: int, counter: int) -> None:
    node = SensorNode.of(Section(), 0, TENDONS, JOINTS)
    before, sync = node.sync(node.initial(), k)
    now = received(node, before, encoded(0x1A0, "tension", counter, [100] * CHANNELS))
    fresh = counter == sync.data[0] % 16
    assert len(list(node.new_tensions(before, now))) == (CHANNELS if fresh else 0)
    assert now.stale == (0 if fresh else 3)


def test_nothing_is_new_twice_and_what_is_missing_stays_missing(node: SensorNode) -> None:
    before, _ = node.sync(node.initial(), tick_of(node, 1))
    first, second, _ = encoded(0x1A0, "tension", 1, range(CHANNELS))
    now = received(node, before, [second])
    assert [i for i, _ in node.new_tensions(before, now)] == [5, 6, 7, 8, 9]
    assert list(node.new_tensions(now, now)) == []
    later = received(node, now, [first])
    assert [i for i, _ in node.new_tensions(now, later)] == [0, 1, 2, 3, 4]


def test_times_are_in_the_order_of_the_hand() -> None:
    node = SensorNode.of(Section(tendons=("t2", "t0", "t1", "t5", "t4", "t3")), 0, TENDONS[:7], JOINTS)
    state, _ = node.sync(node.initial(), tick_of(node, 0))
    assert node.tension_times(state) == (-1,) * 7
    first, second = encoded(0x1A0, "tension", 0, [0] * 6)
    state = received(node, state, [first._replace(t_ns=10), second._replace(t_ns=20)])
    assert node.tension_times(state) == (10, 10, 10, 20, 10, 10, 20)


def test_a_hand_without_load_cells_has_no_reading() -> None:
    node = SensorNode.of(Section(tendons=()), 0, TENDONS[:3], JOINTS)
    assert node.tension_times(node.initial()) == (-1, -1, -1)


@given(st.one_of(st.just(0x1A1), st.integers(0, 2047)), st.binary(max_size=64), st.integers(0, 2))
def test_any_frame_may_come(can_id: int, data: bytes, bus: int) -> None:
    node = SensorNode.of(Section(), 0, TENDONS, JOINTS)
    before, _ = node.sync(node.initial(), 5)
    after = node.receive(before, Frame(can_id, data, bus=bus))
    if bus != 0 or can_id not in node.node_ids:
        assert after is before


@pytest.mark.parametrize("size", [0, 1, 7, 9, 64])
def test_a_frame_of_a_wrong_length_is_counted_and_not_read(node: SensorNode, size: int) -> None:
    before, _ = node.sync(node.initial(), 0)
    after = node.receive(before, Frame(0x1A0, bytes(size)))
    assert after.misread == 1
    assert list(node.new_tensions(before, after)) == []


def test_the_exchange_is_what_the_frames_take(node: SensorNode) -> None:
    frames = encoded(0x1A0, "tension", 0, [0] * CHANNELS) + encoded(0x1B0, "joint", 0, [0] * CHANNELS)
    assert [size for size, _ in node.exchange] == [1, *(len(frame.data) for frame in frames)]
    assert sum(rate for _, rate in node.exchange) == 1 + 3 + 3 / 4


def test_a_saturated_load_cell_is_beyond_the_rail_after_any_tare(node: SensorNode) -> None:
    for tare in (-6.0, 0.0, 6.0):
        assert 249.9375 - tare >= node.tension_rail


def test_the_simulated_node_and_the_host_agree(node: SensorNode) -> None:
    from firmware_sim.nodes.sensors import joint_code, pack, tension_code

    before, _ = node.sync(node.initial(), tick_of(node, 3))
    forces, angles = [7.3 * i for i in range(5)], [0.4 * i - 0.8 for i in range(5)]
    frames = [
        Frame(0x1A0, pack(3, [tension_code(force) for force in forces])),
        Frame(0x1B0, pack(3, [joint_code(angle) for angle in angles])),
    ]
    now = received(node, before, frames)
    assert [value for _, value in node.new_tensions(before, now)] == pytest.approx(forces, abs=0.0625 / 2)
    assert [value for _, value in node.new_joints(before, now)] == pytest.approx(angles, abs=math.pi / 4096)


def test_a_group_knows_its_counter_and_how_often_it_came(node: SensorNode) -> None:
    state = node.initial()
    for k in (5, 6):
        state, sync = node.sync(state, tick_of(node, k))
        for frame in encoded(0x1A0, "tension", k & 0xF, [1.0] * CHANNELS, t_ns=k):
            state = node.receive(state, frame)
    assert [group.counter for group in state.groups[:3]] == [6, 6, 6]
    assert [group.frames for group in state.groups[:3]] == [2, 2, 2]
    assert [group.t_ns for group in state.groups[:3]] == [6, 6, 6]
    other = SensorNode.of(Section(), 1, TENDONS, JOINTS)
    assert other.sync(other.initial(), 0x1FF)[1] == Frame(0x080, other.counters[0x1FF:0x200], bus=1)
    assert sync.bus == 0


def test_groups_belong_to_their_node(node: SensorNode) -> None:
    whole = node.initial()
    state, _ = node.sync(whole, tick_of(node, 1))
    for frame in encoded(0x1A0, "tension", 1, [1.0] * CHANNELS):
        state = node.receive(state, frame)
    with pytest.raises(ValueError, match="zip"):
        node.new_tensions(whole._replace(groups=whole.groups[:1]), state)
    short = state.groups[0]._replace(raw=state.groups[0].raw[:1])
    with pytest.raises(ValueError, match="zip"):
        node.new_tensions(whole, state._replace(groups=(short, *state.groups[1:])))


def test_what_is_stale_and_what_cannot_be_read_are_counted_apart(node: SensorNode) -> None:
    state, _ = node.sync(node.initial(), tick_of(node, 1))
    state = node.receive(state, Frame(0x1A0, bytes(3)))
    (good, *_) = encoded(0x1A0, "tension", 2, [1.0] * CHANNELS)
    state = node.receive(state, good)
    assert (state.misread, state.stale) == (1, 1)
    (fresh, *_) = encoded(0x1A0, "tension", 1, [1.0] * CHANNELS)
    state = node.receive(state, fresh)
    assert (state.misread, state.stale) == (1, 1), "neither is forgotten with the next good frame"


def test_channels_that_are_empty_or_full() -> None:
    low, top = TENSION_ZERO_N, TENSION_TOP_N
    cells = [(0, low), (1, low + 0.1), (3, top - 0.1), (4, top), (7, math.nan)]
    assert saturated(cells) == (0, 4, 7)
    assert saturated([]) == ()


def test_all_load_cells_are_read_when_each_has_been_read_once(node: SensorNode) -> None:
    """In whatever order and tick; what is said of joints does not count."""
    state = node.initial()
    for k, (base, done) in enumerate([(0x1B0, False), (0x1A0, False), (0x1A0, False), (0x1A1, False), (0x1A2, True)]):
        state, sync = node.sync(state, k)
        size = node.lengths[node.ids.index(base)]
        state = node.receive(state, Frame(base, bytes([sync.data[0] & 0xF] + [0] * (size - 1))))
        assert node.all_read(state) == done, hex(base)
    assert not replace(node, frame_of=(*node.frame_of[:-1], -1)).all_read(state), "one has no load cell"


def test_each_joint_frame_is_told_by_its_first_joint_and_when_it_came_last(node: SensorNode) -> None:
    state, sync = node.sync(node.initial(), 1)
    counter = sync.data[0] & 0xF
    assert node.joint_times(state) == [(0, -1), (5, -1), (10, -1)]
    first, second, _ = encoded(0x1B0, "joint", counter, range(CHANNELS), t_ns=30)
    state = received(node, state, [second._replace(t_ns=20)])
    assert node.joint_times(state) == [(0, -1), (5, 20), (10, -1)]
    state = received(node, state, encoded(0x1A0, "tension", counter, range(CHANNELS), t_ns=40))
    assert node.joint_times(state) == [(0, -1), (5, 20), (10, -1)], "load cells are no joints"
    assert node.joint_times(received(node, state, [first])) == [(0, 30), (5, 20), (10, -1)]
