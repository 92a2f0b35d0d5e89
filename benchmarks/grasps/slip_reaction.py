"""Measure the motion of a held cylinder under a growing load, with and without the reaction to slip."""

from typing import Any

import numpy as np

from grasps.grasp_objects import GRASP_CASES
from grasps.grasp_trial import simulate_grasp, task_program
from handctl.programs.task import HoldPhase
from handctl.programs.task_program import TaskProgram

LOAD_START_S = 6.0
LOAD_RATE_N_PER_S = 2.0
RUN_DURATION_S = 14.0
CYLINDER_FRICTION = {"jamia": 0.3, "jamia11": 0.2}
"""Friction coefficient of the cylinder for each hand.

The friction is so low that a hand with 20 N per tendon loses the cylinder before the load reaches
its maximum.
"""
GRASP_TENSION_N = 20.0
SLIP_LIMIT_N = 60.0
OBJECT_LOSS_DISTANCE_M = 10e-3


def measure_slip(job: tuple[str, bool, int]) -> dict[str, Any]:
    """Measure the motion [mm] of the cylinder while the load on the cylinder grows.

    Also measure the load [N] at which the hand loses the cylinder. The argument ``job`` contains
    the name of the hand, a bool that is True if the hand reacts to slip, and the seed.
    """
    hand, has_slip_reaction, seed = job
    scene = (
        GRASP_CASES[1]
        .scene_text(seed, includes_stages=False)
        .replace("friction = 0.5", f"friction = {CYLINDER_FRICTION[hand]}")
    )
    scene += f"[load]\ndirection = [1.0, 0.0, 0.0]\nstart_s = {LOAD_START_S}\nrate_N_per_s = {LOAD_RATE_N_PER_S}\n"
    program = task_program("grasp", hand, hold_s=60.0)
    change = {
        "tension_N": GRASP_TENSION_N,
        "slip_limit_N": SLIP_LIMIT_N if has_slip_reaction else None,
    }
    phases = [
        phase.model_copy(update=change) if isinstance(phase, HoldPhase) else phase
        for phase in program.task.phase
    ]
    program = TaskProgram(program.task.model_copy(update={"phase": tuple(phases)}))
    run = simulate_grasp(hand, program, scene, seed=seed, timeout_s=RUN_DURATION_S)
    load_ticks = np.flatnonzero(run.t >= LOAD_START_S)
    object_motion = np.linalg.norm(
        run.object_position[load_ticks] - run.object_position[load_ticks[0]], axis=1
    )
    load = LOAD_RATE_N_PER_S * (run.t[load_ticks] - LOAD_START_S)
    indices_after_loss = np.flatnonzero(object_motion > OBJECT_LOSS_DISTANCE_M)
    every_tenth_sample = slice(None, None, 10)
    return {
        "hand": hand, "answered": has_slip_reaction, "seed": seed,
        "lost_at_N": round(float(load[indices_after_loss[0]]), 1) if len(indices_after_loss) else None,
        "motion_mm": round(1e3 * float(object_motion[-1]), 2), "load_end_N": round(float(load[-1]), 1),
        "tension_end_N": round(float(run.tension[-1].max()), 1),
        "first_event_mm": _motion_at_first_slip(run, object_motion, load_ticks),
        "curve": np.round(
            [load[every_tenth_sample], 1e3 * np.minimum(object_motion[every_tenth_sample], 0.05)], 3
        ).tolist(),
    }  # fmt: skip


def _motion_at_first_slip(
    run: Any, object_motion: np.ndarray, is_after_load_start: np.ndarray
) -> float | None:
    """Return the motion [mm] of the object at the first slip event, or None if there is no slip event."""
    ticks = [k for k, event in run.events if event.name == "slip" and k >= is_after_load_start[0]]
    return (
        round(1e3 * float(object_motion[ticks[0] - is_after_load_start[0]]), 2) if ticks else None
    )
