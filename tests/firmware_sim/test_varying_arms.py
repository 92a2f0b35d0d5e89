"""Test simulated tendons whose moment arms depend on the joint angle."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_sim.description.hand_description import load_hand
from firmware_sim.plant.drivetrain import _wrapped_tendon_length, step_drivetrain
from firmware_sim.plant.motor import Motor
from firmware_sim.plant.tendon import TendonRouting
from tests.hand.varying_arm_hands import hand_with_varying_arms

STEP_S = 0.5e-3


@pytest.mark.parametrize("hand_name", ["jamia11", "n_plus_1", "orca_like"])
def test_the_joints_get_the_work_that_the_tendons_do(hand_name: str, tmp_path: Path) -> None:
    """The total power of the tendons equals the total power of the joints.

    The power of a tendon is its tension times its speed, and the power of a joint is its torque
    times its rate. The simulated hand of this test has no friction and no damping.
    """
    path = tmp_path / "hand.toml"
    path.write_text(hand_with_varying_arms(hand_name, 0.3).to_toml())
    hand = load_hand(str(path))
    specs = [replace(spec, friction=0.0, damping=0.0) for spec in hand.all_tendons]
    names = [motor.name for motor in hand.motors]
    routing = TendonRouting(
        specs, hand.joints, names, [motor.spool_radius for motor in hand.motors], is_compiled=False
    )
    for seed in range(3):
        chance = np.random.default_rng(seed)
        motors = [Motor(motor, STEP_S) for motor in hand.motors]
        q = chance.uniform(0.1, 0.8, len(hand.joints)).tolist()
        dq = chance.uniform(-3.0, 3.0, len(hand.joints)).tolist()
        for motor in motors:
            motor.theta = chance.uniform(0.5, 2.0)
        drivetrain_parts = routing.rows, routing.joints, routing.arms, motors
        torque = [0.0] * len(hand.joints)
        step_drivetrain(*drivetrain_parts, q, dq, torque, [0.0] * len(specs), False)
        tendon_power = sum(row.tension * row.speed for row in routing.tendons)
        assert np.dot(torque, dq) == pytest.approx(tendon_power, rel=1e-9)
        assert abs(tendon_power) > 1e-3
        small = 1e-6
        for row in routing.tendons:
            ends = [
                sum(
                    _wrapped_tendon_length(
                        routing.arms, i, q[routing.joints[i]] + sign * small * dq[routing.joints[i]]
                    )
                    for i in range(row.first, row.end)
                )
                for sign in (-1.0, 1.0)
            ]
            assert (ends[1] - ends[0]) / (2 * small) == pytest.approx(row.speed, rel=1e-6, abs=1e-9)
