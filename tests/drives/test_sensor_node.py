"""Compare frames of the sensor node with the DBC file of the node.

A separate decoder reads the DBC file. Further tests check the state that the host keeps about the
sensor node.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

import cantools
import numpy as np
import pytest
from cantools.database import Database
from hypothesis import given
from hypothesis import strategies as st

from handctl.drives.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Frame
from handctl.drives.sensors.sensor_node import (
    TENSION_MAX_N,
    TENSION_ZERO_N,
    SensorNode,
    sync_counters,
)
from tests.drives.wired_drives import WiredDrives

raw_codes = st.integers(0, 4095)
CHANNEL_COUNT = 11
TENDON_NAMES = tuple(f"t{i}" for i in range(CHANNEL_COUNT))
JOINT_NAMES = tuple(f"j{i}" for i in range(CHANNEL_COUNT))


@dataclass(frozen=True)
class SensorNodeSection:
    """Section of a hand file for a sensor node."""

    sync_id: int = 0x080
    base_id: int = 0x1A0
    tendons: tuple[str, ...] = TENDON_NAMES
    joints: tuple[str, ...] = JOINT_NAMES
    joint_decimation: int = 4


def read_dbc() -> Database:
    text = files("handctl.drives.sensors").joinpath("sensor_node.dbc").read_text(encoding="ascii")
    database = cantools.database.load_string(text, "dbc", strict=True)
    assert isinstance(database, Database)
    return database


SENSOR_NODE_DBC = read_dbc()


@pytest.fixture
def node() -> SensorNode:
    return SensorNode.from_description(SensorNodeSection(), 0, TENDON_NAMES, JOINT_NAMES)


def encode_frames(
    first_id: int,
    message_prefix: str,
    sync_counter: int,
    sensor_values: Sequence[float],
    t_ns: int = 0,
) -> list[Frame]:
    """Return frames of the sensor node as the DBC file encodes them.

    Each frame has only as many bytes as its channels need.
    """
    frames = []
    for group in range(math.ceil(len(sensor_values) / 5)):
        frame_values = sensor_values[5 * group : 5 * group + 5]
        message = SENSOR_NODE_DBC.get_message_by_frame_id(first_id + group)
        signals: dict[str, float] = {f"{message_prefix}_{5 * group + i}": 0 for i in range(5)}
        signals |= {
            f"{message_prefix}_{5 * group + i}": value for i, value in enumerate(frame_values)
        }
        data = message.encode({**signals, "counter": sync_counter}, scaling=False)
        frames.append(
            Frame(first_id + group, data[: (4 + 12 * len(frame_values) + 7) // 8], t_ns=t_ns)
        )
    return frames


def tick_with_counter_nibble(node: SensorNode, counter_nibble: int) -> int:
    """Return the first tick in which the lowest four bits of the SYNC counter equal ``counter_nibble``."""
    return next(k for k, counter in enumerate(node.counters) if counter & 0xF == counter_nibble)


@pytest.mark.parametrize("joint_decimation", [1, 2, 3, 4, 5, 7, 8, 12, 16, 100, 256])
def test_counters_keep_the_turn_of_the_joints(joint_decimation: int) -> None:
    counters = sync_counters(joint_decimation)
    assert len(counters) % joint_decimation == 0
    assert all(
        counter % joint_decimation == k % joint_decimation for k, counter in enumerate(counters)
    )


@pytest.mark.parametrize("joint_decimation", [1, 2, 3, 4, 5, 6, 7])
def test_no_age_of_a_frame_makes_it_fresh(joint_decimation: int) -> None:
    """A frame that is up to 7 ticks old never counts as a new frame.

    A frame that is more than 7 ticks old can count as new by chance. Of 100 frames that are more
    than 7 ticks old, more than 40 still count as lost. More than 40 lost frames of 100 cause the
    fault B03b (many replies are being lost).
    """
    counter_nibbles = [counter & 0xF for counter in sync_counters(joint_decimation)]
    n = len(counter_nibbles)
    for age in range(1, 200):
        is_same_counter = [
            k >= age and counter_nibbles[k] == counter_nibbles[k - age] for k in range(n)
        ]  # in the first ticks of the test, there is no older frame
        assert sum(is_same_counter) <= (0 if age < 8 else 0.4 * n), age
        max_equal_count = max(sum(is_same_counter[k : k + 100]) for k in range(n - 100))
        assert max_equal_count < 60, age


def state_after_sync(node: SensorNode, tick_index: int) -> WiredDrives:
    """Return the state that the host keeps about the sensor node, after the SYNC frame of tick ``tick_index``."""
    wired_drives = WiredDrives((), node)
    wired_drives.begin_tick_with_sync(tick_index)
    return wired_drives


@given(
    st.lists(raw_codes, min_size=1, max_size=CHANNEL_COUNT),
    st.lists(raw_codes, max_size=CHANNEL_COUNT),
    st.integers(0, 2**40),
)
def test_every_value_reads_as_the_dbc_says(
    tension_codes: list[int], joint_codes: list[int], tick_index: int
) -> None:
    node = SensorNode.from_description(
        SensorNodeSection(
            tendons=TENDON_NAMES[: len(tension_codes)], joints=JOINT_NAMES[: len(joint_codes)]
        ),
        0,
        TENDON_NAMES,
        JOINT_NAMES,
    )
    wired_drives, sync = state_after_sync(node, tick_index), node.sync(tick_index)
    assert SENSOR_NODE_DBC.decode_message(sync.can_id, sync.data) == {"counter": sync.data[0]}
    nibble = sync.data[0] % 16
    frames = encode_frames(0x1A0, "tension", nibble, tension_codes) + encode_frames(
        0x1B0, "joint", nibble, joint_codes
    )
    wired_drives.receive(frames)
    decoded_signals: dict[str, Any] = {}
    for frame in frames:
        decoded_signals.update(
            SENSOR_NODE_DBC.decode_message(frame.can_id, frame.data, allow_truncated=True)
        )  # type: ignore[arg-type]
    assert wired_drives.tensions == {
        i: decoded_signals[f"tension_{i}"] for i in range(len(tension_codes))
    }
    assert wired_drives.joint_readings == pytest.approx(
        {i: decoded_signals[f"joint_{i}"] for i in range(len(joint_codes))}, abs=1e-12
    )
    assert (wired_drives.field_number("stale"), wired_drives.has_malformed_frame) == (0, False)


def test_sensor_frames_are_decoded_to_known_values() -> None:
    """The codes in this test were computed by hand.

    The tension codes are 0x060 (96) for 0 N, 0x100 (256) for 10 N, and 0xFFF for the upper end of
    the range. The angle code for 0 rad is 0x800. The counter in the frames of this test is 7.
    """
    node = SensorNode.from_description(
        SensorNodeSection(tendons=TENDON_NAMES[:3], joints=("j4",)), 0, TENDON_NAMES, JOINT_NAMES
    )
    sync = node.sync(tick_with_counter_nibble(node, 7))
    assert sync == Frame(0x080, sync.data)
    assert sync.data[0] & 0xF == 7
    wired_drives = state_after_sync(node, tick_with_counter_nibble(node, 7)).receive(
        [Frame(0x1A0, bytes.fromhex("070600f1ff"))]
    )
    assert wired_drives.tensions == {0: 0.0, 1: 10.0, 2: 249.9375}
    wired_drives = state_after_sync(node, tick_with_counter_nibble(node, 7)).receive(
        [Frame(0x1B0, bytes.fromhex("0780"))]
    )
    assert wired_drives.joint_readings == {4: 0.0}


@given(st.integers(0, 255), st.integers(0, 15))
def test_only_the_answer_to_the_last_sync_counts(tick_index: int, counter: int) -> None:
    node = SensorNode.from_description(SensorNodeSection(), 0, TENDON_NAMES, JOINT_NAMES)
    wired_drives = state_after_sync(node, tick_index).receive(
        encode_frames(0x1A0, "tension", counter, [100] * CHANNEL_COUNT)
    )
    is_fresh = counter == node.sync(tick_index).data[0] % 16
    assert len(wired_drives.tensions) == (CHANNEL_COUNT if is_fresh else 0)
    assert wired_drives.field_number("stale") == (0 if is_fresh else 3)
    assert wired_drives.field_number("tension_frames") == (3 if is_fresh else 0)


@pytest.mark.parametrize(("first_id", "message_prefix"), [(0x1A0, "tension"), (0x1B0, "joint")])
def test_a_stale_frame_that_comes_after_the_fresh_one_is_reported(
    node: SensorNode, first_id: int, message_prefix: str
) -> None:
    """If a stale sensor frame arrives after the fresh sensor frame of a tick, the controller reports the stale frame.

    A stale frame has two possible causes: frames changed their order on the bus, or another node
    sends an old frame again.
    """
    (fresh_frame, *_), (stale_frame, *_) = (
        encode_frames(first_id, message_prefix, nibble, [7] * CHANNEL_COUNT) for nibble in (3, 2)
    )
    for frames, stale_now in (
        ([stale_frame], 1),
        ([stale_frame, fresh_frame], 1),
        ([fresh_frame, stale_frame], 2),
        ([fresh_frame, stale_frame, stale_frame], 2),
    ):
        wired_drives = state_after_sync(node, tick_with_counter_nibble(node, 3)).receive(frames)
        assert (wired_drives.field_number("stale_now"), wired_drives.field_number("stale")) == (
            stale_now,
            frames.count(stale_frame),
        )
        assert len(wired_drives.tensions or wired_drives.joint_readings) == (
            5 if fresh_frame in frames else 0
        )
    wired_drives.begin_tick_with_sync(tick_with_counter_nibble(node, 4))
    assert (wired_drives.field_number("stale_now"), wired_drives.field_number("stale")) == (0, 2)


def test_a_stale_frame_changes_no_value(node: SensorNode) -> None:
    wired_drives = state_after_sync(node, tick_with_counter_nibble(node, 3)).receive(
        encode_frames(0x1A0, "tension", 3, [160] * CHANNEL_COUNT, t_ns=5)
    )
    wired_drives.receive(encode_frames(0x1A0, "tension", 4, [200] * CHANNEL_COUNT, t_ns=6))
    assert set(wired_drives.tensions.values()) == {4.0}
    assert set(wired_drives.field_view("group_ns")[:3].tolist()) == {5}
    assert wired_drives.field_view("group_frames")[:3].tolist() == [1, 1, 1]


def test_reading_is_new_once_and_missing_stays_missing(node: SensorNode) -> None:
    wired_drives = state_after_sync(node, tick_with_counter_nibble(node, 1))
    first_frame, second_frame, _ = encode_frames(0x1A0, "tension", 1, range(CHANNEL_COUNT))
    assert list(wired_drives.receive([second_frame]).tensions) == [5, 6, 7, 8, 9]
    wired_drives.begin_tick()
    assert wired_drives.tensions == {}
    assert list(wired_drives.receive([first_frame]).tensions) == [0, 1, 2, 3, 4]


def test_times_are_in_the_order_of_the_hand() -> None:
    node = SensorNode.from_description(
        SensorNodeSection(tendons=("t2", "t0", "t1", "t5", "t4", "t3")),
        0,
        TENDON_NAMES[:7],
        JOINT_NAMES,
    )
    wired_drives = state_after_sync(node, tick_with_counter_nibble(node, 0))
    groups = [node.group_of_tendon(i) for i in range(7)]
    assert groups == [0, 0, 0, 1, 0, 0, -1]
    assert wired_drives.field_view("group_ns").tolist() == [-1] * 5
    first_frame, second_frame = encode_frames(0x1A0, "tension", 0, [0] * 6)
    wired_drives.receive([first_frame._replace(t_ns=10), second_frame._replace(t_ns=20)])
    assert [int(wired_drives.field_view("group_ns")[group]) for group in groups[:6]] == [
        10,
        10,
        10,
        20,
        10,
        10,
    ]


def test_a_hand_without_load_cells_has_no_reading() -> None:
    node = SensorNode.from_description(
        SensorNodeSection(tendons=()), 0, TENDON_NAMES[:3], JOINT_NAMES
    )
    assert [node.group_of_tendon(i) for i in range(3)] == [-1, -1, -1]
    assert node.tension_frames == 0


def state_without_unknown_counters(wired_drives: WiredDrives) -> bytes:
    """Return the bytes of a state block whose counters of unknown and malformed frames are set to zero."""
    block = wired_drives.block.copy()
    for name in ("strange", "misread_now"):
        wired_drives.layout.view(block, name)[...] = 0
    return block.tobytes()


@given(
    st.one_of(st.just(0x1A1), st.integers(0, 2047)),
    st.sampled_from([0, 0, EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG]),
    st.binary(max_size=64),
    st.integers(0, 2),
)
def test_any_sensor_frame_is_survived(can_id: int, frame_flags: int, data: bytes, bus: int) -> None:
    node = SensorNode.from_description(SensorNodeSection(), 0, TENDON_NAMES, JOINT_NAMES)
    wired_drives = state_after_sync(node, 5)
    state_before, is_sensor_frame = (
        state_without_unknown_counters(wired_drives),
        bus == 0 and can_id in node.node_ids,
    )
    wired_drives.receive([Frame(can_id | frame_flags, data, bus=bus)])
    if frame_flags or not is_sensor_frame:
        assert state_without_unknown_counters(wired_drives) == state_before
    assert len(wired_drives.foreign_frames) == (
        bus == 0 and not frame_flags and can_id in node.host_ids
    )
    assert wired_drives.field_number("strange") == (
        not wired_drives.foreign_frames and not (is_sensor_frame and frame_flags in (0, ERROR_FLAG))
    )
    is_known_frame = (
        is_sensor_frame and frame_flags == 0 and len(data) == node.lengths[node.ids.index(can_id)]
    )
    assert wired_drives.has_malformed_frame == (
        is_sensor_frame and frame_flags != ERROR_FLAG and not is_known_frame
    )


@pytest.mark.parametrize("frame_length", [0, 1, 7, 9, 64])
def test_a_frame_of_a_wrong_length_is_counted_and_not_read(
    node: SensorNode, frame_length: int
) -> None:
    wired_drives = state_after_sync(node, 0).receive([Frame(0x1A0, bytes(frame_length))])
    assert wired_drives.has_malformed_frame
    assert wired_drives.tensions == {}


def test_the_exchange_is_what_the_frames_take(node: SensorNode) -> None:
    frames = encode_frames(0x1A0, "tension", 0, [0] * CHANNEL_COUNT) + encode_frames(
        0x1B0, "joint", 0, [0] * CHANNEL_COUNT
    )
    assert [size for size, _ in node.frames_per_tick] == [1, *(len(frame.data) for frame in frames)]
    assert sum(rate for _, rate in node.frames_per_tick) == 1 + 3 + 3 / 4


def test_a_saturated_load_cell_is_beyond_the_rail_after_any_tare(node: SensorNode) -> None:
    for tare in (-6.0, 0.0, 6.0):
        assert 249.9375 - tare >= node.tension_rail


def test_the_simulated_node_and_the_host_agree(node: SensorNode) -> None:
    from firmware_sim.nodes.sensor_node import joint_code, pack, tension_code

    forces, angles = [7.3 * i for i in range(5)], [0.4 * i - 0.8 for i in range(5)]
    frames = [
        Frame(0x1A0, pack(3, [tension_code(force) for force in forces])),
        Frame(0x1B0, pack(3, [joint_code(angle) for angle in angles])),
    ]
    wired_drives = state_after_sync(node, tick_with_counter_nibble(node, 3)).receive(frames)
    assert list(wired_drives.tensions.values()) == pytest.approx(forces, abs=0.0625 / 2)
    assert list(wired_drives.joint_readings.values()) == pytest.approx(angles, abs=math.pi / 4096)


def test_a_frame_group_counts_its_frames(node: SensorNode) -> None:
    wired_drives = WiredDrives((), node)
    for k in (5, 6):
        sync = wired_drives.begin_tick_with_sync(tick_with_counter_nibble(node, k))
        wired_drives.receive(
            encode_frames(0x1A0, "tension", k & 0xF, [1.0] * CHANNEL_COUNT, t_ns=k)
        )
    assert wired_drives.field_number("sync_asked") == 6
    assert wired_drives.field_number("syncs") == 2
    assert wired_drives.field_view("group_frames").tolist() == [2, 2, 2, 0, 0, 0]
    assert wired_drives.field_view("group_ns").tolist() == [6, 6, 6, -1, -1, -1]
    assert wired_drives.field_view("group_answered").tolist() == [1, 1, 1, 0, 0, 0]
    other_node = SensorNode.from_description(SensorNodeSection(), 1, TENDON_NAMES, JOINT_NAMES)
    assert other_node.sync(0x1FF) == Frame(0x080, other_node.counters[0x1FF:0x200], bus=1)
    assert sync.bus == 0


def test_stale_and_unreadable_values_are_counted_separately(node: SensorNode) -> None:
    wired_drives = state_after_sync(node, tick_with_counter_nibble(node, 1)).receive(
        [Frame(0x1A0, bytes(3))]
    )
    (good, *_) = encode_frames(0x1A0, "tension", 2, [1.0] * CHANNEL_COUNT)
    wired_drives.receive([good])
    assert (wired_drives.has_malformed_frame, wired_drives.field_number("stale")) == (True, 1)
    (fresh, *_) = encode_frames(0x1A0, "tension", 1, [1.0] * CHANNEL_COUNT)
    wired_drives.receive([fresh])
    assert (wired_drives.has_malformed_frame, wired_drives.field_number("stale")) == (True, 1), (
        "neither is forgotten with the next good frame"
    )


def test_channels_that_are_empty_or_full(node: SensorNode) -> None:
    low, top = TENSION_ZERO_N, TENSION_MAX_N
    wired_drives = state_after_sync(node, 0)
    assert not wired_drives.observe_readings().field_view("saturated").any()
    for i, cell in {0: low, 1: low + 0.1, 3: top - 0.1, 4: top, 7: math.nan}.items():
        wired_drives.field_view("cell")[i], wired_drives.field_view("cell_fresh")[i] = cell, 1
    assert np.flatnonzero(wired_drives.observe_readings().field_view("saturated")).tolist() == [
        0,
        4,
        7,
    ]


def test_all_load_cells_are_read_when_each_has_been_read_once(node: SensorNode) -> None:
    """The first readings of the load cells can arrive in any order, and in different ticks.

    The host does not wait for readings of joint encoders.
    """
    wired, bare = (
        WiredDrives((), sensor_interface)
        for sensor_interface in (
            node,
            replace(node, tendon_frame_indices=(*node.tendon_frame_indices[:-1], -1)),
        )
    )
    for hand in (wired, bare):
        hand.field_view("position")[...] = 0.0
    for k, (base, done) in enumerate(
        [(0x1B0, False), (0x1A0, False), (0x1A0, False), (0x1A1, False), (0x1A2, True)]
    ):
        size = node.lengths[node.ids.index(base)]
        for hand in (wired, bare):
            sync = hand.begin_tick_with_sync(k)
            hand.receive(
                [Frame(base, bytes([sync.data[0] & 0xF] + [0] * (size - 1)))]
            ).observe_readings()
        assert wired.field_number("started") == done, hex(base)
        # The last frame contains only the load cell of the last tendon. The second hand of this
        # test has no load cell for the last tendon.
        assert bare.field_number("started") == (done or base == 0x1A1), hex(base)


def test_each_joint_frame_has_its_joints_and_the_time_when_it_came_last(node: SensorNode) -> None:
    wired_drives = WiredDrives((), node)
    counter = wired_drives.begin_tick_with_sync(1).data[0] & 0xF
    assert [node.group_of_joint(j) for j in range(CHANNEL_COUNT)] == [3] * 5 + [4] * 5 + [5]
    first_frame, second_frame, _ = encode_frames(
        0x1B0, "joint", counter, range(CHANNEL_COUNT), t_ns=30
    )
    assert wired_drives.receive([second_frame._replace(t_ns=20)]).field_view("group_ns")[
        3:
    ].tolist() == [
        -1,
        20,
        -1,
    ]
    wired_drives.receive(encode_frames(0x1A0, "tension", counter, range(CHANNEL_COUNT), t_ns=40))
    assert wired_drives.field_view("group_ns")[3:].tolist() == [-1, 20, -1], (
        "load cells are no joints"
    )
    assert wired_drives.receive([first_frame]).field_view("group_ns")[3:].tolist() == [30, 20, -1]


def test_lost_frames_are_those_that_never_came(node: SensorNode) -> None:
    assert node.lost_frame_count(0, 0, 0) == 0
    assert node.lost_frame_count(10, 27, 0) == 0, "the last ones may be on their way"
    assert node.lost_frame_count(10, 20, 3) == 4
