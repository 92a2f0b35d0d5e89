"""Checks of the section ``sensor_node`` in a hand file.

The checks cover the keys of the sensor protocol, the sensor channels and the measuring range.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from handctl.hand.file.error_text import FileMistake, first_sentence, valid_value_text
from handctl.hand.file.key_descriptions import key_description
from handctl.hand.file.section_models import (
    CIA404_KEYS,
    CIA404_PROTOCOL,
    HANDCTL_NODE_KEYS,
    HANDCTL_PROTOCOL,
    SensorNode,
)

if TYPE_CHECKING:
    from handctl.hand.description import Hand

CANOPEN_SYNC = 0x080
"""CAN identifier of SYNC in CANopen. Source: CiA 301."""
AMPLIFIER_FRAME_IDS = (0x080, 0x580, 0x600, 0x700)
"""Identifiers of the frames of an amplifier: emergency, SDO in both directions, and heartbeat.

The identifier of a frame is a number of ``AMPLIFIER_FRAME_IDS`` plus the node number of the
amplifier.

Source: CiA 301.
"""
MAX_TARE_N = 6.0
"""Largest accepted tare of a load cell [N]. The tare reduces the usable range of the load cell."""
MAX_COUNT = (1 << 31) - 1
"""Largest value of the CANopen type INTEGER32."""

MIN_TENSION_NOISE_N = 1e-3
"""Smallest standard deviation of a load-cell sample with which the tension filter can be designed [N]."""


def check_sensor_node(hand: Hand) -> Iterator[FileMistake]:
    """Yield the mistakes of the section ``sensor_node`` that appear only when several keys are compared."""
    node = hand.sensor_node
    foreign_keys, protocol = (
        (HANDCTL_NODE_KEYS, HANDCTL_PROTOCOL) if node.is_cia404 else (CIA404_KEYS, CIA404_PROTOCOL)
    )
    for key in foreign_keys:
        value = getattr(node, key)
        if key in node.model_fields_set and value != ():
            expected = f'no such key, it belongs to protocol = "{protocol}"'
            yield FileMistake("given", f"sensor_node.{key}", expected)
    if node.tendons and node.tension_noise_N < MIN_TENSION_NOISE_N:
        expected = f"at least {MIN_TENSION_NOISE_N:g} N: the tension filter needs the noise of the load cells"
        yield FileMistake(f"{node.tension_noise_N:g}", "sensor_node.tension_noise_N", expected)
    if node.is_cia404:
        yield from _check_amplifiers(node)
        yield from _check_range(hand)
        return
    has_hinge_encoder = any(
        joint in node.joints and not is_prismatic
        for joint, is_prismatic in zip(hand.joints, hand.is_prismatic, strict=True)
    )
    content = node.model_dump(include=node.model_fields_set)
    yield from missing_node_keys(content, needs_angle_noise=has_hinge_encoder)


def missing_node_keys(
    content: object, needs_angle_noise: bool | None = None
) -> Iterator[FileMistake]:
    """Yield a mistake for each required key that the section of a handctl sensor node lacks.

    The keys of the joint encoders are required only if the node has joint encoders.

    Args:
        content: content of the section. Other values than a table have no missing keys.
        needs_angle_noise: True if the section needs the key ``joint_noise_rad``, because a hinge has
            an encoder. If it is None, the section needs the key unless it has ``joint_noise_m``, the
            key for prismatic joints.
    """
    if not isinstance(content, Mapping) or content.get("protocol") == CIA404_PROTOCOL:
        return
    required_keys = ["sync_id", "base_id"]
    if content.get("joints"):
        required_keys.append("joint_decimation")
        if needs_angle_noise is None:
            needs_angle_noise = "joint_noise_m" not in content
        if needs_angle_noise:
            required_keys.append("joint_noise_rad")
    for key in required_keys:
        if key not in content:
            field = SensorNode.model_fields[key]
            value_text = valid_value_text(field.annotation, field.metadata)
            meaning = first_sentence(key_description(SensorNode, key))
            yield FileMistake("missing", f"sensor_node.{key}", f"{value_text}: {meaning}")


def _check_amplifiers(node: SensorNode) -> Iterator[FileMistake]:
    """Check the SYNC identifier and the node numbers of the amplifiers.

    The function also checks that the amplifiers have a channel for each load cell.
    """
    if node.sync_id != CANOPEN_SYNC:
        yield FileMistake(
            f"0x{node.sync_id:X}",
            "sensor_node.sync_id",
            f"0x{CANOPEN_SYNC:03X}, the SYNC of CANopen",
        )
    location = "sensor_node.node_ids"
    duplicate_node_numbers = sorted(
        {number for number in node.node_ids if node.node_ids.count(number) > 1}
    )
    if duplicate_node_numbers:
        yield FileMistake(
            f"0x{duplicate_node_numbers[0]:X} twice", location, "every node number once"
        )
    cells, channel_count = len(node.tendons), len(node.node_ids) * node.channels_per_node
    if cells > channel_count:
        problem_text = f"{len(node.node_ids)} amplifiers of {node.channels_per_node} channels for {cells} load cells"
        yield FileMistake(
            problem_text, location, f"room for {cells} load cells, or another channels_per_node"
        )
    elif 0 in node.amplifier_channels:
        unused_node_id = node.node_ids[node.amplifier_channels.index(0)]
        yield FileMistake(
            f"0x{unused_node_id:X} has no load cell",
            location,
            "only amplifiers with a load cell of tendons",
        )


def _check_range(hand: Hand) -> Iterator[FileMistake]:
    """Check that the measuring range of the load cells includes the largest tension.

    The function also checks that a 32-bit process value of the amplifier can represent the
    measuring range.
    """
    node, location = hand.sensor_node, "sensor_node.range_N"
    if node.range_N is None:
        yield FileMistake("missing", location, "a value: rated load of the load cells [N]")
        return
    measured_tendons = [tendon for tendon in hand.tendon if tendon.name in node.tendons]
    strongest_tendon = max(measured_tendons, key=lambda tendon: tendon.drive_limit_N, default=None)
    if strongest_tendon is not None and node.range_N < strongest_tendon.drive_limit_N + MAX_TARE_N:
        required_range = strongest_tendon.drive_limit_N + MAX_TARE_N
        expected = (
            f"at least {required_range:g} N: drive_limit_N of {strongest_tendon.name}, "
            f"and {MAX_TARE_N:g} N for the tare"
        )
        yield FileMistake(f"{node.range_N:g}", location, expected)
    if node.process_value == "int32" and node.range_N * 10**node.decimal_digits > MAX_COUNT:
        problem_text = f"{node.range_N:g} N has more than 32 bits with {node.decimal_digits} digits"
        yield FileMistake(problem_text, "sensor_node.decimal_digits", "fewer digits")


def amplifier_identifiers(node: SensorNode) -> Iterator[tuple[int, str]]:
    """Yield (identifier, key path) for the CAN frames of CiA 404 amplifiers."""
    if not node.is_cia404:
        return
    for identifier in node.tension_ids:
        yield identifier, "sensor_node.node_ids"
    for number in node.node_ids:
        for service_base_id in AMPLIFIER_FRAME_IDS:
            yield service_base_id + number, "sensor_node.node_ids"
