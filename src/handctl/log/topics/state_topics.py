"""Topics with one message of constant layout for each tick."""

import tomllib

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import TELEMETRY_AXES, TELEMETRY_FIELDS
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_from_content, parse_toml
from handctl.hand.moment_arms import moment_arms_at
from handctl.log.cdr import CdrWriter, MessageTemplate, TemplateWriter
from handctl.log.header import RunHeader
from handctl.log.mcap_container import MessageBlock
from handctl.log.tick_batch import TickBatch, columns_of_fields
from handctl.log.topics.message_streams import MessageStamps, MessageStream, TopicRegistry

FloatArray = NDArray[np.float64]

JOINT_STATE_TOPICS = {
    "/joint_states": ("joint", "q", "dq", "tendon_torque"),
    "/joint_commands": ("joint", "q_goal", "dq_goal", "joint_torque"),
    "/tendon_states": ("tendon", "excursion", "excursion_rate", "tension"),
    "/tendon_commands": ("tendon", "", "", "tension_goal"),
    "/actuator_states": ("motor", "motor_position", "motor_velocity", "motor_torque"),
    "/actuator_commands": ("motor", "", "", "motor_torque_goal"),
}
"""Telemetry axis of each JointState topic, and the telemetry fields for position, velocity and effort, by topic.

If no telemetry field is given for an array, the array is empty in the message, as ROS 2 permits.
"""

ESTIMATE_TOPICS = {
    "/force_estimate": ("tension", "N"),
    "/joint_estimate": ("q", "rad"),
    "/tip_force_estimate": ("tip_force", "N"),
}
"""Telemetry field and unit of each topic with estimates.

The telemetry also has a standard deviation for each of these fields.
"""

SPOOL_PAIRS_TOPIC = "/spool_pairs"
"""Topic with the estimated tension of both tendons of each spool pair.

Only hands with spool pairs have this topic.
"""

_TOPIC_NOTES = {
    "/joint_estimate": "joint angles and their variance, large where a digit in contact has fewer tendons than joints",
    "/tip_force_estimate": "tip-equivalent force and its variance",
    "/joint_states": "effort: torque of the tendons at the estimated tension, R^T f without friction [N m]",
    "/tendon_states": "position: excursion [m]; effort: estimated tension at the load cell, net of a spool pair [N]",
    "/tendon_commands": "effort: commanded tension at the load cell [N]",
    "/actuator_states": "at the spool, positive winds",
    SPOOL_PAIRS_TOPIC: "effort: estimated tension of the first tendon, which a positive torque winds, "
    "and of the second [N]",
}
"""Notes for the metadata of the channels, by topic."""


def moment_arms(header: RunHeader) -> FloatArray:
    """Return the moment arms R (N, J) [m] of the tendons of a hand.

    If a moment arm depends on the joint angle, R contains the mean of this moment arm over the
    range of the joint.
    """
    return _hand_from_header(header).moment_arms


def _hand_from_header(header: RunHeader) -> Hand:
    """Return the hand that a header describes."""
    return hand_from_content(parse_toml(header.hand_toml, "hand"), "hand")


def spool_pair_pretensions(header: RunHeader) -> dict[str, float]:
    """Return the pretension [N] of each spool pair of the hand, by the name of the pair."""
    tendons = tomllib.loads(header.hand_toml)["tendon"]
    return {
        tendon["name"]: tendon["pretension_N"] for tendon in tendons if "pretension_N" in tendon
    }


def joint_state_template(
    names: tuple[str, ...], position: bool, velocity: bool, effort: bool
) -> MessageTemplate:
    """Return the template of a sensor_msgs/JointState message."""
    writer = TemplateWriter()
    writer.put_header()
    writer.put_strings(names)
    for name, is_present in (("position", position), ("velocity", velocity), ("effort", effort)):
        writer.put_float_sequence(name, len(names) if is_present else 0)
    return writer.finished_template()


def wrench_template(frame_id: str) -> MessageTemplate:
    """Return the template of a geometry_msgs/WrenchStamped message."""
    writer = TemplateWriter()
    writer.put_header(frame_id)
    writer.put_field("force", "<f8", 3)
    writer.put_field("torque", "<f8", 3)
    return writer.finished_template()


def statistics_values(number: int) -> MessageTemplate:
    """Return the template of a pal_statistics_msgs/StatisticsValues message.

    The message has `number` values and names_version 1.
    """
    writer = TemplateWriter()
    writer.put_header()
    writer.put_float_sequence("values", number)
    writer.put_length(1)
    return writer.finished_template()


def cycle_stats_template(motors: int) -> MessageTemplate:
    """Return the template of a handctl_msgs/CycleStats message."""
    writer = TemplateWriter()
    writer.put_header()
    writer.put_field("cycle", "<f8", 3)
    writer.put_field("missed", "<u4")
    writer.put_field("mode", "|u1")
    writer.put_field("action", "|u1")
    writer.put_float_sequence("stale", motors)
    return writer.finished_template()


def estimate_template(names: tuple[str, ...], unit: str) -> MessageTemplate:
    """Return the template of a handctl_msgs/Estimate message."""
    writer = TemplateWriter()
    writer.put_header()
    writer.put_strings(names)
    writer.put_float_sequence("value", len(names))
    writer.put_float_sequence("variance", len(names))
    writer.put_strings((unit,) * len(names))
    return writer.finished_template()


def encode_statistics_names(header: RunHeader, seconds: int, nanoseconds: int) -> bytes:
    """Encode the names (`field/name`) of the telemetry columns as pal_statistics_msgs/StatisticsNames."""
    writer = CdrWriter()
    writer.put_number("I", seconds)
    writer.put_number("I", nanoseconds)
    writer.put_string("")
    writer.put_strings(
        tuple(
            f"{name}/{element}"
            for name in TELEMETRY_FIELDS
            for element in header.axis_names(TELEMETRY_AXES[name])
        )
    )
    writer.put_length(1)
    return writer.finished_message()


class StateTopics:
    """Topics for joints, tendons, actuators, contacts and the timing of the control loop."""

    def __init__(self, header: RunHeader, registry: TopicRegistry) -> None:
        """Register the topics for the hand that a header describes."""
        self._header = header
        self._columns = columns_of_fields(header)
        hand = _hand_from_header(header)
        self._arms = hand.moment_arms
        self._limits = hand.joint_limits
        self._polynomials = hand.arm_polynomials if hand.has_varying_arm.any() else None
        self._last: tuple[int, int] | None = None
        self._joint_states = {}
        for topic, (axis, *field_names) in JOINT_STATE_TOPICS.items():
            template = joint_state_template(header.axis_names(axis), *map(bool, field_names))
            channel = registry.register_topic(
                topic, "sensor_msgs/JointState", note=_TOPIC_NOTES.get(topic, "")
            )
            self._joint_states[topic] = MessageStream(channel, template)
        self._pretension = spool_pair_pretensions(header)
        self._pairs = None
        if self._pretension:
            names = tuple(
                f"{name}/{tendon_of_pair}"
                for name in self._pretension
                for tendon_of_pair in ("first", "second")
            )
            channel = registry.register_topic(
                SPOOL_PAIRS_TOPIC, "sensor_msgs/JointState", note=_TOPIC_NOTES[SPOOL_PAIRS_TOPIC]
            )
            self._pairs = MessageStream(
                channel, joint_state_template(names, position=False, velocity=False, effort=True)
            )
        self._wrenches = [self._add_wrench_topic(registry, digit) for digit in header.digits]
        width = sum(
            columns_of_field.stop - columns_of_field.start
            for columns_of_field in self._columns.values()
        )
        channel = registry.register_topic(
            "/controller/values", "pal_statistics_msgs/StatisticsValues"
        )
        self._values = MessageStream(channel, statistics_values(width))
        self._cycle = MessageStream(
            registry.register_topic("/cycle", "handctl_msgs/CycleStats"),
            cycle_stats_template(len(header.motors)),
        )
        self._estimates = {}
        for topic, (field, unit) in ESTIMATE_TOPICS.items():
            channel = registry.register_topic(
                topic, "handctl_msgs/Estimate", note=_TOPIC_NOTES.get(topic, "")
            )
            self._estimates[field] = MessageStream(
                channel, estimate_template(header.axis_names(TELEMETRY_AXES[field]), unit)
            )

    def _add_wrench_topic(self, registry: TopicRegistry, digit: str) -> MessageStream:
        """Register the topic for the contact force (wrench) of a digit."""
        note = "force of the object on the digit; the tip closes towards +y of its frame"
        channel = registry.register_topic(
            f"/fingertip/{digit}/wrench", "geometry_msgs/WrenchStamped", note=note
        )
        return MessageStream(channel, wrench_template(f"{digit}_tip"))

    def blocks(self, batch: TickBatch, stamps: MessageStamps) -> list[MessageBlock]:
        """Return the messages of all ticks of a batch."""
        values_of_field = {
            name: batch.numbers[:, columns_of_field]
            for name, columns_of_field in self._columns.items()
        }
        values_of_field["tendon_torque"] = self._tendon_torque(
            values_of_field["tension"], values_of_field["q"]
        )
        blocks = [
            stream.block(stamps, self._joint_state_values(topic, values_of_field))
            for topic, stream in self._joint_states.items()
        ]
        if self._pairs is not None:
            blocks.append(
                self._pairs.block(
                    stamps, {"effort": self._pair_tensions(values_of_field["tension"])}
                )
            )
        for index, stream in enumerate(self._wrenches):
            force = np.zeros((len(batch.k), 3))
            # A closing fingertip moves in the direction +y. A grasped object pushes the closing
            # fingertip in the opposite direction. With the expression `0.0 -`, the result is never
            # -0.0.
            force[:, 1] = 0.0 - values_of_field["tip_force"][:, index]
            blocks.append(stream.block(stamps, {"force": force}))
        blocks.append(self._values.block(stamps, {"values": batch.numbers}))
        blocks.append(
            self._cycle.block(
                stamps, self._cycle_values(batch) | {"stale": values_of_field["motor_age"]}
            )
        )
        for field, stream in self._estimates.items():
            variance = values_of_field[f"{field}_sigma"] ** 2
            blocks.append(
                stream.block(stamps, {"value": values_of_field[field], "variance": variance})
            )
        return blocks

    def _tendon_torque(self, tension: FloatArray, q: FloatArray) -> FloatArray:
        """Return the joint torques R^T f (n, J) [N m] that the tensions f cause at joint angles q.

        The sum is computed in a fixed order, so that the result of a tick does not depend on n. In
        a matrix product, the order of the additions can depend on n, and a different order changes
        the rounding.
        """
        torque = np.zeros((len(tension), self._arms.shape[1]))
        arms = (
            self._arms
            if self._polynomials is None
            else moment_arms_at(self._polynomials, self._limits, q)
        )
        for tendon, joint in zip(*np.nonzero(self._arms), strict=True):
            torque[:, joint] += arms[..., tendon, joint] * tension[:, tendon]
        return torque

    def _pair_tensions(self, tension: FloatArray) -> FloatArray:
        """Return the tensions (n, 2 P) [N] of both tendons of all P spool pairs, see ``estimation.spool_pair``."""
        names = list(self._header.tendons)
        net_tension = tension[:, [names.index(name) for name in self._pretension]]
        both_tensions = np.stack([net_tension, -net_tension], axis=2)
        tensions_if_both_taut = (
            np.array(list(self._pretension.values()))[:, None] + 0.5 * both_tensions
        )
        return np.maximum(np.maximum(tensions_if_both_taut, both_tensions), 0.0).reshape(
            len(net_tension), -1
        )

    def _joint_state_values(
        self, topic: str, values_of_field: dict[str, FloatArray]
    ) -> dict[str, NDArray[np.generic]]:
        """Return the positions, velocities and efforts for the messages of a JointState topic."""
        _, *fields = JOINT_STATE_TOPICS[topic]
        return {
            part_name: values_of_field[name]
            for part_name, name in zip(("position", "velocity", "effort"), fields, strict=True)
            if name
        }

    def _cycle_values(self, batch: TickBatch) -> dict[str, NDArray[np.generic]]:
        """Return the timing of each tick [s]: period, lateness, and time between previous tick and last reply."""
        start = batch.t_ns + batch.late_ns
        first_k, first_start = self._last or (int(batch.k[0]) - 1, -1)
        previous_start = np.concatenate([[first_start], start[:-1]])
        period = np.where(previous_start < 0, np.nan, (start - previous_start) * 1e-9)
        missed_ticks = np.clip(np.diff(batch.k, prepend=first_k) - 1, 0, 2**32 - 1)
        # If no reply of a drive arrived in a tick, the time of the last reply is the smallest
        # int64. This function converts the smallest int64 to NaN.
        last_times_ns = np.full(len(start), np.iinfo(np.int64).min)
        np.maximum.at(last_times_ns, batch.received.tick_indexes, batch.received.frames["t_ns"])
        is_received = (last_times_ns > np.iinfo(np.int64).min) & (previous_start >= 0)
        last_reply = np.where(
            is_received, (np.where(is_received, last_times_ns, 0) - previous_start) * 1e-9, np.nan
        )
        self._last = int(batch.k[-1]), int(start[-1])
        numbers = np.stack([period, batch.late_ns * 1e-9, last_reply], axis=1)
        scalar_values = {"missed": missed_ticks, "mode": batch.mode, "action": batch.action}
        return {"cycle": numbers, **{name: value[:, None] for name, value in scalar_values.items()}}
