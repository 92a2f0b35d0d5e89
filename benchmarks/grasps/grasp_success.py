"""Measure whether the hands jamia and jamia11 can grasp and hold each object.

During a grasp, the hand is turned three times, and the object is pushed.
"""

from typing import Any

import numpy as np

from grasps.grasp_objects import GRASP_CASES, GRAVITY_DIRECTIONS, MAX_OBJECT_MOTION_M, GraspCase
from grasps.grasp_trial import GraspRun, simulate_grasp, stage_motions, task_program

TASK_BY_GRASP = {
    ("jamia", "power"): "grasp",
    ("jamia", "pinch"): "pinch",
    ("jamia", "hook"): "hook",
    ("jamia11", "power"): "grasp",
    ("jamia11", "pinch"): "pinch-joints",
    ("jamia11", "hook"): "hook",
}
PALM_GAP_M = 0.5e-3
"""Smallest permitted gap between a pinched object and the palm [m].

If the gap is smaller, the hand has drawn the object to the palm instead of pinching the object.
"""
GRASP_TIMEOUT_S = 10.0
"""Time limit from the start of a run until the hand must hold the object [s].
"""


def measure_grasp(job: tuple[str, int, int]) -> dict[str, Any]:
    """Measure the largest motion [mm] of an object in each stage of the scene.

    If the grasp failed, the result also contains the reason of the failure.
    """
    hand, case_index, seed = job
    case = GRASP_CASES[case_index]
    program = task_program(TASK_BY_GRASP[hand, case.grasp], hand, hold_s=60.0)
    run = simulate_grasp(
        hand,
        program,
        case.scene_text(seed),
        seed=seed,
        last_phase="release",
        retry_timeout_s=GRASP_TIMEOUT_S,
    )
    motion = [round(1e3 * value, 2) for value in stage_motions(run)]
    reason = failure_reason(run, case, motion)
    return {
        "hand": hand, "grasp": case.grasp, "object": case.name, "seed": seed, "motion_mm": motion,
        "ok": not reason, "why": reason, "force_N": np.round(run.true_force[-1], 1).tolist(),
    }  # fmt: skip


def failure_reason(run: GraspRun, case: GraspCase, motion_by_stage: list[float]) -> str:
    """Describe why a grasp failed. Return an empty string for a successful grasp."""
    if run.failure:
        return run.failure
    if run.table_sink_start_s is None:
        return "not grasped: too few digits press"
    if max(motion_by_stage) >= 1e3 * MAX_OBJECT_MOTION_M:
        stage = int(np.argmax([value >= 1e3 * MAX_OBJECT_MOTION_M for value in motion_by_stage]))
        direction = GRAVITY_DIRECTIONS[case.grasp][stage]
        return f"the object moves {motion_by_stage[stage]:.1f} mm with gravity along {direction}"
    if len(motion_by_stage) < len(GRAVITY_DIRECTIONS[case.grasp]):
        return "ended early"
    if case.grasp == "pinch" and run.object_position[-1, 0] - case.width / 2 < PALM_GAP_M:
        return "drawn to the palm: held, but not pinched"
    return ""
