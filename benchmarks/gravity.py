"""Measure the benefit of gravity compensation for a hand that lies on its side.

Gravity causes joint torques only in a hand that lies on its side.

``python benchmarks/gravity.py [--json] [--seeds N] [--page]``. The packaged hands stand upright, so
gravity is parallel to the joint axes and causes no joint torque. In this benchmark, the hands lie
on their side, and the fingertips are ten times as heavy as in the hand files. The benchmark uses
two pairs of control laws, and compares the two control laws of each pair. The two control laws of a
pair differ only in gravity compensation. Both control laws of a pair move every digit as in the
tracking benchmark, and both have the same LQR weights.
"""

import argparse
import json
import math

import numpy as np
from trials import control_page, tracking
from trials.benchmark_hands import FINGERTIP_MASS_FACTOR, FREE_MOTION_SCENE, SIDEWAYS_HAND_SUFFIX
from trials.control_laws import GRAVITY_LAW_BY_NAME
from trials.job_runner import JobPlan, add_job_options, collect_results, job_plan_of
from trials.lockstep_trial import RATES_HZ, LockstepTrial, run_trial

TUNED_LAW_BY_NAME = dict(
    zip(
        GRAVITY_LAW_BY_NAME,
        ("+ gravity and springs",) * 2 + ("+ full computed torque",) * 2,
        strict=True,
    )
)
"""Dictionary from each control law of this benchmark to a law of the tracking benchmark.

A control law of this benchmark has the same LQR weights as its law of the tracking benchmark. The
tracking benchmark has selected the LQR weights so that the control loops keep their stability
margins.
"""
MEASURED_SPEEDS = ("slow", "fast")
FIGURE_LABELS = {"rmse_deg": "RMSE", "steady_deg": "steady"}


def run_gravity_trial(job: tuple) -> dict[str, dict[str, float]]:
    """Run one trial of gravity compensation and return its results for each speed.

    If the trial ended before the end of its motions, all results are NaN.
    """
    hand, law, seed = job
    gains = GRAVITY_LAW_BY_NAME[law].gains(
        *tracking.tuned_weights(hand, TUNED_LAW_BY_NAME[law], must_keep_margins=True),
        RATES_HZ[hand],
    )
    trial = LockstepTrial(
        hand + SIDEWAYS_HAND_SUFFIX,
        tracking.motion_script(MEASURED_SPEEDS),
        seed,
        FREE_MOTION_SCENE,
        None,
        gains,
        change_controller=GRAVITY_LAW_BY_NAME[law].change_controller,
    )
    record = run_trial(trial)
    if record.failure:
        return {speed: dict.fromkeys(FIGURE_LABELS, float("nan")) for speed in MEASURED_SPEEDS}
    return tracking.tracking_figures(record, MEASURED_SPEEDS)


def measure_gravity_compensation(seed_count: int, plan: JobPlan) -> dict:
    """Measure the tracking errors with and without gravity compensation, for each hand, control law and speed.

    Return the mean and the standard deviation of the tracking errors over the seeds.
    """
    jobs = [
        (hand, law, k)
        for hand in tracking.MEASURED_HANDS
        for law in GRAVITY_LAW_BY_NAME
        for k in range(seed_count)
    ]
    results = collect_results(run_gravity_trial, jobs, plan)
    result: dict = {}
    for hand in tracking.MEASURED_HANDS:
        for law in GRAVITY_LAW_BY_NAME:
            rows = [results[hand, law, k] for k in range(seed_count) if (hand, law, k) in results]
            result.setdefault(hand, {})[law] = {
                speed: {
                    name: _mean_over_seeds([row[speed][name] for row in rows])
                    for name in FIGURE_LABELS
                }
                for speed in MEASURED_SPEEDS
            }
    return result


def _mean_over_seeds(errors: list[float]) -> dict[str, float]:
    good_errors = [value for value in errors if np.isfinite(value)]
    mean, spread = (
        (float(np.mean(good_errors)), float(np.std(good_errors)))
        if good_errors
        else (float("nan"),) * 2
    )
    return {
        "mean": mean,
        "spread": spread,
        "seeds": len(errors),
        "ended": len(errors) - len(good_errors),
    }


def page_section(result: dict) -> str:
    """Return the page section on gravity compensation, as Markdown."""
    column_titles = [
        "hand, law",
        *(f"{speed}, {name} [deg]" for speed in MEASURED_SPEEDS for name in FIGURE_LABELS.values()),
        "seeds",
    ]
    rows = []
    for hand, laws in result.items():
        for law, speeds in laws.items():
            cells = [speeds[speed][name] for speed in MEASURED_SPEEDS for name in FIGURE_LABELS]
            texts = [f"{cell['mean']:.3f} ± {cell['spread']:.3f}" for cell in cells]
            ended_runs = cells[0]["ended"]
            rows.append(
                [
                    f"{hand}, {law}",
                    *texts,
                    f"{cells[0]['seeds']}" + (f" ({ended_runs} ended)" if ended_runs else ""),
                ]
            )
    seeds = max(
        speeds[MEASURED_SPEEDS[0]]["rmse_deg"]["seeds"]
        for laws in result.values()
        for speeds in laws.values()
    )
    return f"""## Gravity: a hand that lies on its side

`python benchmarks/gravity.py --seeds {seeds} --page` writes this section. The packaged hands stand upright: their
hinges are vertical, and gravity has no torque about them. The row "+ gravity and springs" of the tracking table
therefore shows the benefit of the springs only. In this section the hands lie on their side, and their fingertips are
{FINGERTIP_MASS_FACTOR:g} times as heavy (21 g on a finger). Gravity pulls the fingers closed and the thumb open.

Each pair of rows compares two control laws that differ in gravity compensation only. The feedback weights are those of
the table "weights that keep their margins" in the section on tracking, and the control laws have no force loop. The
error is the difference of the mean joint angle of a digit from its setpoint, measured in the plant. The columns
*steady* contain the largest steady error of all digits. All numbers are means over the seeds, with their spread.

{control_page.markdown_table(column_titles, rows)}

{_compensation_benefit_text(result)}
"""


def _compensation_benefit_text(result: dict) -> str:
    """Return a text that states how much gravity compensation reduces the RMSE for each hand, control law and speed."""
    hand_texts = []
    for hand, laws in result.items():
        names = list(laws)
        for without, compensated in zip(names[::2], names[1::2], strict=True):
            texts = [
                f"{speed} {_reduction_text(laws[without][speed], laws[compensated][speed])}"
                for speed in MEASURED_SPEEDS
            ]
            hand_texts.append(f"{hand}, {compensated}: {', '.join(texts)}")
    return (
        "Reduction of the RMSE by gravity compensation: "
        + "; ".join(hand_texts)
        + ". The control laws of the first pair of each hand do not compensate friction, so that the fingers "
        "lag behind "
        "their setpoint. Uncompensated gravity pulls the fingers in the direction of the motion, and reduces "
        "this lag."
    )


def _reduction_text(uncompensated_row: dict, compensated_row: dict) -> str:
    rmse_deg_before = uncompensated_row["rmse_deg"]
    rmse_deg_after = compensated_row["rmse_deg"]
    change = rmse_deg_before["mean"] - rmse_deg_after["mean"]
    spread = math.hypot(rmse_deg_before["spread"], rmse_deg_after["spread"])
    return f"{change:+.3f} ± {spread:.3f} deg" + (
        "" if abs(change) > spread else " (nothing beyond the spread)"
    )


def main() -> None:
    """Measure the benefit of gravity compensation, print the results, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument(
        "--seeds",
        type=int,
        default=10,
        help="number of runs, with other noise and drift (default: 10)",
    )
    add_job_options(parser)
    parser.add_argument(
        "--page", action="store_true", help="write the results into docs/evidence/control.md"
    )
    args = parser.parse_args()
    result = measure_gravity_compensation(args.seeds, job_plan_of(args))
    print(json.dumps(result, indent=2) if args.json else page_section(result))
    if args.page:
        control_page.write_page_part("gravity", page_section(result))


if __name__ == "__main__":
    main()
