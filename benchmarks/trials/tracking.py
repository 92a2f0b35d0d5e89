"""Measure the tracking error and the reaction to a force step, with more and more parts of the control law.

Each case of the benchmark uses one more part of the control law than the case before it.

``python benchmarks/control.py [--quick] [--json] [--seeds N] [--tune] [--keep FOLDER] [--page]``.
The digits move from 0 to 60 degrees. The tracking error is computed from the true mean of the joint
angles of a digit, because a single tendon can control only this mean. The simulation includes
capstan and motor friction, tendon elasticity and damping, the current loop, encoder and load-cell
resolution, noise, drift, and one period of bus delay. All control laws run with the same simulated
effects.

Each control law, including PD, has two LQR weights. For each control law, the benchmark selects the
pair of ``WEIGHT_CANDIDATES`` with the smallest error in a fast motion of the nominal hand. The
seeds of the measured trials differ from the seeds with which the LQR weights were selected.
``--tune`` repeats the selection of the LQR weights. With the selected LQR weights, the control
loops have hardly any stability margin. A second comparison uses the best LQR weights with
sufficient stability margins. Stability margins are sufficient if they are at least 6 dB and 45
degrees, also for random hands whose parameters are close to the hand file.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from handctl.core.hand_model import HandModel
from handctl.report.run_summary import mean_angles
from handctl.tune.loops.gain_design import keeps_required_margins, linear_factors
from handctl.tune.loops.linear_models import LoopKind
from handctl.tune.search.ensemble import sample_ensemble
from trials import control_page, force_page, force_step, tracking_page
from trials.benchmark_hands import FREE_MOTION_SCENE, SPACED_HAND_SUFFIX, hand_by_name
from trials.control_laws import COMPARED_LAW_BY_NAME
from trials.job_runner import JobPlan, add_job_options, collect_results, job_plan_of
from trials.lockstep_trial import RATES_HZ, LockstepTrial, TrialRecord, run_trial
from trials.script_program import ScriptProgram, ScriptStep
from trials.simulated_plants import PLANT_FACTORS

MEASURED_HANDS = ("jamia", "jamia11")
MOTION_DURATIONS_S = {"slow": 1.5, "medium": 0.5, "fast": 0.15}
"""Duration of a minimum-jerk motion of 60 degrees at each speed [s]."""
MOTION_ANGLE_DEG = 60.0
"""Angle at the end of a motion [deg]."""
SETTLING_TIME_S = 0.5
"""Time [s] for which the tracking error is allowed to settle after a motion."""
RETURN_DURATION_S = 0.5
"""Duration of the motion back to 0 degrees [s]."""
REST_DURATION_S = 0.2
"""Time at rest after the motion back to 0 degrees [s]."""
MOTION_EXTENSION_S = 0.05
"""Time [s] for which tracking errors after the end of a motion still count as errors of the motion."""
SETTLED_BAND_DEG = 1.0
"""Tracking error below which a motion counts as settled [deg]."""
WEIGHT_CANDIDATES = tuple(
    (p * 1e-4, v * 1e-2)
    for p, v in ((0.2, 1), (0.3, 1.5), (0.5, 2), (0.8, 2), (0.8, 3), (1.2, 3), (1.5, 2), (1.5, 3), (1.5, 6), (2.2, 3),
                 (3, 3), (3, 6), (6, 6), (8, 6), (10, 10), (14, 10))
)  # fmt: skip
"""Candidates for the two LQR weights of every control law.

A pair of LQR weights is given as two errors that have the same cost: a position error [m] and a
speed error [m/s].
"""
TUNING_SEED = 1000
TUNED_WEIGHTS_FILE = Path(__file__).with_name("tuned.json")
"""File with the results of ``--tune``, for each hand, control law and pair of ``WEIGHT_CANDIDATES``.

For each pair of LQR weights, the file contains the RMSE of the fast motion [deg], or null if the
fast motion did not reach its end. The file also states whether the motion loop keeps its stability
margins with the pair. Each run consists of a slow, a medium and a fast motion, because the best LQR
weights for a single motion can cause a fault in a run with all three motions.
"""
PD_LAW, SPRINGS_LAW, BEST_LAW, MISPRINTED_LAW = [
    list(COMPARED_LAW_BY_NAME)[i] for i in (0, 1, -2, -1)
]
COMPARED_LAWS = (PD_LAW, SPRINGS_LAW, BEST_LAW)
"""Control laws that the benchmark also tries on simulated hands whose parameters differ from the hand file."""
LAWS_WITH_MARGINS = (PD_LAW, SPRINGS_LAW, list(COMPARED_LAW_BY_NAME)[-4], BEST_LAW)
"""Control laws that the benchmark also tries with the best LQR weights that keep the stability margins."""
RANDOM_PLANT_COUNT = 8
"""Number of random hands on which LQR weights must keep the stability margins."""


def motion_script(speeds: tuple[str, ...]) -> ScriptProgram:
    """Return a script that moves all digits to the target angle and back, at each speed."""
    steps = []
    for speed in speeds:
        steps.append(
            ScriptStep(
                f"home {speed}",
                RETURN_DURATION_S + REST_DURATION_S,
                angle_deg=0.0,
                move_duration_s=RETURN_DURATION_S,
            )
        )
        steps.append(
            ScriptStep(
                speed,
                MOTION_DURATIONS_S[speed] + SETTLING_TIME_S,
                angle_deg=MOTION_ANGLE_DEG,
                move_duration_s=MOTION_DURATIONS_S[speed],
            )
        )
    return ScriptProgram(tuple(steps))


def tracking_trial(
    hand_name: str,
    law_name: str,
    lqr_weights: tuple[float, float],
    seed: int,
    plant_name: str,
    speeds: tuple[str, ...],
) -> LockstepTrial:
    """Return the tracking trial of a control law with two given LQR weights."""
    compared_law = COMPARED_LAW_BY_NAME[law_name]
    return LockstepTrial(
        hand_name + SPACED_HAND_SUFFIX,
        motion_script(speeds),
        seed,
        FREE_MOTION_SCENE,
        PLANT_FACTORS[plant_name],
        compared_law.gains(*lqr_weights, RATES_HZ[hand_name]),
        change_controller=compared_law.change_controller,
    )


def tracking_figures(
    trial_record: TrialRecord, speeds: tuple[str, ...]
) -> dict[str, dict[str, float]]:
    """Return the tracking results of each speed. Each result is the worst value of all digits.

    The results are RMSE, peak error and steady error of tracking [deg], and settling time [s].
    """
    goal = mean_angles(trial_record.hand, trial_record.telemetry["q_goal"])
    error = np.degrees(goal - mean_angles(trial_record.hand, trial_record.true_joint_angles()))
    result = {}
    for speed in speeds:
        mask = trial_record.phase == speed
        mask &= (
            trial_record.times
            <= trial_record.times[mask].min(initial=np.inf)
            + MOTION_DURATIONS_S[speed]
            + SETTLING_TIME_S
        )
        if not mask.any():
            result[speed] = dict.fromkeys(
                ("rmse_deg", "peak_deg", "steady_deg", "settling_s"), float("nan")
            )
            continue
        t = trial_record.times[mask] - trial_record.times[mask][0]
        e = error[mask]
        moving = t <= MOTION_DURATIONS_S[speed] + MOTION_EXTENSION_S
        time_after_motion = t - MOTION_DURATIONS_S[speed]
        unsettled_times = np.where(
            np.abs(e) > SETTLED_BAND_DEG, np.maximum(time_after_motion, 0.0)[:, None], 0.0
        )
        result[speed] = {
            "rmse_deg": float(np.sqrt((e[moving] ** 2).mean())),
            "peak_deg": float(np.abs(e[moving]).max()),
            "steady_deg": float(
                np.abs(e[time_after_motion > SETTLING_TIME_S - 0.15].mean(axis=0)).max()
            ),
            "settling_s": float(unsettled_times.max()),
        }
    return result


def run_tracking_trial(job: tuple) -> dict[str, dict[str, float | str]]:
    """Run one trial and return its tracking errors.

    For a motion that did not reach its end, all errors are inf, and the result includes the reason
    of the early end.
    """
    record = run_trial(tracking_trial(*job))
    result: dict = tracking_figures(record, job[-1])
    for speed in job[-1] if record.failure else ():
        phase_duration_s = (record.phase == speed).sum() * record.controller.model.period
        if phase_duration_s < MOTION_DURATIONS_S[speed] + SETTLING_TIME_S - 0.01:
            result[speed] = dict.fromkeys(result[speed], float("inf")) | {"why": record.failure}
    return result


def tune_weights(plan: JobPlan) -> None:
    """Try all ``WEIGHT_CANDIDATES`` for each control law on each hand.

    Each candidate is a pair of LQR weights. For each candidate, print the tracking error of the
    fast motion, and whether the control loop keeps the required stability margins. After the last
    trial, write errors and weights into ``TUNED_WEIGHTS_FILE``.
    """
    jobs = [
        (h, law, w, TUNING_SEED, "as known", tuple(MOTION_DURATIONS_S))
        for h in MEASURED_HANDS
        for law in COMPARED_LAW_BY_NAME
        for w in WEIGHT_CANDIDATES
    ]
    results = collect_results(run_tracking_trial, jobs, plan)
    tuning_result: dict = {"rmse_deg": {}, "keeps_margins": {}}
    for (hand, law, weights, *_), rows in results.items():
        error = rows["fast"]["rmse_deg"]
        has_margins = has_required_margins(hand, law, weights)
        reason = rows["fast"].get("why", "")
        print(
            f"{hand:<8} {law:<32} {weights!s:<18} {error:8.3f} deg  {'keeps margins' if has_margins else ''} {reason}"
        )
        tuning_result["rmse_deg"].setdefault(hand, {}).setdefault(law, []).append(
            round(error, 4) if np.isfinite(error) else None
        )
        tuning_result["keeps_margins"].setdefault(hand, {}).setdefault(law, []).append(has_margins)
    if len(results) == len(jobs):
        TUNED_WEIGHTS_FILE.write_text(json.dumps(tuning_result, indent=1) + "\n", "utf-8")


def has_required_margins(hand_name: str, law_name: str, lqr_weights: tuple[float, float]) -> bool:
    """Return True if every motion loop has stability margins of 6 dB and 45 degrees.

    The motion loops are tested with random hands whose parameters are close to the hand file.
    """
    model = HandModel.from_hand(
        hand_by_name(hand_name),
        COMPARED_LAW_BY_NAME[law_name].gains(*lqr_weights, RATES_HZ[hand_name]),
        RATES_HZ[hand_name],
    )
    plants = tuple(
        linear_factors(parameter_factors)
        for parameter_factors in sample_ensemble(RANDOM_PLANT_COUNT, 0)
    )
    return keeps_required_margins(model, plants, (LoopKind.MOTION,))


def tuned_weights(
    hand_name: str, law_name: str, must_keep_margins: bool = False
) -> tuple[float, float]:
    """Return the best LQR weights of a control law.

    If ``must_keep_margins`` is True, only weights that keep the stability margins are considered.
    If no pair of weights can be considered, the result is a pair of ``WEIGHT_CANDIDATES``: the last
    pair if ``must_keep_margins`` is True, and the first pair otherwise.
    """
    tuning_result = json.loads(TUNED_WEIGHTS_FILE.read_text("utf-8"))
    errors = tuning_result["rmse_deg"][hand_name][law_name]
    keeps_margins = tuning_result["keeps_margins"][hand_name][law_name]
    usable_weights = [
        i
        for i, error in enumerate(errors)
        if error is not None and (keeps_margins[i] or not must_keep_margins)
    ]
    return WEIGHT_CANDIDATES[
        min(
            usable_weights,
            key=errors.__getitem__,
            default=len(WEIGHT_CANDIDATES) - 1 if must_keep_margins else 0,
        )
    ]


def measure_tracking(
    seed_count: int,
    mismatch_seed_count: int,
    speeds: tuple[str, ...],
    plan: JobPlan,
    hand_names: tuple[str, ...] = MEASURED_HANDS,
) -> dict:
    """Measure the tracking errors for as many seeds as the time limit of ``plan`` permits.

    Return the mean and the standard deviation of the tracking errors over the seeds.
    """
    cases = [(hand, law, "as known", False) for hand in hand_names for law in COMPARED_LAW_BY_NAME]
    cases += [(hand, law, "as known", True) for hand in hand_names for law in LAWS_WITH_MARGINS]
    for plant in list(PLANT_FACTORS)[1:] if mismatch_seed_count else []:
        cases += [(hand, law, plant, True) for hand in hand_names for law in COMPARED_LAWS]
    counts = [seed_count if case[2] == "as known" else mismatch_seed_count for case in cases]

    def job(case: tuple[str, str, str, bool], seed: int) -> tuple:
        hand, law, plant, keeps_margins = case
        return hand, law, tuned_weights(hand, law, keeps_margins), seed, plant, speeds

    jobs = [
        job(case, k)
        for k in range(max(counts))
        for case, n in zip(cases, counts, strict=True)
        if k < n
    ]
    results = collect_results(run_tracking_trial, list(dict.fromkeys(jobs)), plan)
    result: dict = {
        "weights": {
            hand: {law: tuned_weights(hand, law) for law in COMPARED_LAW_BY_NAME}
            for hand in hand_names
        },
        "careful weights": {
            hand: {law: tuned_weights(hand, law, True) for law in LAWS_WITH_MARGINS}
            for hand in hand_names
        },
        "hands": {},
        "careful": {},
    }
    for case, n in zip(cases, counts, strict=True):
        hand, law, plant, keeps_margins = case
        rows = [results[job(case, k)] for k in range(n) if job(case, k) in results]
        if rows:
            hand_rows = (
                result["careful" if keeps_margins else "hands"]
                .setdefault(hand, {})
                .setdefault(plant, {})
            )
            hand_rows[law] = {
                speed: _mean_over_seeds([row[speed] for row in rows]) for speed in rows[0]
            }
    return result


def _mean_over_seeds(run_rows: list[dict]) -> dict:
    """Return the mean of each error and the standard deviation of the RMSE, over the runs that reached their end.

    The returned dictionary also contains the number of runs that ended early, and the reasons of
    their early ends.
    """
    end_reasons = sorted({row["why"] for row in run_rows if "why" in row})
    good_run_rows = [row for row in run_rows if np.isfinite(row["rmse_deg"])]
    names = [name for name in run_rows[0] if name != "why"]
    mean = {
        name: float(np.mean([row[name] for row in good_run_rows]))
        if good_run_rows
        else float("inf")
        for name in names
    }
    rmse_sigma = (
        float(np.std([row["rmse_deg"] for row in good_run_rows])) if good_run_rows else float("nan")
    )
    return mean | {
        "rmse_spread_deg": rmse_sigma,
        "seeds": len(run_rows),
        "ended": len(run_rows) - len(good_run_rows),
        "why": end_reasons,
    }


def print_results(result: dict) -> None:
    """Print the results of tracking and of the force step as text."""
    if "force" in result:
        print(force_page.page_section(result["force"]))
    if "tracking" not in result:
        return
    print(
        "tracking of the mean joint angle, RMSE +- spread over the seeds / peak / steady [deg], settling [s]"
    )
    rows_without_margins = [
        (hand, *plant_and_value)
        for hand, plants in result["tracking"]["hands"].items()
        for plant_and_value in plants.items()
    ]
    rows_with_margins = [
        (hand, *plant_and_value)
        for hand, plants in result["tracking"]["careful"].items()
        for plant_and_value in plants.items()
    ]
    for weights, rows in (
        ("best weights", rows_without_margins),
        ("weights that keep their margins", rows_with_margins),
    ):
        for hand, plant, laws in rows:
            print(f"\n{hand}, plant {plant}, {weights}")
            for law, speeds in laws.items():
                texts = [
                    f"{speed} {r['rmse_deg']:.3f} +- {r['rmse_spread_deg']:.3f} / {r['peak_deg']:.2f} / "
                    f"{r['steady_deg']:.2f}, {r['settling_s']:.2f}"
                    for speed, r in speeds.items()
                ]
                end_reasons = sorted({reason for r in speeds.values() for reason in r["why"]})
                print(f"  {law:<32}" + "   ".join(texts + end_reasons))


def main() -> None:
    """Measure the tracking errors and the force steps in all cases, and print the results.

    With the option ``--tune`` or ``--page``, also write the LQR weights or the page.
    """
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="one seed, fast motion, one hand (less than a minute)"
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
    parser.add_argument(
        "--parts",
        default="tracking,force",
        help="parts of the benchmark, separated by commas (default: %(default)s)",
    )
    parser.add_argument(
        "--tune", action="store_true", help="search the weights of the control laws again"
    )
    add_job_options(parser)
    parser.add_argument(
        "--page", action="store_true", help="write the results into docs/evidence/control.md"
    )
    args = parser.parse_args()
    start = time.monotonic()
    plan = job_plan_of(args)
    result = {}
    if args.tune:
        tune_weights(plan)
        return
    if "tracking" in args.parts:
        counts = (
            (1, 0, ("fast",))
            if args.quick
            else (args.seeds, args.wrong_seeds, tuple(MOTION_DURATIONS_S))
        )
        result["tracking"] = measure_tracking(
            *counts, plan, MEASURED_HANDS[:1] if args.quick else MEASURED_HANDS
        )
    if "force" in args.parts and not args.quick:
        result["force"] = force_step.measure_force(
            MEASURED_HANDS, args.seeds, args.wrong_seeds, plan
        )
    result["wall_s"] = time.monotonic() - start
    print(json.dumps(result, indent=2)) if args.json else print_results(result)
    if args.page and "tracking" in result:
        control_page.write_page_part(
            "tracking",
            tracking_page.page_section(
                result["tracking"], (PD_LAW, SPRINGS_LAW, BEST_LAW, MISPRINTED_LAW)
            ),
        )
        tracking_page.draw_picture(result["tracking"])
    if args.page and "force" in result:
        control_page.write_page_part("force", force_page.page_section(result["force"]))
