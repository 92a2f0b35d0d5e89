"""Test the moment arms that depend on the joint angle.

The excursion of a tendon is the integral of its moment arms over the joint angles. Further tests
check that handctl reports mistakes in the moment arms of a hand file.
"""

import numpy as np
import pytest

from firmware_sim.description.hand_description import load_hand as load_simulated
from firmware_sim.plant.drivetrain import _moment_arm_at, _wrapped_tendon_length
from firmware_sim.plant.tendon import TendonRouting
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import hand_from_content, load_hand, packaged_hands, parse_toml
from handctl.hand.moment_arms import moment_arm_polynomial, moment_arm_table_residual
from handctl.hand.tendons import excursions
from handctl.programs.default_task import grasp_warnings
from handctl.report.hand_graph import text_graph
from tests.hand.varying_arm_hands import hand_with_varying_arms

PACKAGED_HANDS = packaged_hands()
ANGLE_SEEDS = range(3)


@pytest.mark.parametrize("hand_name", PACKAGED_HANDS)
@pytest.mark.parametrize("polynomial_kind", ["polynomial", "table"])
def test_moment_arms_are_the_derivative_of_the_excursion(
    hand_name: str, polynomial_kind: str
) -> None:
    hand = hand_with_varying_arms(hand_name, 0.3, polynomial_kind)
    for digit in (DigitModel.from_hand(hand, digit_name) for digit_name in hand.digit_names):
        for seed in ANGLE_SEEDS:
            # The test includes joint angles outside the joint limits. Beyond a joint limit, a
            # moment arm is constant.
            q = np.random.default_rng(seed).uniform(digit.joint_min - 0.2, digit.joint_max + 0.2)
            step = 1e-6
            slope = [
                (excursions(digit, q + joint_step) - excursions(digit, q - joint_step)) / (2 * step)
                for joint_step in step * np.eye(digit.joint_count)
            ]
            np.testing.assert_allclose(np.transpose(slope), digit.moment_arms_at(q), atol=1e-9)
            assert digit.with_moment_arms_at(q).has_varying_arm
            theta = digit.joints_to_coordinates @ q
            coordinates = digit.coordinates_of_excursion(excursions(digit, digit.coupling @ theta))
            np.testing.assert_allclose(coordinates, theta, atol=1e-9)


@pytest.mark.parametrize("hand_name", PACKAGED_HANDS)
def test_a_polynomial_of_one_coefficient_is_a_constant_arm(hand_name: str) -> None:
    hand_with_constant_arms = load_hand(hand_name)
    hand = hand_with_varying_arms(hand_name, 0.0)
    np.testing.assert_allclose(hand.moment_arms, hand_with_constant_arms.moment_arms, rtol=1e-12)
    q = np.random.default_rng(1).uniform(-1.0, 2.0, len(hand.joints))
    for digit_name in hand.digit_names:
        digit = DigitModel.from_hand(hand, digit_name)
        constant_model = DigitModel.from_hand(hand_with_constant_arms, digit_name)
        np.testing.assert_allclose(
            excursions(digit, q[digit.joints]),
            excursions(constant_model, q[digit.joints]),
            rtol=1e-12,
        )
        np.testing.assert_allclose(
            digit.with_moment_arms_at(q[digit.joints]).torque_to_tension,
            constant_model.torque_to_tension,
            rtol=1e-9,
        )


@pytest.mark.parametrize("hand_name", PACKAGED_HANDS)
@pytest.mark.parametrize("polynomial_kind", ["polynomial", "table"])
def test_the_simulator_has_the_same_arms_from_its_own_polynomials(
    hand_name: str, polynomial_kind: str, tmp_path
) -> None:  # type: ignore[no-untyped-def]
    hand = hand_with_varying_arms(hand_name, 0.3, polynomial_kind)
    path = tmp_path / "hand.toml"
    path.write_text(hand.to_toml())
    simulated_description = load_simulated(str(path))
    motors = [motor.name for motor in simulated_description.motors]
    routing = TendonRouting(
        simulated_description.tendons,
        simulated_description.joints,
        motors,
        [0.005] * len(motors),
        is_compiled=False,
    )
    for seed in ANGLE_SEEDS:
        q = np.random.default_rng(seed).uniform(
            hand.joint_limits[0] - 0.1, hand.joint_limits[1] + 0.1
        )
        for digit_name in hand.digit_names:
            digit = DigitModel.from_hand(hand, digit_name)
            angles = q[digit.joints]
            arms = np.zeros_like(digit.moment_arms)
            lengths = np.zeros(len(arms))
            for n, tendon in enumerate(routing.tendons[digit.tendons]):
                for i in range(tendon.first, tendon.end):
                    joint = routing.joints[i]
                    arms[n, joint - digit.joints.start] = _moment_arm_at(
                        routing.arms, i, float(q[joint])
                    )
                    lengths[n] += _wrapped_tendon_length(routing.arms, i, float(q[joint]))
            np.testing.assert_allclose(arms, digit.moment_arms_at(angles), atol=1e-12)
            np.testing.assert_allclose(lengths, excursions(digit, angles), atol=1e-12)


def test_a_table_becomes_a_polynomial_of_degree_three_with_its_residual() -> None:
    angle = np.linspace(0.0, 90.0, 10)
    cubic_coefficients = np.array([0.003, 1e-3, -4e-4, 1e-4])
    moment_arm_table = {
        "angle_deg": angle.tolist(),
        "arm_m": np.polynomial.polynomial.polyval(np.radians(angle), cubic_coefficients).tolist(),
    }
    np.testing.assert_allclose(
        moment_arm_polynomial(moment_arm_table), [*cubic_coefficients, 0.0, 0.0], atol=1e-12
    )
    assert moment_arm_table_residual(moment_arm_table) < 1e-12
    moment_arm_table["arm_m"][4] += 1e-4
    assert 2e-5 < moment_arm_table_residual(moment_arm_table) < 1e-4
    assert (
        moment_arm_polynomial({"angle_deg": [0.0, 90.0], "arm_m": [0.002, 0.004]})[2:].tolist()
        == [0.0] * 4
    )


MOMENT_ARM_MISTAKES = {
    "sign": (
        {"polynomial_m": [0.001, -0.002]},
        "the arm changes its sign at 29 deg; expected one sign over",
    ),
    "small": (
        {"polynomial_m": [0.0001, 0.0, -3e-5]},
        "an arm of 8.61e-06 m at 100 deg; expected 0.0001 to 0.05 m",
    ),
    "large": (
        {"polynomial_m": [0.003, 0.05]},
        "an arm of 0.0903 m at 100 deg; expected 0.0001 to 0.05 m",
    ),
    "short table": (
        {"angle_deg": [0, 60], "arm_m": [0.003, 0.004]},
        "angle_deg from 0 to 60; expected a table over",
    ),
    "falling": (
        {"angle_deg": [0, 100, 60], "arm_m": [0.003] * 3},
        "expected rising values of angle_deg",
    ),
    "lengths": (
        {"angle_deg": [0, 100], "arm_m": [0.003] * 3},
        "expected an arm_m for each angle_deg, and there are 3",
    ),
    "rough": (
        {
            "angle_deg": [0, 20, 40, 60, 80, 100],
            "arm_m": [0.003, 0.004, 0.003, 0.004, 0.003, 0.004],
        },
        "from the table; expected a smoother table, within 10 % of the arm",
    ),
    "degree": (
        {"polynomial_m": [0.003] * 7},
        "expected 1 to 6 numbers from -1 to 1 in polynomial_m",
    ),
    "not a number": (
        {"polynomial_m": [0.003, float("nan")]},
        "expected 1 to 6 numbers from -1 to 1 in polynomial_m",
    ),
    "both": (
        {"polynomial_m": [0.003], "arm_m": [0.003]},
        "expected { polynomial_m = [r0, r1, ..] }",
    ),
    "unit": ({"polynomial_mm": [3.0]}, "expected { polynomial_m = [r0, r1, ..] }"),
}


@pytest.mark.parametrize("mistake_name", MOMENT_ARM_MISTAKES)
def test_a_mistake_in_a_moment_arm_is_one_line(mistake_name: str) -> None:
    wrong_moment_arm, text = MOMENT_ARM_MISTAKES[mistake_name]
    content = hand_with_varying_arms("jamia", 0.0, "content")
    content["tendon"][0]["moment_arm_m"]["index_j1"] = wrong_moment_arm
    with pytest.raises(ConfigError) as caught:
        hand_from_content(content, "hand.toml")
    line = str(caught.value)
    assert line.startswith("hand.toml: tendon[index_tendon].moment_arm_m.index_j1: ")
    assert text in line
    assert "\n" not in line


def test_a_hand_with_varying_arms_is_written_and_read_back() -> None:
    hand: Hand = hand_with_varying_arms("jamia11", 0.3, "table")
    repeated_hand = hand_from_content(parse_toml(hand.to_toml(), "again"), "again")
    assert repeated_hand.identity == hand.identity
    assert repeated_hand.content == hand.content


def test_graph_and_warnings_include_varying_arms() -> None:
    hand = hand_with_varying_arms("jamia11", 0.3)
    assert "index_t1: j1 +2.1..3.9 mm" in text_graph(hand)
    assert not [text for text in grasp_warnings(hand) if "no digit" in text]
