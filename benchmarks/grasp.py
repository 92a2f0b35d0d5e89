"""Measure grasps: success, payload, contact detection, and the reaction to slip.

To test a grasp, the benchmark turns the hand and pushes the object. The payload is measured with a
grip force of 6 N per finger.

``python benchmarks/grasp.py [--quick | --full] [--json] [--seeds N] [--keep FOLDER] [--page]``.
Controller and simulated hand run in lockstep. The results are computed from true values of the
simulator. ``grasps/grasp_objects.py`` contains the objects and disturbances, which were fixed
before any tuning. With ``--full``, every object is grasped. ``--page`` writes
docs/evidence/control-grasps.md and the picture of this page.
"""

import argparse
import json
from typing import Any

import numpy as np
from grasps import contact_detection, grasp_page, grasp_success, payload, slip_reaction, tip_force
from grasps.grasp_objects import GRASP_CASES
from trials.job_runner import JobPlan, add_job_options, collect_results, job_plan_of

MEASURED_HANDS = ("jamia", "jamia11")
QUICK_OBJECTS = (1,)
DEFAULT_OBJECTS = (1, 6, 8, 11, 16)
"""Numbers of the objects in a run without ``--full``.

``QUICK_OBJECTS`` has the numbers for a run with ``--quick``.
"""
FREE_MOTION_DURATION_S = 30.0
"""Simulated time of a run of free motion [s]."""


def main() -> None:
    """Run the selected parts of the benchmark and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick",
        action="store_true",
        help="one object, 0.1 minutes of free motion (less than a minute)",
    )
    parser.add_argument(
        "--full", action="store_true", help="try every object (an hour with ten seeds)"
    )
    parser.add_argument(
        "--grasps",
        default="power,pinch,hook",
        help="kinds of grasps, separated by commas (default: %(default)s)",
    )
    parser.add_argument(
        "--seeds",
        type=int,
        default=1,
        help="number of runs for each object, with other places and noise (default: 1)",
    )
    parser.add_argument(
        "--minutes-free",
        type=float,
        default=0.0,
        help="duration of free motion per hand [min] (default: 0.5; --quick: 0.1; --full: 10)",
    )
    parser.add_argument(
        "--parts",
        default="success,payload,contact,tip,slip",
        help="parts of the benchmark, separated by commas (default: %(default)s)",
    )
    add_job_options(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument(
        "--page",
        action="store_true",
        help="write the results into docs/evidence/control-grasps.md, with a picture",
    )
    args = parser.parse_args()
    result = measure_grasps(args, job_plan_of(args))
    if args.page:
        grasp_page.write_page(result)
    print(json.dumps(result, indent=1)) if args.json else print(grasp_page.tables_text(result))


def measure_grasps(args: argparse.Namespace, plan: JobPlan) -> dict[str, Any]:
    """Run the parts of the benchmark that the options select, and return the results."""
    part_names = args.parts.split(",")
    seeds = range(args.seeds)
    hands = MEASURED_HANDS[:1] if args.quick else MEASURED_HANDS
    selected_parts = (
        QUICK_OBJECTS if args.quick else range(len(GRASP_CASES)) if args.full else DEFAULT_OBJECTS
    )
    selected_parts = [i for i in selected_parts if GRASP_CASES[i].grasp in args.grasps.split(",")]
    result: dict[str, Any] = {}
    if "success" in part_names:
        grasp_jobs = [(hand, i, seed) for seed in seeds for i in selected_parts for hand in hands]
        result["success"] = list(
            collect_results(grasp_success.measure_grasp, grasp_jobs, plan).values()
        )
    if "payload" in part_names and not args.quick:
        payload_jobs = [
            (hand, load_direction, seed)
            for seed in seeds
            for hand in hands
            for load_direction in payload.LOAD_DIRECTIONS
        ]
        result["payload"] = list(
            collect_results(payload.measure_payload, payload_jobs, plan).values()
        )
    if "slip" in part_names and not args.quick:
        slip_rows = [
            (hand, has_slip_reaction, seed)
            for seed in seeds
            for hand in hands
            for has_slip_reaction in (False, True)
        ]
        result["slip"] = list(collect_results(slip_reaction.measure_slip, slip_rows, plan).values())
    if "tip" in part_names:
        results = collect_results(
            tip_force.measure_tip_force, [(hand, seed) for seed in seeds for hand in hands], plan
        )
        result["tip"] = [row for rows in results.values() for row in rows]
    if "contact" in part_names:
        simulated_minutes = args.minutes_free or (0.1 if args.quick else 10.0 if args.full else 0.5)
        result["contact"] = _measure_contact_detection(
            hands, args.seeds * (2 if args.quick else 4), simulated_minutes, plan
        )
    return result


def _measure_contact_detection(
    hand_names: tuple[str, ...], wall_seed_count: int, simulated_minutes: float, plan: JobPlan
) -> list[dict[str, Any]]:
    """Measure contact detection for each hand.

    The results are the delays of contact events at walls, and the numbers of false contact events
    in free motion. In a run of free motion, the digits pause between their motions. The reported
    time of free motion does not include the pauses.
    """
    results = collect_results(
        contact_detection.find_contacts,
        [(hand, seed) for seed in range(wall_seed_count) for hand in hand_names],
        plan,
    )
    run_duration_s = min(FREE_MOTION_DURATION_S, 60.0 * simulated_minutes)
    count = max(
        1, round(60.0 * simulated_minutes / run_duration_s / contact_detection.MOVING_TIME_FRACTION)
    )
    free_results = collect_results(
        contact_detection.measure_false_contacts,
        [(hand, run_duration_s, seed) for seed in range(count) for hand in hand_names],
        plan,
    )
    return [
        _summarise_contacts(
            hand,
            [v for j, v in results.items() if j[0] == hand],
            [v for j, v in free_results.items() if j[0] == hand],
        )
        for hand in hand_names
    ]


def _summarise_contacts(
    hand_name: str, contact_delays: list[list[float]], false_contact_rows: list[dict[str, float]]
) -> dict[str, Any]:
    """Compute the results of one hand from the delays of contact events and the counts of false contacts."""
    delays_s = np.array([value for values in contact_delays for value in values])
    if not len(delays_s) or not false_contact_rows:
        return {"hand": hand_name, "contacts": 0}
    return {
        "hand": hand_name, "contacts": len(delays_s),
        "within_20_ms": round(float((delays_s <= contact_detection.DETECTION_LIMIT_S + 1e-9).mean()), 3),
        "before_1_N": round(float((delays_s < 0.0).mean()), 3),
        "p95_ms": round(1e3 * float(np.sort(delays_s)[int(np.ceil(0.95 * len(delays_s))) - 1]), 1),
        "worst_ms": round(1e3 * float(delays_s.max()), 1),
        "free_minutes": round(sum(row["minutes"] for row in false_contact_rows), 2),
        "false_alarms": sum(row["alarms"] for row in false_contact_rows),
    }  # fmt: skip


if __name__ == "__main__":
    main()
