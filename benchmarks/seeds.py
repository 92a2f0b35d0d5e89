"""Run `handctl demo` for every packaged hand and drive protocol in lockstep, and report the worst results.

    nice -n 5 python benchmarks/seeds.py --results seeds.jsonl --table docs/evidence/seeds.md

The file of results has one line for each run. If the benchmark was stopped and is started again, it
continues after the last result in the file.
"""

import argparse
import contextlib
import io
import json
import math
import tempfile
from pathlib import Path
from typing import Any

from handctl.campaign.fault_matrix import ALL_PROTOCOLS
from handctl.cli.main import main as handctl
from handctl.hand.hand_loading import load_hand, packaged_hands

ERROR_LIMIT_BY_MEASURE = {"tracking_deg": 1.0, "tension_error_N": 2.0, "object_motion_mm": 1.0}
"""Limits of the errors in a run.

A run passes if its errors are within the limits, and if it had no failure, no missed tick and no
lost frame. `error_limits` raises the limit of the tension error for a hand whose load cells drift.
"""
DRIFT_SIGMAS = 3.0
"""Largest tension error that counts as load-cell drift, in standard deviations of the drift."""
DemoCase = tuple[str, str, int]
"""Hand, protocol and seed of a run."""


def run_demo(hand_name: str, protocol: str, seed: int) -> dict[str, Any]:
    """Run `handctl demo` once and return the errors in this run.

    If the run does not pass, the result includes the reason why it does not pass.
    """
    output_stream = io.StringIO()
    err = io.StringIO()
    with tempfile.TemporaryDirectory(prefix="handctl-seeds-") as folder:
        words = [
            "--hand",
            hand_name,
            "--protocol",
            protocol,
            "--seed",
            str(seed),
            "--log",
            f"{folder}/run.mcap",
            "--json",
        ]
        with contextlib.redirect_stdout(output_stream), contextlib.redirect_stderr(err):
            code = handctl(["demo", "--lockstep", *words])
    figures: dict[str, Any] = {"hand": hand_name, "protocol": protocol, "seed": seed, "exit": code}
    text = output_stream.getvalue()
    if not text:
        return figures | {"why": err.getvalue().strip().rpartition("\n")[2]}
    result = json.loads(text)
    figures |= {
        "tracking_deg": max(result["tracking_rmse_deg"].values()),
        "tension_error_N": result["tension_hold_error_n"],
        "object_motion_mm": result["object_motion_mm"],
    }
    return figures | {"why": failure_reason(figures, result)}


def error_limits(hand_name: str, duration_s: float) -> dict[str, float]:
    """Return the largest permitted value of each error in a run.

    No sensor of the hand can reveal the drift of a load cell. The limit of the tension error is at
    least `DRIFT_SIGMAS` standard deviations of the drift that a load cell has during the run.
    """
    drift = (
        DRIFT_SIGMAS
        * load_hand(hand_name).sensor_node.tension_bias_drift_N
        * math.sqrt(duration_s / 100.0)
    )
    return ERROR_LIMIT_BY_MEASURE | {
        "tension_error_N": max(ERROR_LIMIT_BY_MEASURE["tension_error_N"], drift)
    }


def failure_reason(run_errors: dict[str, Any], run_result: dict[str, Any]) -> str:
    """Describe why a run does not pass. Return an empty string if the run passes."""
    if run_result["failure"] or run_result["missed"] or run_result["frames_lost"]:
        return (
            run_result["failure"]
            or f"{run_result['missed']} ticks missed, {run_result['frames_lost']} frames lost"
        )
    if min(run_result["contact_force_n"].values()) <= 0.5:
        return "a digit does not hold the object"
    allowed_errors = error_limits(run_errors["hand"], run_result["simulated_s"])
    return ", ".join(
        f"{name} {run_errors[name]:.2f}"
        for name, limit in allowed_errors.items()
        if not run_errors[name] < limit
    )


def results_table(results: list[dict[str, Any]]) -> str:
    """Make a Markdown table with a row for each hand and protocol.

    Below the table, add one line for each run that does not pass.
    """
    rows = [
        "| hand | protocol | seeds passed | tracking error [deg] | tension error [N] | object motion [mm] |",
        "|---|---|---|---|---|---|",
    ]
    for hand, protocol in dict.fromkeys((result["hand"], result["protocol"]) for result in results):
        selected_results = [
            result for result in results if (result["hand"], result["protocol"]) == (hand, protocol)
        ]
        worst_errors = [
            max(
                (run_row[name] for run_row in selected_results if name in run_row),
                default=float("nan"),
            )
            for name in ERROR_LIMIT_BY_MEASURE
        ]
        passed_text = (
            f"{sum(not run_row['why'] for run_row in selected_results)} of {len(selected_results)}"
        )
        rows.append(
            f"| {hand} | {protocol} | {passed_text} | {worst_errors[0]:.2f} | {worst_errors[1]:.2f} | "
            f"{worst_errors[2]:.3f} |"
        )
    for result in results:
        if result["why"]:
            rows.append(
                f"\n{result['hand']}, {result['protocol']}, seed {result['seed']}: {result['why']}"
            )
    return "\n".join(rows) + "\n"


def main() -> None:
    """Run the demo for each case that has no result in the file yet, and write the table."""
    parser = argparse.ArgumentParser(description="the demo over many seeds")
    parser.add_argument(
        "--seeds", type=int, default=20, metavar="N", help="number of seeds (default: 20)"
    )
    parser.add_argument(
        "--results",
        type=Path,
        required=True,
        metavar="FILE",
        help="file of results, a JSON line per run",
    )
    parser.add_argument(
        "--hand",
        nargs="+",
        choices=packaged_hands(),
        default=packaged_hands(),
        help="hands (default: all)",
    )
    parser.add_argument(
        "--protocol",
        nargs="+",
        choices=ALL_PROTOCOLS,
        default=ALL_PROTOCOLS,
        help="protocols (default: all)",
    )
    parser.add_argument(
        "--table", type=Path, metavar="FILE", help="write the table into this file too"
    )
    args = parser.parse_args()
    lines = args.results.read_text().splitlines() if args.results.exists() else []
    results = [json.loads(line) for line in lines]
    finished_jobs = {(result["hand"], result["protocol"], result["seed"]) for result in results}
    cases: list[DemoCase] = [
        (h, p, seed) for seed in range(args.seeds) for h in args.hand for p in args.protocol
    ]
    for case in cases:
        if case not in finished_jobs:
            results.append(run_demo(*case))
            with args.results.open("a") as file:
                file.write(json.dumps(results[-1]) + "\n")
    index_by_hand_and_protocol = {
        (hand, protocol): i for i, (hand, protocol, _) in enumerate(cases)
    }
    results.sort(
        key=lambda seed_result: (
            index_by_hand_and_protocol.get((seed_result["hand"], seed_result["protocol"]), -1),
            seed_result["seed"],
        )
    )
    text = results_table(results)
    if args.table:
        args.table.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
