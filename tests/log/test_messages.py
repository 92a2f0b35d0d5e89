"""Every message of a log has the same bytes as the message that mcap-ros2-support and rosbags write."""

import math
import struct
from pathlib import Path

import numpy as np
import pytest
import varied_run
from other_log_readers import (
    Ros2SupportSerialiser,
    RosbagsSerialiser,
    messages_by_topic,
    other_serialisers,
)
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from handctl.core.plain_data import serialized_bytes
from handctl.log.message_types import MESSAGE_DEFINITIONS, schema_name, schema_text
from handctl.log.read.reader import RunLog
from handctl.log.tick_packing import pack_snapshot, pack_tick_record
from handctl.log.topics.can_frame_topics import encode_fd_frame
from handctl.log.topics.event_topics import (
    encode_enum_message,
    encode_parameter_event,
    encode_rosout,
)
from handctl.log.topics.health_topics import DiagnosticStatus, encode_diagnostic_array
from handctl.log.write.recorder import Recorder

STANDARD_PACKAGES = (
    "builtin_interfaces",
    "std_msgs",
    "geometry_msgs",
    "tf2_msgs",
    "sensor_msgs",
    "diagnostic_msgs",
)


SNAPSHOT_NUMBERS_BY_TICK = {30: b"one state", 136: bytes(range(256)) * 100}
"""Numbers of the snapshots that the recorded run contains.

Each key of the dictionary is the number of the tick before the snapshot.
"""
SNAPSHOT_DECISIONS = (":Decisions", math.nan, None, ("index", True), b"\x00\xff")
"""Decisions of each snapshot that the recorded run contains."""
SNAPSHOT_DECISIONS_JSON = b'[":Decisions",NaN,null,["index",true],[":bytes","00ff"]]'


@pytest.fixture(scope="module")
def varied_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lively") / "run.mcap"
    run = varied_run.varied_header(deterministic=False)
    recorder = Recorder.start(path, run)
    for tick_in, out in varied_run.varied_ticks(run):
        assert recorder.send_record(pack_tick_record(tick_in, out))
        if numbers := SNAPSHOT_NUMBERS_BY_TICK.get(tick_in.k):
            decisions = serialized_bytes(SNAPSHOT_DECISIONS)
            assert recorder.send_record(pack_snapshot(tick_in, numbers, decisions))
    assert recorder.close("finished")["complete"]
    return path


@pytest.mark.parametrize("name", MESSAGE_DEFINITIONS)
def test_a_standard_type_has_the_fields_and_constants_of_ros(name: str) -> None:
    package = name.split("/")[0]
    types = get_types_from_msg(schema_text(name), schema_name(name))
    if package in STANDARD_PACKAGES or name in (
        "rcl_interfaces/Log",
        "rcl_interfaces/ParameterEvent",
    ):
        ros_humble_fields = get_typestore(Stores.ROS2_HUMBLE).fielddefs
        for kind, fields in types.items():
            assert fields == ros_humble_fields[kind], kind
    assert schema_name(name) in types


def test_every_topic_has_messages_in_the_lively_run(varied_log: Path) -> None:
    topics = messages_by_topic(varied_log)
    kinds = {message.kind for messages in topics.values() for message in messages}
    nested_types = {
        "Time",
        "Header",
        "Vector3",
        "Quaternion",
        "Transform",
        "TransformStamped",
        "Wrench",
        "KeyValue",
    }
    nested_types |= {
        "DiagnosticStatus",
        "ParameterValue",
        "Parameter",
        "CanFrame",
        "IoEvent",
        "Event",
    }
    assert kinds == {
        schema_name(name) for name in MESSAGE_DEFINITIONS if name.split("/")[1] not in nested_types
    }


def test_a_snapshot_is_read_as_it_was_written(varied_log: Path) -> None:
    with RunLog(varied_log) as run:
        assert dict(run.snapshots) == {
            k: numbers + SNAPSHOT_DECISIONS_JSON for k, numbers in SNAPSHOT_NUMBERS_BY_TICK.items()
        }


def test_both_serialisers_give_back_every_message(varied_log: Path) -> None:
    message_count = 0
    for messages in messages_by_topic(varied_log).values():
        first_message = messages[0]
        for serialiser in other_serialisers(first_message.kind, first_message.schema):
            for message in messages:
                assert serialiser.encode(serialiser.decode(message.data)) == message.data, (
                    message.topic
                )
                message_count += 1
    assert message_count > 5000


def _built_message(type_name: str, field_values: dict[str, object]) -> bytes:
    return Ros2SupportSerialiser(schema_name(type_name), schema_text(type_name)).encode(
        field_values
    )


EXPECTED_STAMP = {"sec": 5, "nanosec": 7}
T_NS = 5_000_000_007
EXPECTED_LABEL = {"header": {"stamp": EXPECTED_STAMP, "frame_id": ""}, "name": "hold"}


@pytest.mark.parametrize(
    ("kind", "ours", "values"),
    [
        (
            "rcl_interfaces/Log",
            encode_rosout(T_NS, "warn", "handctl.x", "text"),
            {"stamp": EXPECTED_STAMP, "level": 30, "name": "handctl.x", "msg": "text"},
        ),
        (
            "handctl_msgs/GraspPhase",
            encode_enum_message(T_NS, 6, "hold"),
            EXPECTED_LABEL | {"phase": 6},
        ),
        (
            "handctl_msgs/Mode",
            encode_enum_message(T_NS, 6, "hold"),
            EXPECTED_LABEL | {"mode": 6},
        ),
        (
            "ros2_socketcan_msgs/FdFrame",
            encode_fd_frame("main", T_NS, 0x8000_1234, bytes(range(20))),
            {
                "header": {"stamp": EXPECTED_STAMP, "frame_id": "main"},
                "id": 0x1234,
                "is_extended": True,
                "len": 20,
                "data": bytes(range(20)),
            },
        ),
        (
            "diagnostic_msgs/DiagnosticArray",
            encode_diagnostic_array(
                T_NS,
                [DiagnosticStatus(2, "a", "b", "c", {"k": "v"}), DiagnosticStatus(0, "", "", "")],
            ),
            {
                "header": {"stamp": EXPECTED_STAMP},
                "status": [
                    {
                        "level": 2,
                        "name": "a",
                        "message": "b",
                        "hardware_id": "c",
                        "values": [{"key": "k", "value": "v"}],
                    },
                    {"level": 0, "values": []},
                ],
            },
        ),
        (
            "rcl_interfaces/ParameterEvent",
            encode_parameter_event(T_NS, {"a": "0.5", "b": "word"}, {"c": "3"}),
            {
                "stamp": EXPECTED_STAMP,
                "node": "/handctl",
                "new_parameters": [
                    {"name": "a", "value": {"type": 3, "double_value": 0.5}},
                    {"name": "b", "value": {"type": 4, "string_value": "word"}},
                ],
                "changed_parameters": [{"name": "c", "value": {"type": 3, "double_value": 3.0}}],
            },
        ),
    ],
)
def test_message_equals_the_reference_encoding(
    kind: str, ours: bytes, values: dict[str, object]
) -> None:
    assert ours == _built_message(kind, values)


def test_joint_states_carry_the_telemetry_by_name(varied_log: Path) -> None:
    run, logged = varied_run.varied_header(), messages_by_topic(varied_log)["/joint_states"]
    serialiser = RosbagsSerialiser(logged[0].kind, logged[0].schema)
    for (tick_in, out), message in zip(varied_run.varied_ticks(run), logged, strict=True):
        state = serialiser.decode(message.data)
        assert state.name == list(run.joints)
        np.testing.assert_array_equal(state.position, out.telemetry.q)
        np.testing.assert_array_equal(state.velocity, out.telemetry.dq)
        assert (message.sequence, message.log_time) == (tick_in.k, tick_in.t_ns)
        assert state.header.stamp.sec * 10**9 + state.header.stamp.nanosec == tick_in.t_ns


def test_frames_of_all_buses_stay_in_order(varied_log: Path) -> None:
    topics = messages_by_topic(varied_log)
    for topic, choose in (("rx", lambda i, o: i.frames), ("tx", lambda i, o: o.frames)):
        for suffix, is_fd in (("", False), ("_fd", True)):
            messages = topics[f"/can/{topic}{suffix}"]
            serialiser = RosbagsSerialiser(messages[0].kind, messages[0].schema)
            decoded_messages = [serialiser.decode(message.data) for message in messages]
            sent = [
                frame
                for tick in varied_run.varied_ticks(varied_run.varied_header())
                for frame in choose(*tick)
                if bool(frame.flags & 4) == is_fd
            ]
            assert len(sent) == len(decoded_messages) > 50
            for frame, message in zip(sent, decoded_messages, strict=True):
                assert message.id == frame.can_id & 0x1FFF_FFFF
                assert message.is_extended == bool(frame.can_id >> 31)
                assert message.is_error == bool(frame.can_id >> 29 & 1)
                assert (
                    message.header.frame_id == (*varied_run.BUS_NAMES, "unknown")[min(frame.bus, 2)]
                )
                length = message.len if is_fd else message.dlc
                assert bytes(message.data[:length]) == frame.data
                assert is_fd or message.is_rtr == bool(frame.can_id >> 30 & 1)


def test_received_frames_have_their_time_and_sent_frames_that_of_their_tick(
    varied_log: Path,
) -> None:
    topics = messages_by_topic(varied_log)
    times = [
        frame.t_ns
        for tick_in, _ in varied_run.varied_ticks(varied_run.varied_header())
        for frame in tick_in.frames
        if not frame.flags
    ]
    assert [message.publish_time for message in topics["/can/rx"]] == times
    serialiser = RosbagsSerialiser(topics["/can/tx"][0].kind, topics["/can/tx"][0].schema)
    starts = {
        tick_in.k: tick_in.t_ns + tick_in.late_ns
        for tick_in, _ in varied_run.varied_ticks(varied_run.varied_header())
    }
    for message in topics["/can/tx"]:
        stamp = serialiser.decode(message.data).header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == starts[message.sequence] == message.publish_time


def test_every_message_header_is_little_endian_cdr(varied_log: Path) -> None:
    for messages in messages_by_topic(varied_log).values():
        assert all(struct.unpack_from("<I", message.data)[0] == 0x100 for message in messages)
