"""Measure how accurately ``handctl identify`` finds the true parameters of simulated hands.

Each seed gives a random hand, whose parameters differ from the hand file by up to 30 %. The gains
of the controller differ from the packaged gains by up to a factor of 3. A digit without springs is
moved with the packaged gains. The moment arms of a digit without springs differ from the hand file
by up to 10 %. One digit of the hand is moved in lockstep, and the parameters of this digit are
fitted to the log. The true parameters are used only to evaluate the fit. From the true parameters,
the benchmark computes the errors of the fit, and whether each confidence interval contains the true
value.

    python benchmarks/identify.py                                  # four seeds
    python benchmarks/identify.py --seeds 100 --into rows.jsonl    # continues an interrupted run
    python benchmarks/identify.py --hand orca_like --seeds 20      # spool pairs without load cells
"""

import argparse
import json
import math
import random
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from handctl.core.gains.gain_bounds import gains_with_values
from handctl.core.gains.gains import Gains, packaged_gains
from handctl.core.identified_parameters import DIGIT_KEY_BY_PARAMETER
from handctl.hand.description import Hand
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.excitation import ExciteProgram
from handctl.runtime.hold_timeout import HoldTimeout
from handctl.session.lockstep_simulation import SimulatorSettings
from handctl.session.run import make_controller, run_lockstep
from handctl.session.run_plan import RunPlan, default_control_rate
from handctl.tune.identify.excitation import excitation_steps
from handctl.tune.identify.identify import TendonResult, identify_tendons

FitResultRow = dict[str, Any]

MAX_PARAMETER_ERROR = 0.3
MAX_ARM_ERROR = 0.1
MAX_GAIN_FACTOR = 3.0
RANDOM_PARAMETERS = (
    "stiffness",
    "damping",
    "friction",
    "mass",
    "spring",
    "motor_inertia",
    "torque_constant",
)
PARAMETER_TOLERANCES = {
    "tendon_stiffness": 0.05, "spring_stiffness": 0.05, "motor_inertia": 0.05,
    "motor_coulomb": 0.15, "motor_viscous": 0.15, "capstan": 0.15, "torque_gain": 0.05,
    "moment_arm": 0.01, "pretension": 0.15,
}  # fmt: skip
"""Required accuracy of each identified parameter, as a fraction of the true value."""
DETUNED_GAIN_KEYS = ("motion.position_error_m", "motion.speed_error_m_s", "motion.force_N", "tension.tension_error_N",
             "tension.speed_error_m_s", "tension.force_N", "tension.integral_per_s")  # fmt: skip


def gains_of_digit(hand: Hand, digit_name: str, seed: int) -> Gains:
    """Return random gains for a digit with springs, and the packaged gains for a digit without springs."""
    packaged = packaged_gains(hand.name)
    return draw_gains(packaged, seed) if hand.digit_named(digit_name).has_springs else packaged


def draw_plant(seed: int, with_springs: bool = True) -> dict[str, float]:
    """Draw random factors that multiply the parameters of a simulated hand.

    For digits without springs, also draw a factor that multiplies the moment arms.
    """
    random_source = random.Random(f"plant {seed}")
    factors = {
        key: random_source.uniform(1.0 - MAX_PARAMETER_ERROR, 1.0 + MAX_PARAMETER_ERROR)
        for key in RANDOM_PARAMETERS
    }
    return (
        factors
        if with_springs
        else factors
        | {"moment_arm": random_source.uniform(1.0 - MAX_ARM_ERROR, 1.0 + MAX_ARM_ERROR)}
    )


def draw_gains(packaged_gains: Gains, seed: int) -> Gains:
    """Draw random gains, which differ from the packaged gains by up to a factor of 3."""
    random_source = random.Random(f"gains {seed}")
    values = {}
    for key in DETUNED_GAIN_KEYS:
        section, _, name = key.partition(".")
        values[key] = getattr(
            getattr(packaged_gains, section), name
        ) * MAX_GAIN_FACTOR ** random_source.uniform(-1.0, 1.0)
    return gains_with_values(packaged_gains, values, "detuned")


def true_parameters(
    hand: Hand, tendon_name: str, plant_factors: dict[str, float]
) -> dict[str, float]:
    """Return the true values of the parameters that the identification of a tendon estimates."""
    tendon = hand.tendon[hand.tendon_names.index(tendon_name)]
    motor = hand.motor_of_tendon(tendon_name)
    # Without load cells, all forces are identified only relative to the commanded torque.
    unit = 1.0 if tendon.pretension_N is None else plant_factors["torque_constant"]
    values = {
        "tendon_stiffness": tendon.stiffness_N_per_m * plant_factors["stiffness"] / unit,
        "motor_inertia": motor.inertia_kg_m2 * plant_factors["motor_inertia"] / unit,
        "motor_coulomb": motor.coulomb_N_m * plant_factors["friction"] / unit,
        "motor_viscous": motor.viscous_N_m_s_per_rad * plant_factors["damping"] / unit,
        "capstan": tendon.friction_coefficient * plant_factors["friction"],
    }
    if tendon.pretension_N is None:
        values["torque_gain"] = plant_factors["torque_constant"]
    else:
        values["pretension"] = tendon.pretension_N / unit
    # A digit without springs has no spring stiffness to identify. The fit estimates the moment arms
    # of the digit instead of the spring stiffness.
    name = "moment_arm" if "moment_arm" in plant_factors else "spring_stiffness"
    return values | {
        name: plant_factors["moment_arm" if "moment_arm" in plant_factors else "spring"]
    }


def excite_and_fit(
    hand_name: str,
    digit_name: str,
    seed: int,
    plant_factors: dict[str, float],
    gains: Gains,
    log_folder: Path,
) -> tuple[dict[str, TendonResult], FitResultRow]:
    """Move one digit of a simulated hand and fit the parameters of this digit.

    Return the fit and a row of results. The row contains the CPU time, or the reason of a failure.

    Args:
        hand_name: name of a packaged hand or path of a hand file. Controller and simulator use the
            same hand file.
        digit_name: name of the digit.
        seed: seed of the simulated noise, slack and offsets.
        plant_factors: factors that multiply parameters of the simulated hand.
        gains: gains of the controller.
        log_folder: folder for the log.
    """
    hand = load_hand(hand_name)
    plan = RunPlan(hand, gains, default_control_rate(hand), ())
    log = log_folder / f"{seed}.mcap"
    controller = make_controller(
        plan, ExciteProgram(excitation_steps(hand, (digit_name,))), None, arm_at_once=True
    )
    start_cpu_s = time.process_time()
    with SimulatorSettings(hand_name, None, seed, plant_factors, homed=True).lockstep_clock(
        plan.period_ns
    ) as clock:
        hold_timeout = HoldTimeout()
        outcome = run_lockstep(plan, controller, log, clock, hold_timeout)
    row: FitResultRow = {
        "seed": seed,
        "digit": digit_name,
        "simulated_s": outcome.state.k * 1e-9 * plan.period_ns,
    }
    row["excite_cpu_s"] = time.process_time() - start_cpu_s
    if outcome.state.failure or hold_timeout.stop_reason:
        return {}, row | {"failure": hold_timeout.stop_reason or outcome.state.failure}
    with RunLog(log) as record:
        result = identify_tendons(record, hand)
    log.unlink()
    row["fit_cpu_s"] = time.process_time() - start_cpu_s - row["excite_cpu_s"]
    return result, row


def measure_digit(
    seed: int, digit_name: str, log_folder: Path, hand_name: str = "jamia"
) -> FitResultRow:
    """Move one digit of a random hand and fit the parameters of this digit.

    The returned row of results contains the error and the confidence interval of every parameter,
    or the reason of a failure.
    """
    hand = load_hand(hand_name)
    has_springs = hand.digit_named(digit_name).has_springs
    plant_factors = draw_plant(seed, has_springs)
    result, row = excite_and_fit(
        hand_name,
        digit_name,
        seed,
        plant_factors,
        gains_of_digit(hand, digit_name, seed),
        log_folder,
    )
    if not result:
        return row
    row["refused"] = sorted(
        {
            reason
            for parameter_row in result.values()
            for reason in (parameter_row.contact_text, parameter_row.blocked_event_text)
            if reason
        }
    )
    shared_parameters = {
        name: tendon_fit
        for tendon, tendon_fit in result.items()
        for name in tendon_fit.identifiability.names
        if name in DIGIT_KEY_BY_PARAMETER
    }
    row["parameters"] = [
        compare_parameter(name, tendon, true_value, shared_parameters.get(name, tendon_fit))
        for tendon, tendon_fit in result.items()
        for name, true_value in true_parameters(hand, tendon, plant_factors).items()
        if name not in DIGIT_KEY_BY_PARAMETER
        or tendon_fit is shared_parameters.get(name, tendon_fit)
    ]
    return row


def compare_parameter(
    parameter_name: str, tendon_name: str, true_value: float, result: TendonResult
) -> FitResultRow:
    """Compare an identified parameter with its true value.

    The returned error and half widths of confidence intervals are fractions of the true value.
    """
    identified = parameter_name in result.identifiability.names
    error = result.fit.parameter_values[parameter_name] / true_value - 1.0
    width = result.fit.half_widths[parameter_name] / true_value
    joint_half_width = (
        result.fit.simultaneous_half_widths(max(1, len(result.identifiability.names)))[
            parameter_name
        ]
        / true_value
    )
    return {
        "name": parameter_name,
        "tendon": tendon_name,
        "error": error,
        "half_width": width,
        "half_width_all_at_once": joint_half_width,
        "identified": identified,
        "covered": identified and abs(error) <= width,
        "covered_all_at_once": identified and abs(error) <= joint_half_width,
        "within": identified and abs(error) <= PARAMETER_TOLERANCES[parameter_name],
    }


def summarise_results(rows: list[FitResultRow]) -> FitResultRow:
    """Count, for every parameter, the accurate fits and the confidence intervals that contain the true value.

    Also summarise the errors of the identified parameters.
    """
    successful_parameters = [row["parameters"] for row in rows if "failure" not in row]
    result: FitResultRow = {
        "seeds": len(rows),
        "failed": [row for row in rows if "failure" in row],
        "parameters": {},
    }
    result["refused"] = [row["seed"] for row in rows if row.get("refused")]
    for name, limit in PARAMETER_TOLERANCES.items():
        parameter_rows = [
            result_row
            for row in successful_parameters
            for result_row in row
            if result_row["name"] == name
        ]
        errors = sorted(abs(result_row["error"]) for result_row in parameter_rows)
        result["parameters"][name] = {
            "limit": limit,
            "of": len(parameter_rows),
            "identified": sum(result_row["identified"] for result_row in parameter_rows),
            "within": sum(result_row["within"] for result_row in parameter_rows),
            "covered": sum(result_row["covered"] for result_row in parameter_rows),
            "median_error": errors[len(errors) // 2] if errors else math.nan,
            "worst_error": errors[-1] if errors else math.nan,
            "mean_error": sum(result_row["error"] for result_row in parameter_rows)
            / max(len(parameter_rows), 1),
            "median_half_width": sorted(result_row["half_width"] for result_row in parameter_rows)[
                len(parameter_rows) // 2
            ]
            if parameter_rows
            else math.nan,
        }
    for key in ("within", "covered", "covered_all_at_once"):
        result[f"all_{key}"] = sum(
            all(result_row[key] for result_row in row) for row in successful_parameters
        )
    return result


def collect_rows(args: argparse.Namespace) -> list[FitResultRow]:
    """Return the rows of results for all requested seeds.

    Compute only the rows that the file of results does not contain yet.
    """
    rows = (
        [json.loads(line) for line in args.into.read_text().splitlines()]
        if args.into and args.into.exists()
        else []
    )
    finished_seeds = {row["seed"] for row in rows}
    digits = load_hand(args.hand).digit_names
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(args.first, args.first + (1 if args.quick else args.seeds)):
            if seed in finished_seeds:
                continue
            rows.append(measure_digit(seed, digits[seed % len(digits)], Path(folder), args.hand))
            text = f"{rows[-1]['excite_cpu_s']:.0f} + {rows[-1].get('fit_cpu_s', 0.0):.0f} s of CPU"
            print(f"seed {seed}: {rows[-1].get('failure', 'done')}, {text}", file=sys.stderr)
            if args.into:
                with args.into.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    return rows


def main() -> int:
    """Identify the parameters of all random hands, and print a summary of the errors as a table or as JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--hand", default="jamia", help="packaged hand (default: jamia)")
    parser.add_argument("--seeds", type=int, default=4, help="number of random hands (default: 4)")
    parser.add_argument(
        "--first", type=int, default=1, help="seed of the first random hand (default: 1)"
    )
    parser.add_argument(
        "--into",
        type=Path,
        metavar="FILE",
        help="file of results, a JSON line each: an interrupted run continues",
    )
    parser.add_argument("--quick", action="store_true", help="one random hand")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    args = parser.parse_args()
    rows = collect_rows(args)
    result = summarise_results(rows)
    if args.json:
        json.dump(result | {"rows": rows}, sys.stdout, indent=2)
        return 0
    print(
        f"{result['seeds']} seeds, {len(result['failed'])} failed, {len(result['refused'])} refused without a contact"
    )
    for name, t in result["parameters"].items():
        if not t["of"]:
            continue
        print(
            f"{name:<17} identified {t['identified']}, within {100 * t['limit']:.0f} %: {t['within']} of {t['of']}, "
            f"covered by the 95 % interval: {t['covered']}; "
            f"error median {100 * t['median_error']:.1f} %, worst {100 * t['worst_error']:.1f} %, "
            f"mean {100 * t['mean_error']:+.1f} %; interval +- {100 * t['median_half_width']:.1f} %"
        )
    print(
        f"seeds with all within: {result['all_within']}, "
        f"all covered by the intervals of single parameters: {result['all_covered']}, "
        f"by intervals for all parameters at once: {result['all_covered_all_at_once']}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
