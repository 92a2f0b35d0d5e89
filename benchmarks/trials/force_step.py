"""Measure a force step on a held object.

The three cases are: no force loop, a force loop with the raw load cell, and a force loop with the
estimated tension.

The digits close on a cylinder and hold the cylinder with 15 N per tendon. The commanded tension
steps to 40 N (at 5000 N/s) and back to 15 N. For every tendon of a digit in contact, the results
are computed from the true tension at the load cell.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from handctl.core.gains.gains import Gains, MotionGains, TensionGains
from handctl.document import validate_content
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from trials import simulated_plants
from trials.control_laws import controller_on_raw_tension, force_weight_factor
from trials.job_runner import JobPlan, collect_results
from trials.lockstep_trial import (
    RATES_HZ,
    LockstepTrial,
    TrialRecord,
    run_trial,
    unchanged_controller,
)
from trials.simulated_plants import PHASES_TO_CONTACT

LOW_TENSION_N = 15.0
HIGH_TENSION_N = 40.0
STEP_RATE_N_PER_S = 5000.0
HOLD_DURATION_S = 0.6
STEADY_S, BAND_N = 0.2, 2.0
"""Time at the end of a hold in which the steady error is measured [s], and largest error of a settled tension [N]."""
FORCE_TASK = {
    "schema": 1,
    "name": "force",
    "phase": [
        *PHASES_TO_CONTACT,
        {"kind": "hold", "name": "low", "tension_N": LOW_TENSION_N, "rate_N_per_s": 60.0, "duration_s": 1.0},
        {"kind": "hold", "name": "up", "tension_N": HIGH_TENSION_N, "rate_N_per_s": STEP_RATE_N_PER_S,
         "duration_s": HOLD_DURATION_S},
        {"kind": "hold", "name": "down", "tension_N": LOW_TENSION_N, "rate_N_per_s": STEP_RATE_N_PER_S,
         "duration_s": HOLD_DURATION_S},
    ],
}  # fmt: skip
FORCE_STEP_PLANTS = {
    plant: wrong_factors
    for plant, wrong_factors in simulated_plants.PLANT_FACTORS.items()
    if "mass" not in wrong_factors
}
"""Simulated hands of the force step.

Simulated hands with a wrong mass are left out, because the hand hardly moves during a force step.
"""
WEIGHT_N, FORCE_N, INTEGRAL_PER_S = 4.0, 15.0, 3.0
"""Gains of both force loops: a tension error [N] and a motor force [N] of equal LQR cost, and the integral gain [1/s].

The gains of the force loops were not tuned.
"""


@dataclass(frozen=True)
class ForceLoop:
    """Configuration of a force loop.

    ``motion_gains`` and ``tension_gains`` contain only the gains that differ from the default
    gains. The input of the force loop is either the raw load cell or the estimated tension.
    """

    motion_gains: dict[str, float] = field(default_factory=dict)
    tension_gains: dict[str, float] = field(default_factory=dict)
    with_raw_tension: bool = False


FORCE_LOOPS = {
    "set-point alone": ForceLoop(
        motion_gains={"disturbance_rejection": 0.0},
        tension_gains={
            "tension_error_N": 100.0,
            "speed_error_m_s": 10.0,
            "force_N": 0.01,
            "integral_per_s": 0.0,
        },
    ),
    "loop on the raw sensor": ForceLoop(with_raw_tension=True),
    "loop on the estimate": ForceLoop(),
}


def force_trial(hand_name: str, loop_name: str, seed: int, plant_name: str) -> LockstepTrial:
    """Return a force-step trial.

    The arguments are the hand, the force loop, the seed, and the name of a set of simulated
    parameters.
    """
    loop = FORCE_LOOPS[loop_name]
    fixed_gains = {
        "force_N": FORCE_N * force_weight_factor(RATES_HZ[hand_name]),
        "integral_per_s": INTEGRAL_PER_S,
        "tension_error_N": WEIGHT_N,
    }
    motion = {"disturbance_rejection": 1.0} | loop.motion_gains
    gains = Gains(
        motion=MotionGains(**motion), tension=TensionGains(**(fixed_gains | loop.tension_gains))
    )
    program = TaskProgram(validate_content(FORCE_TASK, Task, "benchmark"))
    return LockstepTrial(
        hand_name,
        program,
        seed,
        "cylinder",
        FORCE_STEP_PLANTS[plant_name],
        gains,
        change_controller=controller_on_raw_tension
        if loop.with_raw_tension
        else unchanged_controller,
    )


def force_figures(trial_record: TrialRecord) -> dict[str, float]:
    """Return the errors of the tension after the step up and after the step down, as means over the tendons.

    The results are overshoot [N], settling time [s], steady error [N], ripple [N], and RMSE [N].
    """
    tension = trial_record.true_tension()
    in_contact = trial_record.expand_to_tendons(trial_record.telemetry["contact"] > 0)
    rows: dict[str, list[float]] = {
        name: [] for name in ("overshoot_N", "settling_s", "steady_N", "ripple_N", "mse")
    }
    for phase, goal, change in (("up", HIGH_TENSION_N, 1.0), ("down", LOW_TENSION_N, -1.0)):
        mask = trial_record.phase == phase
        t = trial_record.times[mask] - trial_record.times[mask].min(initial=np.inf)
        for i in np.flatnonzero(in_contact[mask].all(axis=0)) if mask.any() else ():
            error = tension[mask, i] - goal
            steady_error = error[t > HOLD_DURATION_S - STEADY_S]
            rows["overshoot_N"].append(float((change * error).max()))
            rows["settling_s"].append(float(t[np.abs(error) > BAND_N].max(initial=0.0)))
            rows["steady_N"].append(float(abs(steady_error.mean())))
            rows["ripple_N"].append(float(steady_error.std()))
            rows["mse"].append(float((error**2).mean()))
    result = {
        name: float(np.mean(values)) if values else float("nan") for name, values in rows.items()
    }
    return result | {
        "rmse_N": float(np.sqrt(result.pop("mse"))),
        "tendons": float(len(rows["mse"])),
    }


def run_force_trial(job: tuple) -> dict[str, Any]:
    """Run one force-step trial and return the errors of the tension.

    If the trial ended early, the result includes the reason of the early end.
    """
    record = run_trial(force_trial(*job))
    return force_figures(record) | {"why": record.failure}


def measure_force(
    hand_names: tuple[str, ...], seed_count: int, mismatch_seed_count: int, plan: JobPlan
) -> dict[str, Any]:
    """Measure the errors of the tension for each hand, set of simulated parameters and force loop.

    Return the mean of each error over the seeds, and the standard deviation of the RMSE over the
    seeds.
    """
    cases = [
        (hand, law, plant)
        for plant in FORCE_STEP_PLANTS
        for hand in hand_names
        for law in FORCE_LOOPS
    ]
    counts = [seed_count if plant == "as known" else mismatch_seed_count for _, _, plant in cases]
    jobs = [
        (hand, law, k, plant)
        for k in range(max(seed_count, mismatch_seed_count))
        for (hand, law, plant), n in zip(cases, counts, strict=True)
        if k < n
    ]
    results = collect_results(run_force_trial, jobs, plan)
    result: dict[str, Any] = {"hands": {}}
    for hand, law, plant in cases:
        rows = [
            row for job, row in results.items() if (job[0], job[1], job[3]) == (hand, law, plant)
        ]
        if rows:
            result["hands"].setdefault(hand, {}).setdefault(plant, {})[law] = _mean_over_seeds(rows)
    return result


def _mean_over_seeds(rows: list[dict[str, Any]]) -> dict[str, Any]:
    good_rows = [row for row in rows if not row["why"] and np.isfinite(row["rmse_N"])]
    names = [name for name in rows[0] if name != "why"]
    mean = {
        name: float(np.mean([row[name] for row in good_rows])) if good_rows else float("nan")
        for name in names
    }
    rmse_sigma = float(np.std([row["rmse_N"] for row in good_rows])) if good_rows else float("nan")
    end_reasons = sorted({row["why"] for row in rows if row["why"]})
    return mean | {
        "rmse_spread_N": rmse_sigma,
        "seeds": len(rows),
        "ended": len(rows) - len(good_rows),
        "why": end_reasons,
    }
