"""Test how the simulator reads a hand file, and how it changes parameters of the simulated hand at random.

The tests also check that the bytes of a simulated frame equal those of the Linux structure
`canfd_frame`.
"""

import struct
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim.bus.frame import (
    BRS,
    ESI,
    EXTENDED_FLAG,
    FDF,
    RECORD_SIZE,
    Frame,
    pack_record,
    unpack_record,
)
from firmware_sim.description.hand_description import SimulatorError, load_hand
from firmware_sim.lockstep_hand import LockstepHand
from firmware_sim.plant.plant_perturbation import PERTURBATION_KEYS, perturbed_hand
from handctl.hand.hand_loading import load_hand as described


def write_edited_hand(tmp_path: Path, original_text: str, replacement_text: str) -> str:
    """Copy the hand file of jamia, replace the first occurrence of a text, and return the path of the copy."""
    text = described("jamia").to_toml()
    assert original_text in text
    path = tmp_path / "edited.toml"
    path.write_text(text.replace(original_text, replacement_text, 1))
    return str(path)


@pytest.mark.parametrize("hand_name", ["jamia", "jamia11"])
def test_every_number_comes_from_the_file(hand_name: str) -> None:
    raw = tomllib.loads(described(hand_name).to_toml())
    hand = load_hand(hand_name)
    assert [tendon.arms for tendon in hand.tendons] == [
        tendon["moment_arm_m"] for tendon in raw["tendon"]
    ]
    for tendon, entry in zip(hand.tendons, raw["tendon"], strict=True):
        assert (tendon.stiffness, tendon.friction) == (
            entry["stiffness_N_per_m"],
            entry["friction_coefficient"],
        )
        assert (tendon.damping, tendon.wrap) == (
            entry["damping_N_s_per_m"],
            entry["wrap_angle_rad"],
        )
    for motor, entry in zip(hand.motors, raw["motor"], strict=True):
        assert (motor.node_id, motor.spool_radius) == (entry["node_id"], entry["spool_radius_m"])
        assert (motor.torque_max, motor.torque_peak) == (
            entry["torque_max_N_m"],
            entry["torque_peak_N_m"],
        )
    for digit, entry in zip(hand.digits, raw["digit"], strict=True):
        assert list(digit.mass) == entry["link_mass_kg"]
        assert list(digit.spring) == entry["spring_stiffness_N_m_per_rad"]
    assert hand.sensors is not None
    assert hand.sensors.base_id == raw["sensor_node"]["base_id"]


@pytest.mark.parametrize(
    ("original_text", "replacement_text", "expected_message"),
    [
        ("spool_radius_m = 0.005", "", "spool_radius_m"),
        ("[[motor]]", "[[motor", "not TOML"),
        ("index_j1 = 0.003", "index_j9 = 0.003", "index_j9"),
        ('motor = "index_motor"', 'motor = "lost_motor"', "lost_motor"),
        ('protocol = "mit"', 'protocol = "morse"', "morse"),
        ('bus = "main"', 'bus = "side"', "side"),
    ],
)
def test_incomplete_hands_are_refused_in_one_line(
    original_text: str, replacement_text: str, expected_message: str, tmp_path: Path
) -> None:
    with pytest.raises(SimulatorError, match=expected_message) as caught:
        LockstepHand(write_edited_hand(tmp_path, original_text, replacement_text))
    assert "\n" not in str(caught.value)


def test_motors_on_two_buses(tmp_path: Path) -> None:
    """In the hand of this test, the first motor is on the second bus.

    The motor on the second bus replies on the second bus, and ignores frames on the first bus.
    """
    first_file = write_edited_hand(
        tmp_path, "[sensor_node]", '[[bus]]\nname = "side"\nbitrate = 1000000\n\n[sensor_node]'
    )
    text = Path(first_file).read_text()
    head, _, tail = text.partition('name = "index_motor"')
    Path(first_file).write_text(
        head + 'name = "index_motor"' + tail.replace('bus = "main"', 'bus = "side"', 1)
    )
    rig = LockstepHand(first_file)
    zero = bytes.fromhex("7fff7ff0000007ff")
    answers = rig.step(0, [(1, zero, 0, 0, 0), (1, zero, 0, 1, 0), (2, zero, 0, 0, 0)])
    assert [(answer.can_id, answer.bus) for answer in answers] == [(0x11, 1), (0x12, 0)]


def changed_fields(first_object: Any, second_object: Any) -> set[str]:
    """Return the names of those fields that differ between two objects."""
    return {
        field.name
        for field in fields(first_object)
        if getattr(first_object, field.name) != getattr(second_object, field.name)
    }


@pytest.mark.parametrize(
    ("factor_name", "digit_fields", "tendon_fields", "motor_fields", "sensor_fields"),
    [
        ("stiffness", set(), {"stiffness"}, set(), set()),
        ("damping", {"damping"}, {"damping"}, {"viscous"}, set()),
        ("friction", set(), {"friction"}, {"coulomb"}, set()),
        ("mass", {"mass", "inertia"}, set(), set(), set()),
        ("spring", {"spring"}, set(), set(), set()),
        ("moment_arm", set(), {"arms"}, set(), set()),
        ("motor_inertia", set(), set(), {"inertia"}, set()),
        ("torque_constant", set(), set(), {"torque_gain"}, set()),
        ("bias", set(), set(), set(), {"tension_bias"}),
        ("noise", set(), set(), set(), {"tension_noise", "joint_noise", "travel_noise"}),
    ],
)
def test_each_factor_changes_only_its_parameters(
    factor_name: str,
    digit_fields: set[str],
    tendon_fields: set[str],
    motor_fields: set[str],
    sensor_fields: set[str],
) -> None:
    hand = load_hand("jamia11")
    other_perturbed_hand = perturbed_hand(hand, {factor_name: 1.2})
    assert changed_fields(hand.digits[0], other_perturbed_hand.digits[0]) == digit_fields
    assert changed_fields(hand.tendons[0], other_perturbed_hand.tendons[0]) == tendon_fields
    assert changed_fields(hand.motors[0], other_perturbed_hand.motors[0]) == motor_fields
    assert changed_fields(hand.sensors, other_perturbed_hand.sensors) == sensor_fields


def test_every_perturbation_key_is_tested() -> None:
    (mark,) = test_each_factor_changes_only_its_parameters.pytestmark  # type: ignore[attr-defined]
    assert {row[0] for row in mark.args[1]} == set(PERTURBATION_KEYS)


def test_no_factors_no_change() -> None:
    assert perturbed_hand(load_hand("jamia"), {}) == load_hand("jamia")


@given(
    st.integers(0, (1 << 29) - 1),
    st.binary(max_size=64),
    st.sampled_from([0, EXTENDED_FLAG]),
    st.sampled_from([FDF, FDF | BRS, FDF | BRS | ESI]),
)
def test_a_record_is_a_canfd_frame(
    can_id: int, data: bytes, extended_flag: int, flags: int
) -> None:
    frame = Frame(can_id | extended_flag, data, flags if len(data) > 8 else 0)
    record = pack_record(frame)
    assert len(record) == RECORD_SIZE == 72
    assert struct.unpack_from("<I", record)[0] == frame.can_id
    assert (record[4], record[5]) == (len(data), frame.flags)
    assert record[8 : 8 + len(data)] == data
    assert unpack_record(record) == frame


@pytest.mark.parametrize(("length", "flags"), [(9, 0), (65, FDF)])
def test_a_record_of_an_impossible_length_is_no_frame(length: int, flags: int) -> None:
    record = struct.pack("<IBBBB64s", 1, length, flags, 0, 0, b"")
    assert unpack_record(record) is None
