"""Measure the force at a fingertip: the commanded force, the estimate of the controller, and the true force.

In a hold phase with ``tip_force_N``, the digits press on a wall. Only the last link of each digit
touches the wall. For `jamia11`, which has joint encoders, the controller computes the tensions from
the Jacobian. Each digit of `jamia` has only one tendon, and the controller approximates the tension
that causes the commanded force. For `jamia`, handctl refuses a task file that commands a tip force,
because the error that this benchmark measures is too large.
"""

import random
from typing import Any

import numpy as np

from grasps.contact_detection import random_wall_scene, simulate_press_on_wall
from grasps.grasp_trial import hand_model

COMMANDED_FORCES_N = (2.0, 4.0, 6.0)
CLOSING_SPEED_DEG_S = 50.0
HOLD_DURATION_S = 0.8
EVALUATION_WINDOW_S = 0.4


def measure_tip_force(job: tuple[str, int]) -> list[dict[str, Any]]:
    """Measure the mean estimated and the mean true force [N] of each digit, at each commanded force."""
    hand, seed = job
    random_source = random.Random(f"tip {seed}")
    hold_phases = [
        {"kind": "hold", "name": f"{f:g}", "tip_force_N": f, "duration_s": HOLD_DURATION_S}
        for f in COMMANDED_FORCES_N
    ]
    run = simulate_press_on_wall(
        hand, random_wall_scene(random_source), CLOSING_SPEED_DEG_S, hold_phases, seed
    )
    rows = []
    for command in COMMANDED_FORCES_N:
        evaluation_mask = np.array(run.phase) == f"{command:g}"
        evaluation_mask &= run.t > run.t[evaluation_mask].max(initial=0.0) - EVALUATION_WINDOW_S
        for d, name in enumerate(hand_model(hand)[0].hand.digit_names):
            if evaluation_mask.any() and run.contact[evaluation_mask, d].all():
                estimated_force = run.estimated_tip_force[evaluation_mask, d]
                true_force = run.true_force[evaluation_mask, d]
                rows.append(
                    {
                        "hand": hand,
                        "seed": seed,
                        "digit": name,
                        "asked": command,
                        "told": round(float(estimated_force.mean()), 3),
                        "felt": round(float(true_force.mean()), 3),
                        "noise": round(float((estimated_force - true_force).std()), 3),
                    }
                )
    return rows
