"""Measure the payload when each finger presses with 6 N, as in the source paper.

A load on the held cylinder grows until the cylinder slides.
"""

from typing import Any

import numpy as np

from grasps.grasp_objects import GRASP_CASES
from grasps.grasp_trial import simulate_grasp, task_program
from handctl.programs.task import HoldPhase
from handctl.programs.task_program import TaskProgram

PAPER_PAYLOAD_KG = 0.915
"""Payload in the source paper [kg], computed from a grip force of 18 N and a friction coefficient of 0.5.

Source: section 5 of the source paper.
"""
GRASP_TENSION_N = {"jamia": 33.0, "jamia11": 28.0}
"""For each hand, the tension of every tendon [N] with which each finger presses with about 6 N."""
LOAD_DIRECTIONS = {
    "along the hinges": (0.0, 0.0, -1.0),
    "out of the palm": (1.0, 0.0, 0.0),
    "towards the thumb": (0.0, -1.0, 0.0),
}
LOAD_START_S = 6.0
LOAD_RATE_N_PER_S = 2.0
SLIDING_SPEED_M_S = 1e-3
RUN_DURATION_S = 20.0


def measure_payload(job: tuple[str, str, int]) -> dict[str, Any]:
    """Measure the payload [kg] of a hand for one direction of the load and one seed.

    A load along the joint axes acts in the direction of gravity. Therefore, the payload along the
    joint axes includes the mass of the object.
    """
    hand, direction, seed = job
    case = GRASP_CASES[1]
    load = (
        f"[load]\ndirection = {list(LOAD_DIRECTIONS[direction])}\n"
        f"start_s = {LOAD_START_S}\nrate_N_per_s = {LOAD_RATE_N_PER_S}\n"
    )
    run = simulate_grasp(
        hand,
        _grasp_at_tension(hand, GRASP_TENSION_N[hand]),
        case.scene_text(seed, includes_stages=False) + load,
        seed=seed,
        timeout_s=RUN_DURATION_S,
    )
    is_before_load = run.t < LOAD_START_S
    settled_mask = run.t > LOAD_START_S - 0.5
    mean_normal_forces = run.contact_normal[is_before_load & settled_mask].mean(axis=0)
    window = max(1, int(0.2 / (run.t[1] - run.t[0])))
    object_speed = np.linalg.norm(
        run.object_position[window:] - run.object_position[:-window], axis=1
    ) / (run.t[window] - run.t[0])
    sliding_ticks = np.flatnonzero(
        (object_speed > SLIDING_SPEED_M_S) & (run.t[window:] > LOAD_START_S)
    )
    slip_time_s = (
        float(run.t[window + sliding_ticks[0]]) if len(sliding_ticks) else float(run.t[-1])
    )
    slip_force = LOAD_RATE_N_PER_S * (slip_time_s - LOAD_START_S) + (
        case.mass * 9.81 if direction == "along the hinges" else 0.0
    )
    return {
        "hand": hand, "direction": direction, "seed": seed,
        "mass_kg": round(slip_force / 9.81, 3), "slid": bool(len(sliding_ticks)),
        "normal_N": np.round(mean_normal_forces, 2).tolist(),
        "coulomb_kg": round(float(case.friction * mean_normal_forces.sum() / 9.81), 3),
    }  # fmt: skip


def _grasp_at_tension(hand_name: str, tension: float) -> TaskProgram:
    """Return the packaged power grasp with the given tension, and without the reaction to slip."""
    program = task_program("grasp", hand_name, hold_s=60.0)
    phases = [
        phase.model_copy(
            update={"tension_N": tension, "slip_limit_N": None, "stiffness_N_per_mm": 0.0}
        )
        if isinstance(phase, HoldPhase)
        else phase
        for phase in program.task.phase
    ]
    return TaskProgram(program.task.model_copy(update={"phase": tuple(phases)}))
