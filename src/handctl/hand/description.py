"""Description of a hand: the validated, unchangeable content of its TOML file, and quantities computed from it."""

import hashlib
import json
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, model_validator

from handctl.hand.file import quantity_types as qty
from handctl.hand.file.display_units import DisplayUnits
from handctl.hand.file.section_models import (
    CIA404_KEYS,
    DEFAULT_JOINT_NOISE_M,
    HANDCTL_NODE_KEYS,
    PRISMATIC_KEYS,
    Bus,
    Digit,
    Motor,
    Mount,
    Section,
    SensorNode,
    StreamLimits,
    Tendon,
)
from handctl.hand.file.toml_text import toml_text
from handctl.hand.moment_arms import is_moment_arm_varying, mean_moment_arm, moment_arm_polynomial

MESH_KEYS = ("link_mesh", "link_mesh_scale", "link_mesh_position_m", "link_mesh_rpy_deg")
"""Keys of a digit that describe the meshes of its links.

Keys that describe meshes have no effect on ``Hand.identity``.
"""
PALM_MESH_KEYS = ("palm_mesh", "palm_mesh_scale", "palm_mesh_position_m", "palm_mesh_rpy_deg")
"""Keys of the section ``mount`` that describe the mesh of the palm.

Keys that describe meshes have no effect on ``Hand.identity``.
"""
DIGIT_KEYS_ADDED_LATER = (
    "joint_rated_torque_N_m",
    "joint_axis",
    "joint_rpy_deg",
    "mount_on", "joint_type",
    "joint_rated_force_N", *PRISMATIC_KEYS, *MESH_KEYS,
)  # fmt: skip
"""Keys of a digit that the first versions of handctl did not have.

``Hand.content`` contains a key of this tuple only if the hand file contains the key.
"""
TENDON_KEYS_ADDED_LATER = ("pretension_N", "excursion_ratio")
"""Keys of a tendon that the first versions of handctl did not have.

``Hand.content`` contains a key of this tuple only if the hand file contains the key.
"""
CONTROL_KEYS = ("control", "kp_N_m_per_rad", "kd_N_m_s_per_rad")
"""Keys of a motor that the first versions of handctl did not have.

``Hand.content`` contains a key of this tuple only if the hand file contains the key. The keys of a
motor's position loop have no effect on ``Hand.identity``.
"""
EMPTY_SENSOR_NODE: dict[str, Any] = {
    "sync_id": 0x080, "base_id": 0x1A0, "tendons": (), "joints": (), "joint_decimation": 1,
    "tension_noise_N": 0.5, "tension_bias_drift_N": 0.0, "joint_noise_rad": 1e-3,
}  # fmt: skip
"""Sensor node of a hand without sensors.

The sensor node of a hand without sensors has no channels, so its identifiers and noise have no
effect.
"""


class Hand(Section):
    """Hand, as described by a hand file.

    Lists are in the order of the hand file. The tendons are listed digit by digit.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, validate_by_name=False)

    schema_: qty.SchemaNumber = Field(alias="schema")
    """Version of the format of the hand file."""
    name: qty.Name
    """Name of the hand. It names the files of calibration and gains."""
    description: qty.Text
    """One line about the hand."""
    mount: Mount
    """Orientation of the palm, and its mesh."""
    bus: tuple[Bus, ...] = Field(min_length=1)
    """CAN buses."""
    sensor_node: SensorNode
    """Sensor node with load cells and joint encoders.

    A hand without sensors has a node without channels, and SYNC is not sent.
    """
    stream: StreamLimits = StreamLimits()
    """Limits of targets that a client streams."""
    digit: tuple[Digit, ...] = Field(min_length=1)
    """Fingers and thumb."""
    tendon: tuple[Tendon, ...] = Field(min_length=1)
    """Tendons, digit by digit."""
    motor: tuple[Motor, ...] = Field(min_length=1)
    """Motors with their drives."""

    @model_validator(mode="before")
    @classmethod
    def _without_sensors(cls, file_content: Any) -> Any:
        """Add a sensor node without channels, if the content of a hand file has no section ``sensor_node``."""
        if not isinstance(file_content, dict) or "sensor_node" in file_content:
            return file_content
        buses = file_content.get("bus")
        if (
            not isinstance(buses, list | tuple)
            or not buses
            or not isinstance(buses[0], dict)
            or "name" not in buses[0]
        ):
            # If the hand file has no buses, pydantic reports the missing buses later. The sensor
            # node gets an arbitrary bus name, so that the missing buses are not reported twice.
            return file_content | {"sensor_node": EMPTY_SENSOR_NODE | {"bus": "main"}}
        return file_content | {"sensor_node": EMPTY_SENSOR_NODE | {"bus": buses[0]["name"]}}

    @cached_property
    def has_cell(self) -> NDArray[np.bool_]:
        """Return True for each tendon with a load cell, (N,)."""
        return np.array([name in self.sensor_node.tendons for name in self.tendon_names])

    @cached_property
    def is_pair(self) -> NDArray[np.bool_]:
        """Return True for each tendon that is a spool pair: two antagonistic tendons on one spool, (N,)."""
        return np.array([tendon.pretension_N is not None for tendon in self.tendon])

    @cached_property
    def pretension(self) -> NDArray[np.float64]:
        """Return the pretension of each tendon, (N,) [N].

        The pretension is 0 for a tendon that is not a spool pair.
        """
        return np.array([tendon.pretension_N or 0.0 for tendon in self.tendon])

    @cached_property
    def has_springs(self) -> bool:
        """Return True if every digit has springs that open the digit."""
        return all(digit.has_springs for digit in self.digit)

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Return the joint names of all digits, each digit from the palm to the tip: ``index_j1``, ``index_j2``, .."""
        return tuple(joint for digit in self.digit for joint in digit.joints)

    @cached_property
    def digit_names(self) -> tuple[str, ...]:
        """Return the digit names."""
        return tuple(digit.name for digit in self.digit)

    @cached_property
    def tendon_names(self) -> tuple[str, ...]:
        """Return the tendon names."""
        return tuple(tendon.name for tendon in self.tendon)

    @cached_property
    def motor_names(self) -> tuple[str, ...]:
        """Return the motor names."""
        return tuple(motor.name for motor in self.motor)

    @cached_property
    def bus_names(self) -> tuple[str, ...]:
        """Return the bus names."""
        return tuple(bus.name for bus in self.bus)

    @cached_property
    def prismatic_joints(self) -> frozenset[str]:
        """Return the names of the prismatic joints."""
        joint_types = zip(self.joints, self.is_prismatic.tolist(), strict=True)
        return frozenset(joint for joint, is_prismatic in joint_types if is_prismatic)

    @cached_property
    def is_prismatic(self) -> NDArray[np.bool_]:
        """Return True for each prismatic joint, (J,)."""
        return np.array(
            [
                joint_is_prismatic
                for digit in self.digit
                for joint_is_prismatic in digit.is_prismatic
            ]
        )

    @cached_property
    def display_units(self) -> DisplayUnits:
        """Return the units (J,) in which a user sees the positions of the joints."""
        return DisplayUnits.of(self.is_prismatic)

    def mean_position_units(self, digit: str) -> DisplayUnits:
        """Return the unit (1,) in which a user sees the mean position of a digit's joints.

        The unit of a digit's mean position is mm if all joints of the digit are prismatic.
        """
        return DisplayUnits.of([self.is_prismatic[self.digit_joints[digit]].all()])

    @cached_property
    def joint_noise(self) -> NDArray[np.float64]:
        """Return the standard deviation of a sample of each joint's encoder, (J,) [rad or m]."""
        prismatic_noise = self.sensor_node.joint_noise_m
        return np.where(
            self.is_prismatic,
            DEFAULT_JOINT_NOISE_M if prismatic_noise is None else prismatic_noise,
            self.sensor_node.joint_noise_rad,
        )

    @cached_property
    def moment_arms(self) -> NDArray[np.float64]:
        """Return the moment arms R of all tendons (N, J) [m], as a read-only array.

        With joint angles q, the excursion of the tendons is R q. Tensions f exert the joint torques
        R^T f.

        If a moment arm depends on the joint angle, the entry of R is the mean of the moment arm
        over the range of the joint. For a prismatic joint, the entry of the matrix R is the
        excursion of the tendon per metre of joint motion [m/m].
        """
        limits = self.joint_limits.T.tolist()
        arms = np.array([
            [mean_moment_arm(tendon.arms.get(joint, 0.0), *limits[j]) for j, joint in enumerate(self.joints)]
            for tendon in self.tendon
        ])  # fmt: skip
        arms.setflags(write=False)
        return arms

    @cached_property
    def moment_arms_of_own_digit(self) -> NDArray[np.float64]:
        """Return the moment arms of each tendon about the joints of its own digit, (N, J) [m], read-only."""
        own_moment_arms = np.zeros_like(self.moment_arms)
        for name, tendons in self.digit_tendons.items():
            joints = self.digit_joints[name]
            own_moment_arms[tendons, joints] = self.moment_arms[tendons, joints]
        own_moment_arms.setflags(write=False)
        return own_moment_arms

    @cached_property
    def moment_arms_of_carrying_digits(self) -> NDArray[np.float64]:
        """Return the moment arms of each tendon about joints of the digits that carry the tendon's digit, (N, J) [m].

        The returned array is read-only. For example, the tendons of a finger also cross the wrist.
        If the tendon of a finger does not run through the axis of the wrist, the tension of the
        tendon turns the wrist. A motion of the wrist winds or unwinds a tendon that does not run
        through the axis of the wrist.
        """
        arms = self.moment_arms - self.moment_arms_of_own_digit
        arms.setflags(write=False)
        return arms

    @cached_property
    def arm_polynomials(self) -> NDArray[np.float64]:
        """Return the moment arms as polynomials of the joint angle, in a read-only array.

        The array (N, J, quantity_types.POLYNOMIAL_COEFFICIENTS) contains the coefficients for each
        tendon at each joint.
        """
        rows = [
            [moment_arm_polynomial(tendon.arms.get(joint, 0.0)) for joint in self.joints]
            for tendon in self.tendon
        ]
        polynomials = np.array(rows)
        polynomials.setflags(write=False)
        return polynomials

    @cached_property
    def has_varying_arm(self) -> NDArray[np.bool_]:
        """Return True for each tendon with a moment arm that depends on the joint angle, (N,)."""
        return np.array(
            [
                any(map(is_moment_arm_varying, tendon.moment_arm_m.values()))
                for tendon in self.tendon
            ]
        )

    @cached_property
    def joint_limits(self) -> NDArray[np.float64]:
        """Return the smallest and the largest position of each joint (2, J) [rad or m]."""
        return np.concatenate([digit.joint_limits for digit in self.digit], axis=1)

    @cached_property
    def tendons_with_encoders(self) -> NDArray[np.bool_]:
        """Return True for each tendon if every joint that it crosses in its own digit has an encoder, (N,)."""
        has_joint_encoder = np.array([joint in self.sensor_node.joints for joint in self.joints])
        return np.asarray(
            ~((self.moment_arms_of_own_digit != 0.0) & ~has_joint_encoder).any(axis=1)
        )

    @cached_property
    def digit_joints(self) -> dict[str, slice]:
        """Return the slice of ``joints`` that contains the joints of each digit."""
        return dict(
            zip(
                self.digit_names,
                _consecutive_slices([len(digit.joints) for digit in self.digit]),
                strict=True,
            )
        )

    @cached_property
    def base_joints(self) -> dict[str, int]:
        """Return a mapping from the name of each digit to the index of the joint whose link carries the digit.

        The index is the position of the joint among all joints of the hand. If the palm carries the
        digit, the index is -1.
        """
        return {
            digit.name: -1 if digit.mount_on is None else self.digit_joints[digit.mount_on].stop - 1
            for digit in self.digit
        }

    @cached_property
    def carrier_digits(self) -> frozenset[str]:
        """Return the names of digits that carry other digits."""
        return frozenset(digit.mount_on for digit in self.digit if digit.mount_on is not None)

    def names_of_carrying_digits(self, digit: str) -> tuple[str, ...]:
        """Return the names of all digits that carry the given digit.

        The names are in order towards the palm. The first name belongs to the digit on whose last
        link the given digit is mounted.
        """
        carrier_name = self.digit_named(digit).mount_on
        # In an invalid hand file, digits can carry each other in a circle. Later checks refuse a
        # hand file with a circle.
        carriers: list[str] = []
        while carrier_name in self.digit_names and carrier_name not in carriers:
            carriers.append(carrier_name)
            carrier_name = self.digit_named(carrier_name).mount_on
        return tuple(carriers)

    def digit_of_tendon(self, tendon: Tendon) -> str | None:
        """Return the name of the digit that a tendon moves.

        The moved digit is the crossed digit that all other crossed digits carry. A tendon crosses
        each digit about whose joints the tendon has a moment arm.

        Return None if no crossed digit is carried by all other crossed digits.
        """
        crossed_digits = [
            digit.name for digit in self.digit if not tendon.arms.keys().isdisjoint(digit.joints)
        ]
        outermost_digits = [
            name
            for name in crossed_digits
            if {name, *self.names_of_carrying_digits(name)} >= set(crossed_digits)
        ]
        return outermost_digits[0] if outermost_digits else None

    def base_link(self, digit: Digit) -> str:
        """Return the name of the link that carries a digit: ``palm``, or the last link of another digit."""
        if digit.mount_on is None:
            return "palm"
        return f"{digit.mount_on}_link{len(self.digit_named(digit.mount_on).joints)}"

    @cached_property
    def digit_tendons(self) -> dict[str, slice]:
        """Return the slice of ``tendon`` that contains the tendons of each digit."""
        moved_digits = [self.digit_of_tendon(tendon) for tendon in self.tendon]
        counts = [moved_digits.count(digit.name) for digit in self.digit]
        return dict(zip(self.digit_names, _consecutive_slices(counts), strict=True))

    @cached_property
    def motor_index(self) -> tuple[int, ...]:
        """Return the index of each tendon's motor in the list ``motor``."""
        return tuple(self.motor_names.index(tendon.motor) for tendon in self.tendon)

    def motor_of_tendon(self, tendon: str) -> Motor:
        """Return the motor of a tendon, by the tendon's name."""
        return self.motor[self.motor_index[self.tendon_names.index(tendon)]]

    def digit_named(self, name: str) -> Digit:
        """Return the digit with the given name."""
        return self.digit[self.digit_names.index(name)]

    @cached_property
    def content(self) -> dict[str, Any]:
        """Return the content of the hand file, with default values for missing keys.

        The names in the returned dictionary are the keys of the hand file. The values are built-in
        Python types, such as numbers, texts, lists and dicts.
        """
        content = self.model_dump(by_alias=True, mode="python")
        keys_added_later = {
            "digit": DIGIT_KEYS_ADDED_LATER,
            "tendon": TENDON_KEYS_ADDED_LATER,
            "motor": CONTROL_KEYS,
        }
        for kind, keys in keys_added_later.items():
            for section in content[kind]:
                for key in keys:
                    # The identity of a hand file that does not contain the key must not change.
                    if section[key] is None or section[key] in ((), {}):
                        del section[key]
        if content["sensor_node"]["joint_noise_m"] is None:
            del content["sensor_node"]["joint_noise_m"]
        content["mount"] = {
            key: value for key, value in content["mount"].items() if value is not None
        }
        # The content of a sensor node contains only the keys of the node's protocol, so that the
        # identity of a hand file without a sensor protocol does not change.
        for key in HANDCTL_NODE_KEYS if self.sensor_node.is_cia404 else ("protocol", *CIA404_KEYS):
            del content["sensor_node"][key]
        return content

    def to_toml(self) -> str:
        """Return the content of the hand file as TOML text, for the log of a run.

        ``load_hand`` reads an equal hand from the returned text.
        """
        return toml_text(self.content)

    @cached_property
    def identity(self) -> str:
        """Return the SHA-256 hash, in hexadecimal, of the content on which calibrations and gains depend.

        Comments, the spelling of numbers, and the order of keys in the file have no effect on the
        hash. The hash leaves out the limits of streams, the meshes, and the keys of a drive's
        position loop. Calibrations and gains do not depend on the keys that are missing in the
        hash.
        """
        content = {key: value for key, value in self.content.items() if key != "stream"}
        content["digit"] = [_table_without_keys(digit, MESH_KEYS) for digit in content["digit"]]
        content["motor"] = [_table_without_keys(motor, CONTROL_KEYS) for motor in content["motor"]]
        content["mount"] = _table_without_keys(content["mount"], PALM_MESH_KEYS)
        # With sorted keys and fixed separators, hand files with equal content have equal JSON text.
        canonical_json = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical_json.encode()).hexdigest()


def _table_without_keys(table_content: dict[str, Any], keys: tuple[str, ...]) -> dict[str, Any]:
    """Return a copy of a table without the given keys."""
    return {key: value for key, value in table_content.items() if key not in keys}


def _consecutive_slices(lengths: list[int]) -> list[slice]:
    """Return consecutive slices of the given lengths."""
    return [
        slice(end - count, end) for count, end in zip(lengths, accumulate(lengths), strict=True)
    ]
