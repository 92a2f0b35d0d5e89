"""Compare the simulated hand with manually calculated results of statics and kinematics."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_sim.description.hand_description import Hand, SimulatorError, load_hand
from firmware_sim.plant.mjcf import STEP_S, model_text, opposed_digits
from firmware_sim.plant.plant import Plant
from firmware_sim.plant.plant_perturbation import perturbed_hand
from firmware_sim.scene.scene import load_scene
from handctl.hand.hand_loading import hand_content, hand_from_content

JAMIA_HAND = load_hand("jamia")


def plant_without_object(
    parameter_factors: dict[str, float] | None = None, hand: Hand = JAMIA_HAND, homed: bool = True
) -> Plant:
    plant = Plant(
        perturbed_hand(hand, parameter_factors or {}), load_scene(None), seed=1, homed=homed
    )
    for motor in plant.motors.values():
        motor.servo.limit = 1.25
    return plant


def hand_with_locked_joints() -> Hand:
    """Return a hand whose joints cannot move, because the two stops of a joint are a hundredth of a degree apart."""
    digits = [
        replace(digit, joint_max_deg=(0.01,) * len(digit.length)) for digit in JAMIA_HAND.digits
    ]
    return replace(JAMIA_HAND, digits=digits)


def pull_tendons(plant: Plant, torque: float, duration_s: float, ramp_s: float = 0.3) -> None:
    """Raise the torque of all motors in a ramp to ``torque`` [N m], and keep this torque."""
    start = [motor.servo.torque for motor in plant.motors.values()]
    steps = round(duration_s * 2000)
    for i in range(steps):
        fraction = min(1.0, (i + 1) / (ramp_s * 2000))
        for motor, first_torque in zip(plant.motors.values(), start, strict=True):
            motor.servo.torque = first_torque + fraction * (torque - first_torque)
        plant.step()


def test_the_springs_hold_the_free_hand_open() -> None:
    plant = plant_without_object()
    pull_tendons(plant, 0.0, 0.3)
    assert np.abs(plant.engine.q).max() < math.radians(0.5)
    assert max(plant.tensions()) < 0.5


@pytest.mark.parametrize("tension", [8.0, 10.0, 12.0])
def test_spring_and_tendon_balance_at_every_joint(tension: float) -> None:
    """Test that tendon tension and spring torque balance at each joint without friction: r f = k (q + q0).

    The tendon has the tension f. All joints have the same moment arm r, stiffness k and preload
    angle q0, and therefore the same angle q.

    Gravity is parallel to the joint axes, so gravity has no effect on the joints.
    """
    plant = plant_without_object({"friction": 0.0})
    pull_tendons(plant, tension * 0.005, 2.0)
    assert plant.tensions() == pytest.approx([tension] * 4, rel=1e-3)
    angle = 0.003 * tension / 0.03 - 0.6
    assert plant.engine.q == pytest.approx([angle] * 11, abs=2e-3)


def test_excursion_and_stretch_add_up() -> None:
    """Test that the travel of a spool is the excursion of the joints plus the stretch of the tendon.

    At rest and without friction, r_a theta = sum r q + f / k. The spool has the radius r_a and the
    angle theta. A joint has the moment arm r and the angle q. The tendon has the tension f and the
    stiffness k.
    """
    plant = plant_without_object({"friction": 0.0})
    pull_tendons(plant, 14.0 * 0.005, 2.0)
    spool_angle = plant.motors["index_motor"].theta
    assert 0.005 * spool_angle == pytest.approx(
        0.003 * sum(plant.engine.q[:3]) + 14.0 / 1e5, abs=2e-6
    )


def test_friction_makes_the_far_joints_lag() -> None:
    plant = plant_without_object()
    for k in range(600):
        for motor in plant.motors.values():
            motor.servo.torque = 0.09 * k / 600
        plant.step()
    first_angle, second_angle, third_angle = plant.engine.q[:3]
    assert first_angle > second_angle > third_angle > 0.0


def test_a_slack_tendon_makes_no_force() -> None:
    plant = plant_without_object(homed=False)
    thetas_before = [motor.theta for motor in plant.motors.values()]
    assert all(-0.6 <= theta <= -0.2 for theta in thetas_before), (
        "a slack of 1 to 3 mm on a spool of 5 mm radius"
    )
    assert len(set(thetas_before)) == 4
    for motor in plant.motors.values():
        motor.omega = 2.0
    for _ in range(100):
        plant.step()
        if max(motor.theta for motor in plant.motors.values()) < 0.0:
            assert plant.tensions() == [0.0] * 4


def test_a_blocked_finger_is_as_stiff_as_its_tendon() -> None:
    """With locked joints, the tension rises in proportion to the spool rotation.

    The slope of the tension over the spool angle is the tendon stiffness times the spool radius.
    """
    plant = plant_without_object({"friction": 0.0}, hand_with_locked_joints())
    pull_tendons(plant, 0.25, 2.0)
    low, theta_low = plant.tensions()[0], plant.motors["index_motor"].theta
    pull_tendons(plant, 0.75, 2.0)
    high, theta_high = plant.tensions()[0], plant.motors["index_motor"].theta
    assert (low, high) == pytest.approx((50.0, 150.0), rel=1e-3)
    assert (high - low) / (0.005 * (theta_high - theta_low)) == pytest.approx(1e5, rel=0.01)
    pull_tendons(plant, 1.2, 2.0)
    assert plant.tensions()[0] == pytest.approx(240.0, rel=1e-3)
    assert plant.tensions()[0] < 1e5 * 0.005 * plant.motors["index_motor"].theta - 5.0, (
        "the tendon is softer beyond the knee"
    )


def test_a_blocked_rotor_rings_at_the_frequency_of_tendon_and_rotor() -> None:
    """A rotor on a tendon oscillates with the angular frequency sqrt(k r^2 / J) = 139 rad/s.

    The tendon has the stiffness k, the spool has the radius r, and the rotor has the inertia J.
    Source: MODEL, section 4.
    """
    plant = plant_without_object({"friction": 0.0, "damping": 0.1}, hand_with_locked_joints())
    pull_tendons(plant, 0.25, 0.6)
    motor = plant.motors["index_motor"]
    motor.omega += 0.5
    speeds = []
    for _ in range(1000):
        plant.step()
        speeds.append(motor.omega)
    crossings = np.flatnonzero(np.diff(np.sign(speeds)) != 0)
    period = 2 * float(np.diff(crossings).mean()) * 0.5e-3
    assert 2 * math.pi / period == pytest.approx(math.sqrt(1e5 * 0.005**2 / 1.3e-4), rel=0.02)


def test_joint_stops_limit_the_angles() -> None:
    plant = plant_without_object()
    pull_tendons(plant, 0.55, 1.0)
    angles_deg = np.degrees(plant.engine.q)
    assert angles_deg.max() < 102.0
    assert angles_deg.min() > -1.0


def simulated_link_positions(plant: Plant) -> Any:
    return {
        name: np.array(plant.engine._data.body(name).xpos)
        for name in ("index_link3", "ring_link2", "thumb_link2")
    }


def test_forward_kinematics_of_the_links() -> None:
    """The fingers flex towards -y, and the thumb flexes towards +y.

    All digits of the hand move in planes of constant z.
    """
    plant = plant_without_object()
    q = [0.3, 0.4, 0.1] * 3 + [0.5, 0.2]
    plant.engine.set_joints(q, [0.0] * 11)
    link_positions = simulated_link_positions(plant)
    x = 0.030 * math.cos(0.3) + 0.015 * math.cos(0.7)
    y = 0.025 - 0.030 * math.sin(0.3) - 0.015 * math.sin(0.7)
    assert link_positions["index_link3"] == pytest.approx([x, y, 0.020], abs=1e-9)
    assert link_positions["ring_link2"] == pytest.approx(
        [0.030 * math.cos(0.3), 0.025 - 0.030 * math.sin(0.3), -0.020], abs=1e-9
    )
    assert link_positions["thumb_link2"] == pytest.approx(
        [0.015 * math.cos(0.5), -0.025 + 0.015 * math.sin(0.5), 0.0], abs=1e-9
    )


def test_the_thumb_alone_is_opposed() -> None:
    assert opposed_digits(JAMIA_HAND) == [False, False, False, True]


def test_eleven_motors_move_joints_one_by_one() -> None:
    """In the hand jamia11, the first tendon of a finger moves only the first joint of this finger."""
    hand = load_hand("jamia11")
    plant = plant_without_object({"friction": 0.0}, hand)
    motors = [motor.name for motor in hand.motors]
    first_tendon = hand.tendons[0]
    assert list(first_tendon.arms) == ["index_j1"]
    for name in motors:
        plant.motors[name].servo.torque = 0.0
    plant.motors[first_tendon.motor].servo.torque = 0.005 * 32.0
    for _ in range(2000):
        plant.step()
    q = plant.engine.q
    stiffness, preload = hand.digits[0].spring[0], hand.digits[0].preload[0]
    assert q[0] == pytest.approx(
        min(0.003 * 32.0 / stiffness - preload, math.radians(100)), abs=5e-3
    )
    assert np.abs(q[1:]).max() < 0.02


def test_a_diverging_plant_is_an_error() -> None:
    plant = plant_without_object({"spring": 1e6})
    with pytest.raises(SimulatorError, match="diverged"):
        pull_tendons(plant, 0.3, 0.5)


def closing_hand(
    monkeypatch: pytest.MonkeyPatch, step_s: float
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Raise all tensions of an empty hand to 12 N within 0.4 s.

    The argument ``step_s`` [s] is the time step of the simulator. Return the joint angles of the
    hand after every 5 ms.
    """
    monkeypatch.setattr("firmware_sim.plant.plant.STEP_S", step_s)
    monkeypatch.setattr(
        "firmware_sim.plant.plant.model_text",
        lambda hand, scene: model_text(hand, scene).replace(
            f'timestep="{STEP_S}"', f'timestep="{step_s}"'
        ),
    )
    plant, rows = plant_without_object(), []
    for i in range(round(0.8 / step_s)):
        for motor in plant.motors.values():
            motor.servo.torque = 0.06 * min(1.0, i * step_s / 0.4)
        plant.step()
        if (i + 1) % round(5e-3 / step_s) == 0:
            rows.append(plant.engine.q.tolist())
    return np.array(rows)


def test_the_step_is_short_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """Test that the integration error of the simulator is small, and decreases with the time step.

    The simulator integrates tendons, friction and rotors with a first-order method.
    """
    exact_value = closing_hand(monkeypatch, 0.05e-3)
    errors = [
        np.degrees(np.sqrt(((closing_hand(monkeypatch, step) - exact_value) ** 2).mean()))
        for step in (0.5e-3, 0.1e-3)
    ]
    assert np.degrees(exact_value[-1].min()) > 12.0, "the digit closed"
    assert errors[0] < 0.2
    assert errors[1] < 0.3 * errors[0]


COUPLED_FINGERS = ("index", "middle", "ring", "pinky")
"""Digits of ``orca_like`` whose joints a test couples.

Each finger of ``orca_like`` has three joints and three spool pairs.
"""


def hand_with_coupled_fingers(joint_coupling: list[list[float]], path: Path) -> Hand:
    """Return ``orca_like`` with coupled joints in each finger.

    In each finger with coupled joints, two antagonistic tendons on one spool (a spool pair) move
    both outer joints.

    Args:
        joint_coupling: value of the key ``joint_coupling`` for each finger, with one row for each of the three
            joints. With one column in ``joint_coupling``, a single spool pair turns all three
            joints.
        path: path at which the hand file is written.
    """
    content = json.loads(json.dumps(hand_content("orca_like")))
    missing_tendon_suffixes = ("pip",) if len(joint_coupling[0]) == 2 else ("pip", "abd")
    missing = {f"{finger}_{name}" for finger in COUPLED_FINGERS for name in missing_tendon_suffixes}
    content["tendon"] = [tendon for tendon in content["tendon"] if tendon["name"] not in missing]
    content["motor"] = [motor for motor in content["motor"] if motor["name"] not in missing]
    for finger in COUPLED_FINGERS:
        digit = next(entry for entry in content["digit"] if entry["name"] == finger)
        digit["coupling"] = joint_coupling
        flexor = next(tendon for tendon in content["tendon"] if tendon["name"] == f"{finger}_mcp")
        flexor["moment_arm_m"] = {f"{finger}_j2": 0.0075, f"{finger}_j3": 0.0075}
        if len(joint_coupling[0]) == 1:
            flexor["moment_arm_m"][f"{finger}_j1"] = 0.002
    path.write_text(hand_from_content(content, "orca_like with coupled fingers").to_toml())
    return load_hand(str(path))


@pytest.mark.parametrize(
    "joint_coupling",
    [
        [[1.0, 0.0], [0.0, 1.0], [0.0, 1.0]],
        [[1.0, 0.0], [0.0, 1.0], [0.0, 0.6]],
        [[0.2], [1.0], [0.8]],
    ],
    ids=["equal", "with a ratio", "one coordinate"],
)
def test_coupled_joints_of_spool_pairs_keep_their_coupling(
    joint_coupling: list[list[float]], tmp_path: Path
) -> None:
    """Reproduce a defect: the joints of a digit with spool pairs could turn freely against each other.

    A digit with spool pairs has no springs. While the fingers closed, the joint angles deviated
    from the coupling by 49 to 74 deg. The simulator now has tendons that couple the joints, so the
    joint angles deviate from the coupling by at most 1.4 deg.
    """
    hand = hand_with_coupled_fingers(joint_coupling, tmp_path / "coupled.toml")
    plant = plant_without_object(hand=hand)
    joints = [joint for digit in hand.digits for joint in digit.joints]
    fingers = [[joints.index(f"{name}_j{i}") for i in (1, 2, 3)] for name in COUPLED_FINGERS]
    uncoupled_projection = np.eye(3) - np.array(joint_coupling) @ np.linalg.pinv(joint_coupling)
    deviations = []
    for _ in range(15):
        pull_tendons(plant, 0.1, 0.04, ramp_s=0.2)
        angles = np.degrees(np.array(plant.engine.q)[fingers])
        deviations.append(np.abs(angles @ uncoupled_projection).max())
    assert angles[:, 1].min() > 60.0, "the fingers closed"
    assert max(deviations) < 4.0
