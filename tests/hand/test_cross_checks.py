"""Test the checks of a hand file: units, references, lengths of lists, limits, identifiers and tendon routes."""

import copy
import math
import re

import numpy as np
import pytest

from handctl.errors import ConfigError
from handctl.hand.hand_loading import hand_content, hand_from_content, inspect_hand_content
from tests.hand.hand_on_wrist import mount_on_wrist

JAMIA_HAND_CONTENT = hand_content("jamia")


@pytest.fixture
def refusal_of_edit(refusal_of_content):
    """Return a function that makes a wrong change in the hand file of jamia, and returns the error message."""

    def refusal_line(content_edit):
        content = copy.deepcopy(JAMIA_HAND_CONTENT)
        content_edit(content)
        return refusal_of_content(content).removeprefix("my/hand.toml: ")

    return refusal_line


def section_edit(section_name, section_index, **field_values):
    """Return an edit function that sets values in one section of a hand's content."""
    return lambda content: (
        content[section_name] if section_index is None else content[section_name][section_index]
    ).update(field_values)


WRONG_UNIT_CASES = [
    (
        "digit",
        {"link_length_m": [30, 15, 10]},
        "digit[index].link_length_m[0]: 30; expected 0 or a number from 0.001 to 0.2 m",
    ),
    ("digit", {"link_mass_kg": [6.384, 3.192, 2.128]}, "digit[index].link_mass_kg[0]: 6.384; "),
    ("digit", {"link_radius_m": 4}, "digit[index].link_radius_m: 4; "),
    (
        "tendon",
        {"moment_arm_m": {"index_j1": 3}},
        "tendon[index_tendon].moment_arm_m.index_j1: 3; ",
    ),
    ("tendon", {"knee_width_m": 0.3}, "tendon[index_tendon].knee_width_m: 0.3; "),
    ("tendon", {"wrap_angle_rad": 90}, "tendon[index_tendon].wrap_angle_rad: 90; "),
    ("motor", {"spool_radius_m": 5}, "motor[index_motor].spool_radius_m: 5; "),
    ("motor", {"torque_max_N_m": 800}, "motor[index_motor].torque_max_N_m: 800; "),
]


@pytest.mark.parametrize(("section_name", "field_values", "expected_start"), WRONG_UNIT_CASES)
def test_the_message_about_a_wrong_unit_suggests_a_unit(
    refusal_of_edit, section_name, field_values, expected_start
):
    line = refusal_of_edit(section_edit(section_name, 0, **field_values))
    assert line.startswith(expected_start)
    assert re.search(r"\(in .*\?\)$", line)


def test_entries_that_are_refused_cause_no_further_message():
    """Reproduce a defect: two wrong values in a list caused three error messages.

    The third message, which demanded a list with at least 1 value, was superfluous.
    """
    content = copy.deepcopy(JAMIA_HAND_CONTENT)
    content["digit"][0]["link_length_m"] = [50, 40]
    lines = [str(mistake.error("x")) for mistake in inspect_hand_content(content).mistakes]
    assert len(lines) == 2
    assert all("expected 0 or a number from 0.001 to 0.2 m" in line for line in lines)


def tendon_edit(**tendon_fields):
    return section_edit("tendon", 0, **tendon_fields)


CONTRADICTION_CASES = {
    "tension limit above the wire's strength": (
        tendon_edit(tension_max_N=700.0, tension_trip_N=800.0),
        "tendon[index_tendon].tension_max_N: 700, and the tendon breaks at 620 N; expected "
        "more than tension_floor_N = 3 N and at most rated_breaking_force_N = 620 N",
    ),
    "tension limit above the wire's strength and the trip": (
        tendon_edit(tension_max_N=700.0),
        "tendon[index_tendon].tension_max_N: 700, and the tendon breaks at 620 N; expected "
        "more than tension_floor_N = 3 N and less than tension_trip_N = 140 N",
    ),
    "drive limit above the wire's strength": (
        tendon_edit(drive_limit_N=650.0),
        "tendon[index_tendon].drive_limit_N: 650, and the tendon breaks at 620 N; expected "
        "more than tension_trip_N = 140 N and at most rated_breaking_force_N = 620 N",
    ),
    "trip above drive limit": (
        tendon_edit(tension_trip_N=160.0),
        "tendon[index_tendon].tension_trip_N: 160; expected more than tension_max_N = 110 N and "
        "less than drive_limit_N = 160 N",
    ),
    "floor above maximum": (
        tendon_edit(tension_floor_N=120.0),
        "tendon[index_tendon].tension_floor_N: 120; expected less than tension_max_N = 110 N",
    ),
    "drive torque is not the drive limit": (
        section_edit("motor", 0, torque_max_N_m=1.0),
        "motor[index_motor].torque_max_N_m: 1; expected drive_limit_N x spool_radius_m = 0.8 N m",
    ),
    "drive torque beyond the motor": (
        section_edit("motor", 0, torque_peak_N_m=0.7),
        "motor[index_motor].torque_max_N_m: 0.8; expected at most torque_peak_N_m = 0.7 N m",
    ),
    "stiffness of a position loop without the loop": (
        section_edit("motor", 0, kp_N_m_per_rad=1.0),
        'motor[index_motor].kp_N_m_per_rad: 1; expected no such key without control = "position"',
    ),
    "position loop stiffer than the tendon": (
        section_edit("motor", 0, control="position", kp_N_m_per_rad=3.0),
        "motor[index_motor].kp_N_m_per_rad: 3; expected at most stiffness_N_per_m x spool_radius_m^2 = 2.5 N m/rad",
    ),
    "unknown control": (
        section_edit("motor", 0, control="velocity"),
        'motor[index_motor].control: "velocity"; expected "torque" or "position"',
    ),
    "same node id": (
        section_edit("motor", 1, node_id=1),
        'motor[middle_motor].node_id: 0x1 on bus "main" is taken; expected an identifier that is not in use; '
        "motor[index_motor].node_id has it",
    ),
    "node id is another's reply": (
        section_edit("motor", 1, node_id=0x11),
        'motor[middle_motor].node_id: 0x11 on bus "main"',
    ),
    "reply id is another's node id": (
        section_edit("motor", 3, options={"reply_id": 2}),
        'motor[thumb_motor].options.reply_id: 0x2 on bus "main" is taken',
    ),
    "reply id is its own node id": (
        section_edit("motor", 3, options={"reply_id": 4}),
        "motor[thumb_motor].options.reply_id: 0x4",
    ),
    "reply id is no number": (
        section_edit("motor", 3, options={"reply_id": "4"}),
        "motor[thumb_motor].options.reply_id: 4; expected a whole number from 1 to 2047",
    ),
    "reply id is too small": (
        section_edit("motor", 3, options={"reply_id": 0}),
        "motor[thumb_motor].options.reply_id: 0; expected",
    ),
    "reply id is just large enough": (
        section_edit("motor", 3, options={"reply_id": 1}),
        'motor[thumb_motor].options.reply_id: 0x1 on bus "main" is taken',
    ),
    "reply id is just small enough": (
        section_edit("motor", 3, options={"reply_id": 0x7FF}),
        'motor[thumb_motor].options.reply_id: 0x7FF on bus "main" is taken',
    ),
    "reply id is too large": (
        section_edit("motor", 3, options={"reply_id": 0x800}),
        "motor[thumb_motor].options.reply_id: 2048; expected a whole number",
    ),
    "sensor frames on a drive's reply": (
        section_edit("sensor_node", None, base_id=0x12),
        "motor[middle_motor].node_id: 0x12",
    ),
    "sensor frames on the sync": (
        section_edit("sensor_node", None, base_id=0x80),
        "sensor_node.base_id: 0x80",
    ),
    "sync on the drives' register frames": (
        section_edit("sensor_node", None, sync_id=0x7FF),
        "sensor_node.sync_id: 0x7FF",
    ),
    "two nodes of another protocol": (
        lambda c: [c["motor"][i].update(protocol="odrive", node_id=9) for i in (0, 1)],
        'motor[middle_motor].node_id: 0x120 on bus "main" is taken',
    ),
    "too few values": (
        section_edit("digit", 0, link_com_m=[0.015, 0.0075]),
        "digit[index].link_com_m: 2 values; expected 3",
    ),
    "centre of mass beyond the link": (
        section_edit("digit", 0, link_com_m=[0.015, 0.0075, 0.02]),
        "digit[index].link_com_m[2]: 0.02",
    ),
    "inertia beyond the link's mass": (
        section_edit("digit", 0, link_inertia_kg_m2=[5e-4, 7e-8, 2e-8]),
        "digit[index].link_inertia_kg_m2[0]: 0.0005",
    ),
    "joint limits the wrong way round": (
        section_edit("digit", 3, joint_min_deg=[0.0, 100.0]),
        "digit[thumb].joint_max_deg[1]: 100; expected more than joint_min_deg[1] = 100",
    ),
    "nine links": (
        section_edit("digit", 0, link_length_m=[0.01] * 9),
        "digit[index].link_length_m: [0.01, 0.01, 0.01, 0.01, 0.01, 0.01, 0.01, 0.01, 0.01]; expected at most 8 values",
    ),
    "a last link without length": (
        section_edit("digit", 0, link_length_m=[0.03, 0.015, 0.0], link_com_m=[0.015, 0.0075, 0.0]),
        "digit[index].link_length_m[2]: 0; expected more than 0",
    ),
    "an axis for every joint": (
        section_edit("digit", 0, joint_axis=[[0.0, 0.0, 1.0]]),
        "digit[index].joint_axis: 1 values; expected 3, one per link_length_m",
    ),
    "an axis of wrong length": (
        section_edit("digit", 0, joint_axis=[[0.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]),
        "digit[index].joint_axis[1]: a vector of length 1.41; expected a unit vector, of length 1",
    ),
    "an axis of two numbers": (
        section_edit("digit", 0, joint_axis=[[0.0, 1.0]] * 3),
        "digit[index].joint_axis[0][2]: missing; expected a value",
    ),
    "an orientation for every joint": (
        section_edit("digit", 0, joint_rpy_deg=[[0.0, 0.0, 90.0]] * 2),
        "digit[index].joint_rpy_deg: 2 values; expected 3",
    ),
    "centre of mass of two numbers": (
        section_edit("digit", 0, link_com_m=[[0.015, 0.0], 0.0075, 0.005]),
        "digit[index].link_com_m[0]: [0.015, 0.0]; expected a number, or a list of 3 numbers",
    ),
    "centre of mass far from the link": (
        section_edit("digit", 0, link_com_m=[0.015, [0.0, 0.02, 0.0], 0.005]),
        "digit[index].link_com_m[1]: 0.02 m; expected at most 0.015 m from the joint",
    ),
    "mounted on nothing": (
        section_edit("digit", 1, mount_on="wrist"),
        'digit[middle].mount_on: "wrist" is not in this file',
    ),
    "mounted on itself": (
        section_edit("digit", 1, mount_on="middle"),
        "digit[middle].mount_on: middle does not follow middle",
    ),
    "mounted on a later digit": (
        section_edit("digit", 0, mount_on="middle"),
        "digit[index].mount_on: index does not follow middle; expected each digit right after the one that carries it",
    ),
    "mounted on a digit before others": (
        lambda c: (c["digit"][1].update(mount_on="index"), c["digit"][3].update(mount_on="middle")),
        "digit[thumb].mount_on: thumb does not follow middle",
    ),
    "inertia of two numbers": (
        section_edit("digit", 0, link_inertia_kg_m2=[[5e-7, 5e-7], 7e-8, 2e-8]),
        "digit[index].link_inertia_kg_m2[0]: [5e-07, 5e-07]; expected a number, or a list of 3 or 6 numbers",
    ),
    "inertia that is not positive definite": (
        section_edit(
            "digit", 0, link_inertia_kg_m2=[[5e-7, 5e-7, 5e-7, 6e-7, 0.0, 0.0], 7e-8, 2e-8]
        ),
        "digit[index].link_inertia_kg_m2[0]: a principal moment of -1e-07 kg m2; expected a positive definite inertia",
    ),
    "inertia of no real body": (
        section_edit("digit", 0, link_inertia_kg_m2=[[1e-7, 2e-7, 5e-7], 7e-8, 2e-8]),
        "digit[index].link_inertia_kg_m2[0]: principal moments 1e-07, 2e-07, 5e-07; "
        "expected none larger than the sum of the other two",
    ),
    "coupling of the wrong shape": (
        section_edit("digit", 0, coupling=[[1.0], [1.0]]),
        "digit[index].coupling: 2 rows; expected 3",
    ),
    "ragged coupling": (
        section_edit("digit", 0, coupling=[[1.0], [1.0, 0.0], [1.0]]),
        "digit[index].coupling: rows of [1, 2]",
    ),
    "coupling that the tendon cannot move": (
        section_edit("digit", 0, coupling=[[1.0], [-1.0], [0.0]]),
        "digit[index].coupling: its tendons (moment_arm_m) can move only 0 of 1 coordinates; "
        "expected a tendon for every coordinate, or a coupling that leaves 1",
    ),
    "more coordinates than tendons": (
        section_edit("digit", 0, coupling=[[1.0, 0.0], [0.0, 1.0], [0.0, 1.0]]),
        "digit[index].coupling: its tendons (moment_arm_m) can move only 1 of 2 coordinates",
    ),
    "unknown motor": (
        tendon_edit(motor="index_moter"),
        'tendon[index_tendon].motor: "index_moter" is not in this file',
    ),
    "unknown joint": (
        tendon_edit(moment_arm_m={"index_j4": 0.003}),
        "tendon[index_tendon].moment_arm_m.index_j4: ",
    ),
    "unknown bus": (
        section_edit("motor", 0, bus="can0"),
        'motor[index_motor].bus: "can0" is not in this file; expected one of main',
    ),
    "unknown sensor bus": (
        section_edit("sensor_node", None, bus="x"),
        'sensor_node.bus: "x" is not in this file',
    ),
    "unknown load cell": (
        section_edit("sensor_node", None, tendons=["x"]),
        'sensor_node.tendons[0]: "x" is not in this file',
    ),
    "unknown joint encoder": (
        section_edit("sensor_node", None, joints=["index_j1", "x"]),
        'sensor_node.joints[1]: "x" is not in this file; expected one of index_j1, index_j2, index_j3, middle_j1, ',
    ),
    "joint encoder twice": (
        section_edit("sensor_node", None, joints=["index_j1"] * 2),
        'sensor_node.joints: "index_j1" twice',
    ),
    "two CANopen nodes with one number": (
        lambda c: [c["motor"][i].update(protocol="cia402", node_id=9) for i in (0, 1)],
        'motor[middle_motor].node_id: 0x89 on bus "main" is taken; expected an identifier that is not in use; '
        "motor[index_motor].node_id has it",
    ),
    "two nodes of a protocol of one's own": (
        lambda c: [c["motor"][i].update(protocol="cubemars", node_id=9) for i in (0, 1)],
        'motor[middle_motor].node_id: cubemars node 9 on bus "main" is taken',
    ),
    "load cell twice": (
        section_edit("sensor_node", None, tendons=["index_tendon"] * 2),
        'sensor_node.tendons: "index_tendon" twice',
    ),
    "motor shared": (
        section_edit("tendon", 1, motor="index_motor"),
        'tendon[middle_tendon].motor: "index_motor" drives index_tendon already; expected a motor of its own',
    ),
    "motor without tendon": (
        lambda c: c["motor"].append({**c["motor"][0], "name": "spare", "node_id": 9}),
        "motor[spare].name: drives no tendon; expected to be the motor of one tendon",
    ),
    "tendon of two digits": (
        tendon_edit(moment_arm_m={"index_j1": 0.003, "ring_j1": 0.003}),
        "tendon[index_tendon].moment_arm_m: moves index and ring; expected joints of one digit, ",
    ),
    "tendon of no digit": (
        tendon_edit(moment_arm_m={}),
        "tendon[index_tendon].moment_arm_m: moves no digit",
    ),
    "moment arm as a polynomial": (
        tendon_edit(moment_arm_m={"index_j1": [0.003, 1e-4]}),
        "tendon[index_tendon].moment_arm_m.index_j1: [0.003, 0.0001]; expected a number from -0.05 to 0.05 m, "
        "{ polynomial_m = [r0, r1, ..] } of the joint angle in rad, or { angle_deg = [..], arm_m = [..] }",
    ),
    "tendon without lever": (
        tendon_edit(moment_arm_m={"index_j1": 0.003, "index_j2": 0.0}),
        "tendon[index_tendon].moment_arm_m.index_j2: 0; expected 0.0001 to 0.05 m either way, or no such key",
    ),
    "joint that no tendon crosses": (
        tendon_edit(moment_arm_m={"index_j1": 0.003, "index_j2": 0.003}),
        "digit[index]: no tendon crosses index_j3; expected a tendon with moment_arm_m.index_j3",
    ),
    "tendons out of order": (
        lambda c: c["tendon"].reverse(),
        "tendon[ring_tendon].moment_arm_m: a tendon of ring after one of thumb; "
        "expected tendons digit by digit, in the order of the digits",
    ),
    "digit twice": (
        section_edit("digit", 1, name="index"),
        'digit[index].name: "index" twice; expected every name once',
    ),
    "no digit": (lambda c: c.update(digit=[]), "digit: []; expected at least 1 values"),
    "a name with a blank": (
        section_edit("digit", 0, name="index finger"),
        "digit[index finger].name: ",
    ),
    "direction": (
        section_edit("motor", 0, direction=0),
        "motor[index_motor].direction: 0; expected 1 or -1",
    ),
    "schema of tomorrow": (lambda c: c.update(schema=3, novelty=1), "schema: 3; expected 1 or 2"),
    "negative mass": (
        section_edit("digit", 0, link_mass_kg=[-6.384e-3, 3.192e-3, 2.128e-3]),
        "digit[index].link_mass_kg[0]: -0.006384; expected a number from 1e-05 to 0.5 kg",
    ),
    "NaN in options": (
        section_edit("motor", 0, options={"x": math.nan}),
        "motor[index_motor].options: ",
    ),
    "list in options": (
        section_edit("motor", 0, options={"x": [1]}),
        "motor[index_motor].options: ",
    ),
}


@pytest.mark.parametrize(
    ("content_edit", "expected_start"),
    CONTRADICTION_CASES.values(),
    ids=CONTRADICTION_CASES.keys(),
)
def test_contradicting_keys_are_refused(refusal_of_edit, content_edit, expected_start):
    assert refusal_of_edit(content_edit).startswith(expected_start)


def test_a_coupling_has_as_many_coordinates_as_joints_at_most():
    content = hand_content("jamia11")
    content["digit"][0]["coupling"] = np.eye(3).tolist()
    assert hand_from_content(content, "own.toml").digit[0].coupling == (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    content["digit"][0]["coupling"] = np.eye(3, 4).tolist()
    with pytest.raises(
        ConfigError, match=r"coupling: rows of \[4\] values; expected rows of equal length, 1 to 3"
    ):
        hand_from_content(content, "own.toml")


def test_value_at_its_limit_is_accepted():
    content = copy.deepcopy(JAMIA_HAND_CONTENT)
    digit, tendon = content["digit"][0], content["tendon"][0]
    mass, length = digit["link_mass_kg"][0], digit["link_length_m"][0]
    digit["link_com_m"][0], digit["link_inertia_kg_m2"][0] = length, mass * length**2
    tendon["moment_arm_m"]["index_j1"] = 1e-4
    hand = hand_from_content(content, "own.toml")
    assert (hand.digit[0].link_com_m[0], hand.tendon[0].moment_arm_m["index_j1"]) == (length, 1e-4)
    digit["link_inertia_kg_m2"][0] = float(np.nextafter(mass * length**2, 1.0))
    with pytest.raises(ConfigError, match=r"expected at most mass x length\^2 = 5\.75e-06 kg m2"):
        hand_from_content(content, "own.toml")


def edit_of_hand_on_wrist(content_edit):
    """Return an edit function that puts the hand jamia on a wrist, and after that applies ``content_edit``."""

    def change(content):
        content.update(copy.deepcopy(mount_on_wrist("jamia").content))
        content_edit(content)

    return change


@pytest.mark.parametrize(
    ("moment_arms", "expected_message"),
    [
        (
            {"index_j1": 0.003, "middle_j1": 0.003},
            "tendon[index_tendon].moment_arm_m: moves index and middle; "
            "expected joints of one digit, and of digits that carry it (mount_on)",
        ),
        (
            {"index_j1": 0.003, "wrist_j1": {"polynomial_m": [0.003, 0.0005]}},
            "tendon[index_tendon].moment_arm_m.wrist_j1: an arm that depends on the angle; "
            "expected a number: index is carried by this joint",
        ),
    ],
)
def test_a_tendon_passes_only_carriers_of_its_digit(refusal_of_edit, moment_arms, expected_message):
    index = {"moment_arm_m": moment_arms}
    refusal = refusal_of_edit(
        edit_of_hand_on_wrist(lambda content: content["tendon"][1].update(index))
    )
    assert expected_message in refusal
