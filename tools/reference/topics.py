"""Generate the blocks about the topics of a log.

The program takes the topics from the packaged hands.
"""

import re

from handctl.core.tick_types import TELEMETRY_AXES, TELEMETRY_FIELDS, Telemetry
from handctl.hand.hand_loading import load_hand
from handctl.log.export.csv_and_candump import column_unit
from handctl.log.header import RunHeader
from handctl.log.message_types import MESSAGE_DEFINITIONS
from handctl.log.topics.state_topics import ESTIMATE_TOPICS, JOINT_STATE_TOPICS
from handctl.log.topics.topic_set import TopicSet
from tools.reference.markdown import attribute_docstrings, markdown_table, quoted_code

EVERY_TICK = "every tick"
EXAMPLE_HANDS = ("jamia", "orca_like")
"""Packaged hands whose runs together have all topics."""
TOPIC_CONTENT = {
    "/robot_description": ("at the start", "URDF of the hand"),
    "/controller/names": (
        "at the start",
        "names of the columns of `/controller/values`: `field/name`",
    ),
    "/controller/values": (EVERY_TICK, "all telemetry of the tick, see below"),
    "/controller/mode": ("at a change", "mode of the hand"),
    "/controller/snapshot": (
        "2 Hz",
        "whole state of the controller, for the code that wrote it",
    ),
    "/tick": (
        EVERY_TICK,
        "the tick as it happened: times [ns], frames, requests, events, hash of the state",
    ),
    "/tick/chain": (EVERY_TICK, "hash over this tick and the hash before it"),
    "/tf_static": ("at the start", "fixed frames [m]"),
    "/tf": ("50 Hz", "pose of each link [m, quaternion] by the estimated angles"),
    "/rosout": ("per event", "events as text, faults included"),
    "/stream/target": (
        "per target",
        "streamed targets as they arrived: angle [deg], tension or force [N], age [s]",
    ),
    "/parameter_events": ("at a change", "gains at the start and after each change"),
    "/grasp/phase": ("at a change", "phase of the task"),
    "/safety/action": ("at a change", "largest reaction that a fault demands"),
    "/cycle": (EVERY_TICK, "period, lateness, age of the feedback [s], missed ticks"),
    "/can/rx": ("per frame", "received classical frames of all buses, `frame_id` is the bus"),
    "/can/rx_fd": ("per frame", "received CAN FD frames"),
    "/can/tx": ("per frame", "sent classical frames"),
    "/can/tx_fd": ("per frame", "sent CAN FD frames"),
    "/diagnostics": ("1 Hz and at a change", "state of motors, buses and controller"),
    "/clock_pairs": ("every 10 s", "wall clock and monotonic clock [ns]"),
    "/fingertip/DIGIT/wrench": (
        EVERY_TICK,
        "tip-equivalent force of the object on the digit [N], in the frame of the tip",
    ),
    "/spool_pairs": (
        EVERY_TICK,
        "of a hand with spool pairs: estimated tension of both tendons of each pair [N]",
    ),
    "/actuator/MOTOR/temperature": ("5 Hz", "temperature of the drive [degC]"),
}
"""Rate and content of the topics that have no telemetry fields."""
TOPIC_REMARKS = {
    "/joint_states": "The effort is the torque of the tendons at the estimated tension, R^T f without friction.",
    "/tendon_states": "The effort is the estimated tension at the load cell, the net tension of a spool pair.",
    "/tendon_commands": "The effort is the commanded tension at the load cell.",
    "/actuator_states": "At the spool. Positive values wind the tendon.",
}
"""Remarks on JointState topics whose fields need an explanation."""
PRINTED_TYPES = ("handctl_msgs/", "sensor_msgs/JointState", "pal_statistics_msgs/StatisticsValues")
"""Prefixes of the message types whose definitions the page prints."""


def packaged_hand_topics() -> dict[str, tuple[str, str]]:
    """Return the message type of each topic of the packaged hands, and the note that a log stores with the topic.

    In the names of the topics, placeholders replace the names of digits and motors.
    """
    registered_topics = {}
    for name in EXAMPLE_HANDS:
        header = RunHeader.from_hand(load_hand(name).to_toml(), 2_000_000)
        topic_set = TopicSet(header)
        types = {schema.id: schema.name for schema in topic_set.schemas}
        for channel in topic_set.channels:
            topic = _topic_with_placeholder(channel.topic, header)
            registered_topics[topic] = (types[channel.schema_id], channel.metadata.get("note", ""))
    return registered_topics


def _topic_with_placeholder(topic: str, header: RunHeader) -> str:
    """Replace the name of a digit or motor in a topic by a placeholder."""
    names = dict.fromkeys(header.digits, "DIGIT") | dict.fromkeys(header.motors, "MOTOR")
    return "/".join(names.get(word, word) for word in topic.split("/"))


def topic_table() -> str:
    """Return a table of all topics.

    The columns are topic, message type, rate and content. The column with the content also contains
    the units.
    """
    topic_types = sorted(packaged_hand_topics().items())
    rows = (
        (quoted_code(topic), _linked_type(kind), *topic_content(topic, note))
        for topic, (kind, note) in topic_types
    )
    return markdown_table(("topic", "message type", "rate", "content"), rows)


def _linked_type(type_name: str) -> str:
    """Return the name of a message type.

    The name is a link if the page contains the definition of this message type.
    """
    name = type_name.replace("/msg/", "/")
    if name not in MESSAGE_DEFINITIONS or not name.startswith(PRINTED_TYPES):
        return quoted_code(type_name)
    return f"[{quoted_code(type_name)}](#{re.sub('[^a-z_]', '', name.lower())})"


def topic_content(topic: str, note: str) -> tuple[str, str]:
    """Return the rate and the content of a topic.

    Raises:
        KeyError: this module has no text about the topic.
    """
    if topic in JOINT_STATE_TOPICS:
        axis, *fields = JOINT_STATE_TOPICS[topic]
        field_texts = [
            f"{part_label} `{field}` [{_unit_of_field(field)}]"
            for part_label, field in zip(("position:", "velocity:", "effort:"), fields, strict=True)
            if field
        ]
        text = f"per {axis}, {', '.join(field_texts)}"
        remark = TOPIC_REMARKS.get(topic, "")
        return EVERY_TICK, f"{text}. {remark}" if remark else text
    if topic in ESTIMATE_TOPICS:
        field, unit = ESTIMATE_TOPICS[topic]
        return (
            EVERY_TICK,
            f"`{field}` per {TELEMETRY_AXES[field]} with its variance [{unit}, {unit}²]",
        )
    return TOPIC_CONTENT[topic]


def message_types() -> str:
    """Return the definitions of the message types of handctl, and of two other types that most topics use."""
    sections = []
    for name, definition in MESSAGE_DEFINITIONS.items():
        if name.startswith(PRINTED_TYPES):
            sections += [f"### {name}", f"```text\n{definition.strip()}\n```"]
    return "\n\n".join(sections)


def telemetry_table() -> str:
    """Return a table of the telemetry fields, in the order of `/controller/values`."""
    meanings = attribute_docstrings(Telemetry)
    rows = (
        (quoted_code(field), TELEMETRY_AXES[field], _unit_of_field(field), meanings[field])
        for field in TELEMETRY_FIELDS
    )
    return markdown_table(("field", "per", "unit", "meaning"), rows)


def _unit_of_field(field: str) -> str:
    """Return the unit of a telemetry field.

    If the log derives a torque from the field, return the unit of this torque.
    """
    return "N m" if field == "tendon_torque" else column_unit(f"{field}/x")
