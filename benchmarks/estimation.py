"""Measure the error of the tension estimate, and compare it with the errors of other estimators.

The other estimators are the raw load cell, simpler filters, and a reference filter.

``python benchmarks/estimation.py [--quick] [--json] [--seeds N] [--keep FOLDER] [--page]``. Two
simulated hands move freely, grasp a cylinder and slacken their tendons. The controller and the
simulated hands run in lockstep over a simulated bus. The stiffness of a tendon changes at one
tension, the knee. The hand `jamia_bench` also holds an object with tensions above the knee. The
simulation includes capstan and motor friction, tendon damping, the current loop, encoder and
load-cell resolution, noise, drift, and one period of bus delay. The factors in this module change
parameters of the simulated hand. The controller does not know the factors that change the simulated
hand. A load-cell reading is one control period old when the filter receives it. The benchmark
compares the filter and the raw load cell with the true tension at the time of the reading, and with
the present true tension. The control loop uses the estimate of the present tension.
"""

import argparse
import json
import time
from functools import cache

import numpy as np
from trials import control_page, estimation_page
from trials.alternative_filters import (
    AVERAGE_WEIGHTS,
    TENSION_RATE_NOISES,
    cell_only_estimate,
    exponential_average,
)
from trials.benchmark_hands import FREE_MOTION_SCENE, SPACED_HAND_SUFFIX, hand_by_name
from trials.job_runner import JobPlan, add_job_options, collect_results, job_plan_of
from trials.lockstep_trial import RATES_HZ, LockstepTrial, TrialRecord, run_trial
from trials.reference_filter import CELL_DRIFT_VARIANCE_N2_PER_S, reference_sigma
from trials.script_program import ScriptProgram, ScriptStep
from trials.simulated_plants import FURTHER_PLANT_FACTORS, PHASES_TO_CONTACT, PLANT_FACTORS
from trials.tendon_regimes import REGIME_NAMES, regime_masks

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.document import validate_content
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram

MEASURED_HANDS = ("jamia", "jamia11")
PLANT_VARIATIONS = PLANT_FACTORS | FURTHER_PLANT_FACTORS
MOTION_SCRIPT = ScriptProgram(
    (
        ScriptStep("slow", 1.0, angle_deg=30.0, move_duration_s=0.8),
        ScriptStep("medium", 0.5, angle_deg=55.0, move_duration_s=0.3),
        ScriptStep("back", 0.3, angle_deg=20.0, move_duration_s=0.25),
        ScriptStep("and again", 0.3, angle_deg=45.0, move_duration_s=0.2),
        ScriptStep("open", 0.5, angle_deg=5.0, move_duration_s=0.3),
        ScriptStep("let go", 0.4, tension_N=0.0, rate_N_per_s=100.0),
        ScriptStep("take up", 0.4, tension_N=6.0, rate_N_per_s=60.0),
    )
)
GRASP_TASK = {
    "schema": 1,
    "name": "estimation",
    "phase": [
        *PHASES_TO_CONTACT,
        {"kind": "hold", "name": "hold", "tension_N": 30.0, "rate_N_per_s": 60.0, "duration_s": 1.5},
        {"kind": "release", "name": "release", "tension_N": 9.0, "rate_N_per_s": 100.0},
    ],
}  # fmt: skip
STRONG_GRASP_TASK = {
    **GRASP_TASK,
    "name": "beyond the knee",
    "phase": [
        *PHASES_TO_CONTACT,
        {"kind": "hold", "name": "hold", "tension_N": 180.0, "rate_N_per_s": 200.0, "duration_s": 1.2},
        {"kind": "hold", "name": "strong", "tension_N": 232.0, "rate_N_per_s": 100.0, "duration_s": 1.2},
        {"kind": "hold", "name": "less", "tension_N": 160.0, "rate_N_per_s": 200.0, "duration_s": 0.6},
    ],
}  # fmt: skip
SCENE_NAME = "cylinder"
ESTIMATOR_NAMES = ("filtered", "raw", "estimate", "raw now", "average", "cell alone")


RATIO_COLUMNS = (
    ("filtered", "limit"),
    ("filtered", "raw"),
    ("estimate", "limit now"),
    ("estimate", "raw now"),
    ("estimate", "limit"),
    ("estimate", "raw"),
)


def trials_of_seed(hand_name: str, plant_name: str, seed: int) -> list[LockstepTrial]:
    """Return the trials of one hand for one seed and one set of simulated parameters."""
    if hand_name == "jamia_bench":
        return [
            LockstepTrial(
                hand_name,
                _task_program(STRONG_GRASP_TASK),
                seed,
                SCENE_NAME,
                PLANT_VARIATIONS[plant_name],
            )
        ]
    free_motion_trial = LockstepTrial(
        hand_name + SPACED_HAND_SUFFIX,
        MOTION_SCRIPT,
        seed,
        FREE_MOTION_SCENE,
        PLANT_VARIATIONS[plant_name],
    )
    return [
        free_motion_trial,
        LockstepTrial(
            hand_name, _task_program(GRASP_TASK), seed, SCENE_NAME, PLANT_VARIATIONS[plant_name]
        ),
    ]


def _task_program(task_content: dict) -> TaskProgram:
    return TaskProgram(validate_content(task_content, Task, "benchmark"))


def squared_error_sums(job: tuple[str, str, int]) -> dict[str, dict[str, list[float]]]:
    """Sum the squared errors of each estimator over the trials of one seed, for each tendon regime.

    The errors of the reference filter are included.
    """
    sums: dict[str, dict[str, list[float]]] = {}
    for trial in trials_of_seed(*job):
        record = run_trial(trial)
        if record.failure:
            sums.setdefault("ended", {}).setdefault(record.failure, []).extend((1.0, 1.0))
        for regime, mask in regime_masks(record).items():
            if mask.any():
                row = sums.setdefault(regime, {})
                for name, values in _squared_quantities(record, regime).items():
                    row.setdefault(name, []).extend(_sum_and_count(values, mask))
    return sums


def _sum_and_count(values: np.ndarray, is_selected: np.ndarray) -> list[float]:
    """Return the sum and the number of the values that ``is_selected`` selects.

    NaN values are neither summed nor counted.
    """
    values_in_regime = values[is_selected]
    values_in_regime = values_in_regime[~np.isnan(values_in_regime)]
    return [float(values_in_regime.sum()), float(len(values_in_regime))]


def _squared_quantities(record: TrialRecord, regime: str) -> dict[str, np.ndarray]:
    """Return the squared errors and further quantities for a tendon regime, each as an array (ticks, tendons).

    The quantities are the squared error of each estimator, the variance of the reference filter
    [N^2], the NIS, and the innovations.
    """
    telemetry = record.telemetry
    period_ns = int(record.t_ns[1] - record.t_ns[0])
    true_tension = record.true_tension()
    tension_before = record.true_tension(period_ns)
    raw_tension = telemetry["tension_raw"]
    period = period_ns * 1e-9
    model = record.controller.model
    result = {
        "filtered": record.filtered_tension - tension_before,
        "raw": raw_tension - tension_before,
    }
    result |= {
        "estimate": telemetry["tension"] - true_tension,
        "raw now": raw_tension - true_tension,
    }
    result |= {
        f"average {w:g}": exponential_average(raw_tension, float(w)) - true_tension
        for w in AVERAGE_WEIGHTS
    }
    noise = float(model.tendon_constants.tension_noise[0])
    result |= {
        f"cell alone {r:g}": cell_only_estimate(raw_tension, period, noise, float(r)) - true_tension
        for r in TENSION_RATE_NOISES
    }
    squared_errors = {name: error**2 for name, error in result.items()}
    drift = CELL_DRIFT_VARIANCE_N2_PER_S * record.times[:, None]
    sigma_with_settled_bias, sigma_now = _reference_sigmas(
        record.hand.name, regime in ("hold", "beyond 200 N")
    ).T
    squared_errors |= {
        "limit": drift + np.square(sigma_with_settled_bias),
        "limit now": drift + np.square(sigma_now),
    }
    squared_errors["sigma"] = telemetry["tension_sigma"] ** 2
    squared_errors["nis"] = telemetry["nis"] / 2.0
    scaled_innovation = telemetry["innovation"]
    squared_errors["innovation"] = scaled_innovation**2
    squared_errors["innovation lag 1"] = np.vstack(
        (scaled_innovation[:1] * np.nan, scaled_innovation[1:] * scaled_innovation[:-1])
    )
    return squared_errors


@cache
def _reference_sigmas(hand_name: str, is_digit_held: bool) -> np.ndarray:
    """Return the standard deviation of the reference filter for each tendon, at two times (tendons, 2) [N].

    The first column is the standard deviation of the tension at the time of the last load-cell
    reading. The second column is the standard deviation of the present tension.
    """
    name = hand_name.removesuffix(SPACED_HAND_SUFFIX)
    model = HandModel.from_hand(hand_by_name(name), Gains(), RATES_HZ[name])
    return np.array([reference_sigma(model, i, is_digit_held) for i in range(model.tendon_count)])


def tabulate_regimes(results: list[dict]) -> dict[str, dict[str, float]]:
    """Make a table of the results for each tendon regime.

    The columns are the RMSE of each estimator [N], ratios of RMSEs, the NIS, and the whiteness of
    the innovations. Another column shows how much the RMSE of the tension estimate varies from seed
    to seed (standard deviation [N]).
    """
    table = {}
    for regime in REGIME_NAMES:
        seeds = [_means_of_quantities(sums[regime]) for sums in results if regime in sums]
        if not seeds:
            continue
        mean = {
            name: float(np.sqrt(np.mean([row[name] for row in seeds])))
            for name in seeds[0]
            if "lag" not in name
        }
        best = {
            column: min(
                (name for name in mean if name.startswith(f"{column} ")), key=mean.__getitem__
            )
            for column in ESTIMATOR_NAMES[4:]
        }
        row = {column: mean[best.get(column, column)] for column in ESTIMATOR_NAMES} | {
            "limit": mean["limit"],
            "limit now": mean["limit now"],
            "sigma": mean["sigma"],
        }
        row["estimate spread"] = float(np.std([np.sqrt(row["estimate"]) for row in seeds]))
        row |= {"best weight": float(best["average"].split()[1]), "nis": mean["nis"] ** 2}
        row["whiteness"] = float(
            np.mean([row["innovation lag 1"] for row in seeds])
            / np.mean([row["innovation"] for row in seeds])
        )
        row |= {
            f"{column} / {compared_estimator}": row[column] / row[compared_estimator]
            for column, compared_estimator in RATIO_COLUMNS
        }
        table[regime] = row
    return table


def _means_of_quantities(sums: dict[str, list[float]]) -> dict[str, float]:
    """Return the mean of each quantity.

    Each list in ``sums`` contains pairs of numbers: a sum of values, and the number of these
    values.
    """
    return {
        name: sum(sums_and_counts[::2]) / max(sum(sums_and_counts[1::2]), 1.0)
        for name, sums_and_counts in sums.items()
    }


def measure_estimators(
    seed_count: int, mismatch_seed_count: int, plant_names: list[str], plan: JobPlan
) -> dict:
    """Measure the errors of the tension estimators, and return the tables of all hands and simulated plants.

    The entry ``seeds`` of the result states how many seeds of each case were computed before the
    time limit of ``plan``.
    """
    cases = [(hand, plant) for plant in plant_names for hand in MEASURED_HANDS]
    cases.insert(len(MEASURED_HANDS), ("jamia_bench", "as known"))
    counts = [seed_count if case[1] == "as known" else mismatch_seed_count for case in cases]
    # Sort the jobs by seed, so that a benchmark that is stopped early has results for the same
    # number of seeds in each case.
    jobs = [
        (*case, k)
        for k in range(max(counts))
        for case, n in zip(cases, counts, strict=True)
        if k < n
    ]
    results = collect_results(squared_error_sums, jobs, plan)
    tables: dict = {"seeds": {}, "hands": {}, "ended": []}
    for case in cases:
        case_sums = {job: sums for job, sums in results.items() if job[:2] == case}
        tables["ended"] += [
            f"{job}: {reason}"
            for job, sums in case_sums.items()
            for reason in sums.pop("ended", {})
        ]
        if case_sums:
            tables["hands"].setdefault(case[0], {})[case[1]] = tabulate_regimes(
                list(case_sums.values())
            )
            tables["seeds"][", ".join(case)] = len(case_sums)
    return tables


def print_results(result: dict) -> None:
    """Print the tables of the tension estimators as text."""
    columns = (
        *ESTIMATOR_NAMES,
        "limit",
        "limit now",
        *(f"{estimator} / {compared_estimator}" for estimator, compared_estimator in RATIO_COLUMNS),
        "nis",
        "whiteness",
    )
    print(f"RMSE of tension [N], {result['seeds']} seeds; ended early: {result['ended'] or 'none'}")
    for hand, plants in result["hands"].items():
        for plant, table in plants.items():
            print(
                f"\n{hand}, plant {plant}\n{'':14}"
                + "".join(
                    f"{name.replace('estimate', 'now').replace('filtered', 'then'):>12.11}"
                    for name in columns
                )
            )
            for regime, row in table.items():
                print(f"{regime:<14}" + "".join(f"{row[name]:12.3f}" for name in columns))


def main() -> None:
    """Measure the errors of the tension estimators in all cases, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="one seed, changed stiffness only (less than a minute)"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument(
        "--seeds",
        type=int,
        default=10,
        help="number of runs with the plant of the hand file (default: 10)",
    )
    parser.add_argument(
        "--wrong-seeds",
        type=int,
        default=10,
        help="number of runs with each changed plant (default: 10)",
    )
    add_job_options(parser)
    parser.add_argument(
        "--stiffness", action="store_true", help="change only the stiffness of the plants"
    )
    parser.add_argument(
        "--page", action="store_true", help="write the results into docs/evidence/control.md"
    )
    args = parser.parse_args()
    start = time.monotonic()
    plants = list(PLANT_VARIATIONS)[:3] if args.quick or args.stiffness else list(PLANT_VARIATIONS)
    counts = (1, 1, plants) if args.quick else (args.seeds, args.wrong_seeds, plants)
    result = measure_estimators(*counts, job_plan_of(args))
    result["wall_s"] = time.monotonic() - start
    print(json.dumps(result, indent=2)) if args.json else print_results(result)
    if args.page:
        control_page.write_page_part("estimation", estimation_page.page_section(result))
        estimation_page.draw_picture(result)


if __name__ == "__main__":
    main()
