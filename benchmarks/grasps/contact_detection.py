"""Measure the delay of contact detection at a fingertip, and count the false contact events.

The delay of contact detection begins when the true contact force reaches 1 N.
"""

import json
import random
from typing import Any

import numpy as np

from grasps.grasp_trial import GraspRun, hand_model, simulate_grasp
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram

CONTACT_FORCE_N = 1.0
DETECTION_LIMIT_S = 0.020
CLOSING_SPEEDS_DEG_S = (20.0, 100.0)
"""Smallest and largest speed of closing [deg/s]. The digits close with 40 to 50 deg/s in the packaged tasks."""
TRUE_CONTACT_FORCE_N = 0.01
MOVING_TIME_FRACTION = 0.85
"""Fraction of a free-motion run in which the digits move."""
WALL_SCENE = """name = "wall"
[object]
shape = "box"
size_m = [0.04, 0.02, 0.093]
mass_kg = 50.0
friction = 0.5
position_m = [{x:.5f}, {y:.5f}, 0.0]
[support]
drop_when = "never"
"""
"""A heavy wall at a position where only the last link of each digit can touch it."""


def program_of_phases(phases: list[dict[str, Any]]) -> TaskProgram:
    """Return the controller program for a task that has the given phases."""
    return TaskProgram(
        Task.model_validate_json(json.dumps({"schema": 1, "name": "contact", "phase": phases}))
    )


def random_wall_scene(random_source: random.Random) -> str:
    """Return the text of a scene with the wall at a random position."""
    return WALL_SCENE.format(
        x=0.045 + random_source.uniform(-3e-3, 3e-3), y=random_source.uniform(-4e-3, 2e-3)
    )


def simulate_press_on_wall(
    hand: str,
    wall_scene_text: str,
    closing_speed_deg_s: float,
    hold_phases: list[dict[str, Any]],
    seed: int,
) -> GraspRun:
    """Close a hand until its digits touch the wall, and simulate the given hold phases."""
    phases = [
        {
            "kind": "move",
            "angle_deg": {"index": 6.0, "middle": 6.0, "ring": 6.0, "thumb": 0.0},
            "duration_s": 0.6,
        },
        {"kind": "close", "angle_deg": 60.0, "speed_deg_s": closing_speed_deg_s},
        *hold_phases,
    ]
    return simulate_grasp(
        hand,
        program_of_phases(phases),
        wall_scene_text,
        seed=seed,
        last_phase="end",
        timeout_s=12.0,
    )


def find_contacts(job: tuple[str, int]) -> list[float]:
    """Measure the delay of each digit's contact event [s], for a hand and a seed.

    The delay begins when the true force on the digit reaches 1 N. If the contact event comes before
    the force reaches 1 N, the delay is negative. If no contact event comes, the delay is inf.
    """
    hand, seed = job
    random_source = random.Random(f"wall {seed}")
    wall_scene_text = random_wall_scene(random_source)
    closing_speed_deg_s = random_source.uniform(*CLOSING_SPEEDS_DEG_S)
    hold_phase = {"kind": "hold", "tension_N": 20.0, "duration_s": 0.3}
    run = simulate_press_on_wall(hand, wall_scene_text, closing_speed_deg_s, [hold_phase], seed)
    return _detection_latencies(run, hand_model(hand)[0].hand.digit_names)


def _detection_latencies(run: GraspRun, digit_names: tuple[str, ...]) -> list[float]:
    contact_times = {
        event.where: float(run.t[k]) for k, event in run.events if event.name == "contact"
    }
    latencies = []
    for d, name in enumerate(digit_names):
        contact_ticks = np.flatnonzero(run.true_force[:, d] > CONTACT_FORCE_N)
        if name in contact_times:
            at = float(run.t[contact_ticks[0]]) if len(contact_ticks) else np.inf
            is_true_contact = (
                run.true_force[: np.searchsorted(run.t, contact_times[name]) + 1, d].max()
                > TRUE_CONTACT_FORCE_N
            )
            latencies += [max(contact_times[name] - at, -1.0)] if is_true_contact else []
        elif len(contact_ticks):
            latencies.append(np.inf)
    return latencies


def measure_false_contacts(job: tuple[str, float, int]) -> dict[str, float]:
    """Count the false contact events in free motion.

    The argument ``job`` contains the hand, the simulated time [s] and the seed. Return the number
    of false contact events, and the simulated time in which the digits moved [min].
    """
    hand, seconds, seed = job
    random_source = random.Random(f"free {seed}")
    phases: list[dict[str, Any]] = []
    planned_duration_s = 0.0
    while planned_duration_s < seconds:
        closing_speed_deg_s = random_source.uniform(*CLOSING_SPEEDS_DEG_S)
        limits = {"index": 15, "middle": 8, "ring": 15, "thumb": 3}
        start_angles = {name: random_source.uniform(0, limit) for name, limit in limits.items()}
        closed_angles = {"index": random_source.uniform(25, 50)}
        # Middle finger and thumb move in different phases, so that they do not touch each other.
        if random_source.random() < 0.6:
            closed_angles |= {
                "middle": random_source.uniform(12, 25),
                "ring": random_source.uniform(25, 50),
            }
        else:
            closed_angles |= {"thumb": random_source.uniform(15, 50)}
        phases += [
            {"kind": "move", "angle_deg": start_angles, "duration_s": 0.5},
            {"kind": "close", "angle_deg": closed_angles, "speed_deg_s": closing_speed_deg_s},
        ]
        planned_duration_s += 0.8 + 35.0 / closing_speed_deg_s * 1.875
    run = simulate_grasp(
        hand, program_of_phases(phases), None, seed=seed, last_phase="end", timeout_s=seconds
    )
    assert run.true_force.max() < TRUE_CONTACT_FORCE_N, "the digits touched each other"
    false_contact_count = sum(event.name == "contact" for _, event in run.events)
    motion_time_s = np.isin(run.phase, ("move", "close")).sum() * (run.t[1] - run.t[0])
    return {"minutes": float(motion_time_s) / 60.0, "alarms": false_contact_count}
