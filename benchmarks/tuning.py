"""Measure how much tuning helps if the real hand differs from its hand file.

A simulated hand, the true plant, replaces the real hand. The parameters of the true plant differ
from the hand file by up to 30 %. The initial gains are wrong by a factor of 3. One search tries
gains on an ensemble of hands whose parameters are close to the hand file. Another search tries
gains on the true plant. With ``--fit``, an additional search tries gains on a hand with the
identified parameters. The best gains of each search are finally tried on the true plant.

The benchmark reports a cost ratio for each search that does not use the true plant. The cost of the
gains from this search is divided by the cost of the gains from the search on the true plant. The
ratio shows how much a search loses because it does not know the true parameters.

    python benchmarks/tuning.py [--quick] [--json] [--trials N] [--plants N] [--workers N]
    python benchmarks/tuning.py --trials 96 --into studies    # continues an interrupted run, or adds trials
    handctl identify --lockstep --perturb stiffness=0.7 friction=1.3 mass=1.3 spring=1.1 motor_inertia=0.7 damping=1.3
    python benchmarks/tuning.py --fit jamia.calibration.toml
"""

import argparse
import json
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from handctl.cli.tuning.tune_files import load_tuned_hand
from handctl.core.gains.gain_bounds import gains_with_values, values_by_key
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.hand.description import Hand
from handctl.session.run_plan import default_control_rate
from handctl.tune.loops.gain_design import linear_factors, worst_margins
from handctl.tune.scoring import GainScore, score_exercise
from handctl.tune.search.ensemble import sample_ensemble
from handctl.tune.search.gain_search import SearchPlan, SearchResult, run_search
from handctl.tune.search.workers import SearchWorkers, make_workers

TRUE_PLANT_FACTORS = {
    "stiffness": 0.7,
    "friction": 1.3,
    "mass": 1.3,
    "spring": 1.1,
    "motor_inertia": 0.7,
    "damping": 1.3,
}
"""Factors that multiply the parameters of the hand file to give the parameters of the true plant.

The factors were fixed before anything was tuned.
"""
DETUNING_FACTORS = {
    "motion.position_error_m": 3.0,
    "motion.speed_error_m_s": 1.0 / 3.0,
    "tension.tension_error_N": 1.0 / 3.0,
    "tension.speed_error_m_s": 3.0,
    "tension.integral_per_s": 3.0,
    "filter.motor_disturbance_N": 3.0,
}
"""Factors that multiply the packaged gains to give the initial gains.

The factors were fixed before anything was tuned.
"""
EVALUATION_SEED = 1000
"""Seed of the noise in the final comparison. No search uses this seed."""


def main() -> int:
    """Run all searches for gains, and print the comparison of the gains that they found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--quick", action="store_true", help="ten trials (about a minute)")
    parser.add_argument("--hand", default="jamia", help="packaged hand (default: jamia)")
    parser.add_argument(
        "--trials", type=int, default=48, help="number of trials of each search (default: 48)"
    )
    parser.add_argument(
        "--plants", type=int, default=3, help="number of plants in the ensemble (default: 3)"
    )
    parser.add_argument("--workers", type=int, default=2, help="number of processes (default: 2)")
    parser.add_argument(
        "--fit", type=Path, metavar="FILE", help="calibration that was identified on the real plant"
    )
    parser.add_argument(
        "--into",
        type=Path,
        metavar="DIR",
        help="folder of the studies: an interrupted search continues",
    )
    args = parser.parse_args()
    trials, plants = (10, 2) if args.quick else (args.trials, args.plants)
    result = compare_searches(args.hand, trials, plants, args.workers, args.into, args.fit)
    if args.json:
        print(json.dumps(result, indent=2))
    else:
        print_results(result)
    return 0


def detuned_gains() -> Gains:
    """Return the initial gains: the packaged gains times ``DETUNING_FACTORS``."""
    packaged = values_by_key(Gains())
    return gains_with_values(
        Gains(),
        {key: factor * packaged[key] for key, factor in DETUNING_FACTORS.items()},
        "benchmark",
    )


def compare_searches(
    hand_name: str,
    trial_count: int,
    plant_count: int,
    worker_count: int,
    study_folder: Path | None,
    calibration_file: Path | None,
) -> dict[str, Any]:
    """Run all searches and compare their best gains on the true plant.

    If ``study_folder`` is given, store the study (the trials and scores) of each search in this
    folder.
    """
    hand, identified_hand, spread = load_tuned_hand(hand_name, calibration_file)
    packaged = Gains()
    detuned = detuned_gains()
    rate = default_control_rate(hand)
    workers = make_workers(worker_count, None)
    try:
        with tempfile.TemporaryDirectory() as temporary_folder:
            folder = study_folder or Path(temporary_folder)
            folder.mkdir(parents=True, exist_ok=True)
            blind_plan = SearchPlan(
                hand.to_toml(),
                rate,
                detuned,
                sample_ensemble(plant_count, 0),
                1,
                trial_count,
                (packaged,),
            )
            informed_plan = SearchPlan(
                blind_plan.hand, rate, detuned, (TRUE_PLANT_FACTORS,), 1, trial_count, (packaged,)
            )
            blind_result, search_time_s = _run_timed_search(blind_plan, folder / "blind", workers)
            informed_result, _ = _run_timed_search(informed_plan, folder / "knowing", workers)
            identified_plan = SearchPlan(
                identified_hand.to_toml(),
                rate,
                detuned,
                sample_ensemble(plant_count, 0, spread),
                1,
                trial_count,
                (packaged,),
            )
            identified_result = (
                _run_timed_search(identified_plan, folder / "identified", workers)[0]
                if calibration_file
                else None
            )
        jobs = [
            _evaluation_job(informed_plan, gains)
            for gains in (
                detuned,
                packaged,
                _best_gains(detuned, blind_result),
                _best_gains(detuned, informed_result),
            )
        ]
        scores = [
            GainScore(**score)
            for _, score in sorted(workers.compute_scores(jobs), key=lambda pair: pair[0])
        ]
    finally:
        workers.close()
    names = ["detuned", "packaged", "tuned", "tuned_knowing_the_plant"]
    if identified_result:
        names.append("tuned_as_identified")
        scores.append(
            _with_model(
                hand,
                HandModel.from_hand(identified_hand, _best_gains(detuned, identified_result), rate),
            )
        )
    costs = [score.relative_cost(scores[0]) for score in scores]
    return {
        "hand": hand_name,
        "rate_hz": rate,
        "trials": trial_count,
        "plants": plant_count,
        "search_s": search_time_s,
        "on_the_real_plant": {
            name: {
                "cost": cost,
                **{key: getattr(score, key) for key in GainScore.__dataclass_fields__},
            }
            for name, cost, score in zip(names, costs, scores, strict=True)
        },
        "cost_of_not_knowing": costs[2] / costs[3],
        "cost_with_identification": costs[4] / costs[3] if identified_result else None,
    }


def _run_timed_search(
    plan: SearchPlan, study_file: Path, workers: SearchWorkers
) -> tuple[SearchResult, float]:
    start_time = time.monotonic()

    def print_progress(result: SearchResult) -> None:
        best = f"{result.relative_cost(result.best):.3f}" if result.best else "none good yet"
        print(
            f"\r{study_file.name}: trial {len(result.trials)} of {plan.trials}, best {best}   ",
            end="",
            file=sys.stderr,
        )

    result = run_search(plan, study_file, workers, print_progress)
    print(file=sys.stderr)
    return result, time.monotonic() - start_time


def _best_gains(initial_gains: Gains, result: SearchResult) -> Gains:
    if result.best is None:
        raise SystemExit("no trial kept its margins; expected more --trials")
    return (
        gains_with_values(initial_gains, result.best.values, "study")
        if result.best.number
        else initial_gains
    )


def _evaluation_job(plan: SearchPlan, gains: Gains) -> dict[str, Any]:
    """Return a job that scores gains on the true plant, even if their stability margins are too small.

    The seed of the simulated noise is ``EVALUATION_SEED``, which no search uses.
    """
    table = {
        "gains": gains.model_dump(by_alias=True),
        "seed": EVALUATION_SEED,
        "must_keep_margins": False,
    }
    return plan.trial_job(0, {}) | table


def _with_model(hand: Hand, model: HandModel) -> GainScore:
    """Score gains on the true plant, and compute their stability margins.

    The controller uses ``model``, which was made from the identified hand and the gains.
    """
    margins = worst_margins(model, (linear_factors(dict.fromkeys(TRUE_PLANT_FACTORS, 1.0)),))
    return replace(
        score_exercise(hand, model, TRUE_PLANT_FACTORS, EVALUATION_SEED),
        shortfall=margins.shortfall,
    )


def print_results(result: dict[str, Any]) -> None:
    print(
        f"{result['hand']} at {result['rate_hz']:g} Hz, {result['trials']} trials, judged on the real plant"
    )
    print(f"{'gains':<26}{'cost':>8}{'tracking':>12}{'tension':>10}{'effort':>12}{'margins':>10}")
    for name, row in result["on_the_real_plant"].items():
        margin_text = "kept" if row["shortfall"] <= 0 else f"-{100 * row['shortfall']:.0f} %"
        print(
            f"{name:<26}{row['cost']:>8.3f}{row['tracking_deg']:>8.2f} deg{row['tension_N']:>8.2f} N"
            f"{row['effort_Nm_per_s']:>6.1f} N m/s{margin_text:>10}"
        )
    print(
        f"cost of not knowing the plant: {result['cost_of_not_knowing']:.3f}; search: {result['search_s']:.0f} s"
    )
    if result["cost_with_identification"]:
        print(f"cost with the identified parameters: {result['cost_with_identification']:.3f}")


if __name__ == "__main__":
    sys.exit(main())
