"""The topics of a log are complete, wherever the log is divided into chunks.

Sequence numbers make it possible to join messages of different topics. Tools of other projects can
read the topics.
"""

import json
import math
import os
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import synthetic_run
import varied_run
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from other_log_readers import RosbagsSerialiser, messages_by_topic, read_messages
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from handctl.core.tick_types import StreamTarget
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import load_hand
from handctl.hand.link_frames import link_transforms
from handctl.log.header import RunHeader
from handctl.log.tick_packing import pack_tick_record
from handctl.log.tick_record import RECORD_FRAMING_STRUCT
from handctl.log.topics.transform_topics import link_frames
from handctl.log.write.log_writer import LogWriter
from handctl.programs.requests import target_request_text


def _write_log(
    log_path: Path,
    run_header: RunHeader,
    tick_bodies: list[bytes],
    chunk_borders: frozenset[int] = frozenset(),
    event_texts: tuple[str, ...] = (),
) -> Path:
    """Write a log in the test process, and end an MCAP chunk after each tick whose index is in ``chunk_borders``.

    Assert that the log writer reports exactly the events ``event_texts``.
    """
    log_path.unlink(missing_ok=True)
    problems: list[str] = []
    writer = LogWriter(log_path, run_header, lambda event, number: problems.append(event), 1)
    for index, body in enumerate(tick_bodies):
        writer.add_tick(body)
        if index in chunk_borders:
            writer.flush()
    writer.finish("finished", 0)
    assert tuple(problems) == event_texts
    return log_path


def _tick_bodies(run_header: RunHeader) -> list[bytes]:
    return [
        pack_tick_record(*tick)[RECORD_FRAMING_STRUCT.size :]
        for tick in varied_run.varied_ticks(run_header)
    ]


def test_rosbags_reads_every_message(run_log: Path) -> None:
    with AnyReader([run_log]) as reader:
        topics = Counter()
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            topics[connection.topic] += 1
        assert sum(topics.values()) == reader.message_count
        latched_topics = {
            connection.topic
            for connection in reader.connections
            if connection.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
        }
    assert latched_topics == {"/robot_description", "/tf_static", "/controller/names"}
    topics_of_every_tick = [topic for topic, number in topics.items() if number == 1000]
    assert len(topics_of_every_tick) == 17
    assert topics["/tf"] == 100
    assert topics["/actuator/index_motor/temperature"] == 10


def test_rerun_reads_a_log_and_moves_the_hand(run_log: Path) -> None:
    os.environ["RERUN_ANALYTICS"] = "off"
    rerun = pytest.importorskip("rerun")
    chunks = list(rerun.chunk.McapReader(run_log).stream())
    columns: dict[str, set[str]] = {}
    rows: Counter[str] = Counter()
    for chunk in chunks:
        batch = chunk.to_record_batch()
        columns.setdefault(chunk.entity_path, set()).update(batch.schema.names)
        if "message_log_time" in batch.schema.names:
            rows[chunk.entity_path] += batch.num_rows
    assert {"Scalars:scalars", "SeriesLines:names"} <= columns["/joint_states/position"]
    assert "Transform3D:quaternion" in columns["/tf"]
    assert any("Boxes3D" in name for names in columns.values() for name in names)
    assert rows["/joint_states/position"] >= 1000


def test_ticks_and_rows_join_by_sequence(run_log: Path) -> None:
    topics = messages_by_topic(run_log)
    for topic in (
        "/tick",
        "/joint_states",
        "/controller/values",
        "/cycle",
        "/fingertip/thumb/wrench",
    ):
        assert [message.sequence for message in topics[topic]] == list(range(1000)), topic
        assert [message.log_time for message in topics[topic]] == [
            2_000_000 * k for k in range(1000)
        ], topic


@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(chunk_borders=st.frozensets(st.integers(0, 119), max_size=40))
def test_messages_do_not_depend_on_where_chunks_end(
    tmp_path: Path, chunk_borders: frozenset[int]
) -> None:
    run = varied_run.varied_header()
    bodies = _tick_bodies(run)
    plain, cut = (
        messages_by_topic(_write_log(tmp_path / name, run, bodies, at))
        for name, at in (("a", frozenset()), ("b", chunk_borders))
    )
    assert plain.keys() == cut.keys()
    for topic, expected in plain.items():
        assert cut[topic] == expected, topic


def test_equal_lockstep_runs_give_equal_files_except_the_wall_clock(tmp_path: Path) -> None:
    runs = [
        synthetic_run.synthetic_header(rate_hz=500, wall={"started": day, "pid": day})
        for day in ("2026-01-01", "2026-01-02")
    ]
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for path, run in zip(paths, runs, strict=True):
        synthetic_run.write_synthetic_run(path, run, 1.0)
    assert read_messages(paths[0]) == read_messages(paths[1])
    first_content, second_content = (path.read_bytes() for path in paths)
    assert first_content != second_content
    wall = synthetic_run.synthetic_header(rate_hz=500)
    other_paths = [tmp_path / "c.mcap", tmp_path / "d.mcap"]
    for path in other_paths:
        synthetic_run.write_synthetic_run(path, wall, 1.0)
    assert other_paths[0].read_bytes() == other_paths[1].read_bytes()


def test_the_wall_offset_shifts_all_times_alike(tmp_path: Path) -> None:
    run, offset = varied_run.varied_header(), 1_700_000_000_123_456_789
    bodies = _tick_bodies(run)
    plain_messages = read_messages(_write_log(tmp_path / "a", run, bodies))
    shifted_log = read_messages(
        _write_log(tmp_path / "b", varied_run.varied_header(offset_ns=offset), bodies)
    )
    assert [message.log_time + offset for message in plain_messages] == [
        message.log_time for message in shifted_log
    ]
    states = [message for message in shifted_log if message.topic == "/joint_states"]
    serialiser = RosbagsSerialiser(states[0].kind, states[0].schema)
    for state in states:
        stamp = serialiser.decode(state.data).header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == state.log_time


@pytest.mark.parametrize("hand", ["jamia", "jamia11"])
def test_transforms_equal_the_kinematics_of_the_hand(tmp_path: Path, hand: str) -> None:
    run, hand_description = synthetic_run.synthetic_header(hand, rate_hz=50), load_hand(hand)
    digits = [DigitModel.from_hand(hand_description, name) for name in run.digits]
    ticks = list(synthetic_run.SyntheticRunTicks(run, 1.0))
    topics = messages_by_topic(
        _write_log(
            tmp_path / "a",
            run,
            [pack_tick_record(*tick)[RECORD_FRAMING_STRUCT.size :] for tick in ticks],
        )
    )
    tf, fixed = topics["/tf"], topics["/tf_static"][0]
    serialiser = RosbagsSerialiser(fixed.kind, fixed.schema)
    tips = serialiser.decode(fixed.data).transforms
    assert len(tf) == 50
    for (_, out), message in zip(ticks, tf, strict=True):
        pose = {"palm": (np.zeros(3), Rotation.identity())}
        for transform in serialiser.decode(message.data).transforms + tips:
            move, turn = transform.transform.translation, transform.transform.rotation
            origin, frame = pose[transform.header.frame_id]
            rotation_in_palm = frame * Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
            pose[transform.child_frame_id] = (
                origin + frame.apply([move.x, move.y, move.z]),
                rotation_in_palm,
            )
        for digit, joints_of_digit in zip(
            digits, hand_description.digit_joints.values(), strict=True
        ):
            for link in link_transforms(digit, out.telemetry.q[joints_of_digit]):
                origin, frame = pose[link.frame]
                np.testing.assert_allclose(origin, link.position, atol=1e-12)
                assert (frame.inv() * Rotation.from_quat(link.quaternion_xyzw)).magnitude() < 1e-12


@pytest.mark.parametrize("hand", ["jamia", "jamia11"])
def test_frames_have_the_parents_of_the_urdf(hand: str) -> None:
    run = synthetic_run.synthetic_header(hand)
    joints = ElementTree.fromstring(run.attachments["hand.urdf"]).findall("joint")
    expected = {
        (
            joint.find("parent").get("link"),
            joint.find("child").get("link"),
            joint.get("type") == "revolute",
        )
        for joint in joints
    }
    assert {
        (link.parent, link.child, link.joint >= 0) for link in link_frames(run.hand_toml)
    } == expected


def test_frames_form_one_tree() -> None:
    link_tree = link_frames(synthetic_run.synthetic_header().hand_toml)
    frame_names = {"palm"}
    for link in link_tree:
        assert link.parent in frame_names
        assert link.child not in frame_names
        frame_names.add(link.child)
    assert [link.joint for link in link_tree if link.joint >= 0] == list(range(11))
    assert {f"{digit}_tip" for digit in synthetic_run.synthetic_header().digits} <= frame_names


def test_streamed_targets_have_a_topic_and_no_line_in_rosout(tmp_path: Path) -> None:
    run = varied_run.varied_header()
    ticks = [(tick_in._replace(requests=()), out) for tick_in, out in varied_run.varied_ticks(run)]
    open_stream_request = {
        "do": "stream",
        "stream": "s",
        "space": "joint",
        "names": ["index_j1", "thumb_j1"],
        "rate_Hz": 100.0,
    }
    target_requests = {
        0: (json.dumps(open_stream_request),),
        2: (
            StreamTarget("s", 0, ticks[2][0].t_ns - 3_000_000, (1.5, math.nan)),
            target_request_text(StreamTarget("t", 1, 0, (1e308,))),
        ),
        3: (
            target_request_text(StreamTarget("s", 2**63 - 1, 0, ())),
            # the log has no message for a refused target
            target_request_text(StreamTarget("s", 2**70, 0, ())),
            '{"do": "target", nonsense',
            '{"do": "stop"}',
        ),
    }
    ticks = [
        (tick_in._replace(requests=target_requests.get(i, ())), out)
        for i, (tick_in, out) in enumerate(ticks)
    ]
    topics = messages_by_topic(
        _write_log(
            tmp_path / "a",
            run,
            [pack_tick_record(*tick)[RECORD_FRAMING_STRUCT.size :] for tick in ticks],
        )
    )
    targets = topics["/stream/target"]
    serialiser = RosbagsSerialiser(targets[0].kind, targets[0].schema)
    first_target, other_target, last_target = (serialiser.decode(target.data) for target in targets)
    assert (first_target.stream, first_target.number, first_target.name) == (
        "s",
        0,
        ["index_j1", "thumb_j1"],
    )
    assert first_target.age == pytest.approx(0.003)
    np.testing.assert_array_equal(first_target.value, [1.5, math.nan])
    assert (other_target.stream, other_target.name, other_target.value.tolist()) == (
        "t",
        [],
        [1e308],
    ), "a stream that was never opened"
    assert (last_target.number, last_target.name) == (2**63 - 1, [])
    lines = [
        RosbagsSerialiser(line_message.kind, line_message.schema).decode(line_message.data)
        for line_message in topics["/rosout"]
    ]
    request_lines = [line.msg for line in lines if line.name == "handctl.request"]
    assert request_lines[:2] == [json.dumps(open_stream_request), '{"do": "stop"}']
    assert not any("target" in line for line in request_lines)


def test_the_cycle_topic_has_missed_ticks_and_lateness(tmp_path: Path) -> None:
    run = varied_run.varied_header()
    ticks = list(varied_run.varied_ticks(run))
    topics = messages_by_topic(_write_log(tmp_path / "a", run, _tick_bodies(run)))["/cycle"]
    serialiser = RosbagsSerialiser(topics[0].kind, topics[0].schema)
    last_tick_and_start = None
    for (tick_in, out), message in zip(ticks, topics, strict=True):
        cycle, start = serialiser.decode(message.data), (tick_in.t_ns + tick_in.late_ns) * 1e-9
        assert cycle.missed == (
            tick_in.k - last_tick_and_start[0] - 1 if last_tick_and_start else 0
        )
        assert cycle.late == tick_in.late_ns * 1e-9
        assert (cycle.mode, cycle.action) == (out.mode, out.action)
        if last_tick_and_start is None:
            assert np.isnan(cycle.period)
        else:
            assert cycle.period == pytest.approx(start - last_tick_and_start[1])
            reply_times_s = [frame.t_ns * 1e-9 - last_tick_and_start[1] for frame in tick_in.frames]
            assert (
                cycle.last_reply == pytest.approx(max(reply_times_s), abs=1e-12)
                if reply_times_s
                else np.isnan(cycle.last_reply)
            )
        last_tick_and_start = tick_in.k, start


def test_the_wrench_points_against_closing(run_log: Path) -> None:
    topics = messages_by_topic(run_log)["/fingertip/index/wrench"]
    serialiser = RosbagsSerialiser(topics[0].kind, topics[0].schema)
    forces = np.array(
        [[(w := serialiser.decode(topic.data).wrench.force).x, w.y, w.z] for topic in topics]
    )
    assert forces[:, 1].min() < -0.5
    assert (forces[:, 1] <= 0).all()
    assert not forces[:, [0, 2]].any()


def test_telemetry_of_another_shape_becomes_nan_and_is_counted(tmp_path: Path) -> None:
    run, other_header = (
        synthetic_run.synthetic_header("jamia", 100),
        synthetic_run.synthetic_header("jamia11", 100),
    )
    bodies = [
        pack_tick_record(*tick)[RECORD_FRAMING_STRUCT.size :]
        for tick in synthetic_run.SyntheticRunTicks(other_header, 0.1)
    ]
    log = _write_log(tmp_path / "a", run, bodies, event_texts=("misshapen",))
    topics = messages_by_topic(log)["/tendon_states"]
    serialiser = RosbagsSerialiser(topics[0].kind, topics[0].schema)
    assert all(np.isnan(serialiser.decode(topic.data).effort).all() for topic in topics)
