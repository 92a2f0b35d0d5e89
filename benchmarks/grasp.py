"""Do grasps hold? Objects turned three ways and pushed, mass borne at 6 N a finger, contact found, slip answered.

``python benchmarks/grasp.py [--quick | --full] [--json] [--seeds N] [--page]``. Everything runs through frames and the
simulator in lockstep, against the plant's truth. The objects and what is done to them: ``grasps/objects.py``, fixed
before anything was tuned. ``--full`` tries every object; ``--page`` writes docs/control-grasps.md with its picture.
"""

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

import numpy as np
from grasps import contact, page, payload, slip, success
from grasps.objects import CASES

HANDS = ("jamia", "jamia11")
QUICK = (1,)
USUAL = (1, 6, 8, 11, 16)
"""Objects by number: of the quick and of the usual run."""


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="under a minute: one object, one minute of free motion")
    parser.add_argument("--full", action="store_true", help="every object; an hour at ten seeds")
    parser.add_argument("--seeds", type=int, default=1, help="places and noise to try (1)")
    parser.add_argument(
        "--minutes", type=float, default=0.0, help="of free motion a hand (quick 0.1, else 0.5, full 10)"
    )
    parser.add_argument("--parts", default="success,payload,contact,slip", help="which of them, separated by commas")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--json", action="store_true", help="numbers for programs")
    parser.add_argument("--page", action="store_true", help="write the page and its picture")
    args = parser.parse_args()
    with ProcessPoolExecutor(args.jobs) as pool:
        result = measure(args, pool)
    if args.page:
        page.write(result)
    print(json.dumps(result, indent=1)) if args.json else print(page.text(result))


def measure(args: argparse.Namespace, pool: ProcessPoolExecutor) -> dict[str, Any]:
    """Everything that was asked for, most expensive first."""
    parts = args.parts.split(",")
    hands = HANDS[:1] if args.quick else HANDS
    which = QUICK if args.quick else range(len(CASES)) if args.full else USUAL
    minutes = args.minutes or (0.1 if args.quick else 10.0 if args.full else 0.5)
    walls = args.seeds * (2 if args.quick else 4)
    waiting: dict[str, list[Any]] = {}
    if "success" in parts:
        tries = [(hand, CASES[i], seed) for seed in range(args.seeds) for i in which for hand in hands]
        waiting["success"] = [pool.submit(success.try_case, *each) for each in tries]
    if "payload" in parts and not args.quick:
        waiting["payload"] = [pool.submit(payload.try_load, h, along) for h in hands for along in payload.ALONG]
    if "slip" in parts:
        slips = [(hand, answered, seed) for seed in range(args.seeds) for hand in hands for answered in (False, True)]
        waiting["slip"] = [pool.submit(slip.pull, *each) for each in slips]
    if "contact" in parts:
        waiting["walls"] = [pool.submit(_walls, hand, seed) for hand in hands for seed in range(walls)]
        stretch = min(30.0, 60.0 * minutes)
        count = max(1, round(60.0 * minutes / stretch))
        waiting["free"] = [pool.submit(_free, hand, stretch, seed) for hand in hands for seed in range(count)]
    done = _finished(waiting)
    result = {key: done[key] for key in ("success", "payload", "slip") if key in done}
    if "walls" in done:
        result["contact"] = [_contact(hand, done["walls"], done["free"]) for hand in hands]
    return result


def _finished(waiting: dict[str, list[Any]]) -> dict[str, list[Any]]:
    """What all have found; each is told as it ends."""
    all_jobs = {job: key for key, jobs in waiting.items() for job in jobs}
    for number, job in enumerate(as_completed(all_jobs), 1):
        found = job.result()
        brief = {k: v for k, v in found.items() if k != "curve"} if isinstance(found, dict) else found
        print(f"{number}/{len(all_jobs)} {all_jobs[job]} {json.dumps(brief)}", file=sys.stderr, flush=True)
    return {key: [job.result() for job in jobs] for key, jobs in waiting.items()}


def _walls(hand: str, seed: int) -> tuple[str, list[float]]:
    return hand, contact.find_contacts(hand, seed)


def _free(hand: str, seconds: float, seed: int) -> tuple[str, dict[str, float]]:
    return hand, contact.free_motion(hand, seconds, seed)


def _contact(hand: str, walls: list[Any], free: list[Any]) -> dict[str, Any]:
    """Latencies and false alarms of one hand."""
    latency = np.array([value for name, values in walls if name == hand for value in values])
    rows = [row for name, row in free if name == hand]
    return {
        "hand": hand, "contacts": len(latency),
        "within_20_ms": round(float((latency <= contact.WITHIN_S + 1e-9).mean()), 3),
        "before_1_N": round(float((latency < 0.0).mean()), 3),
        "p95_ms": round(1e3 * float(np.sort(latency)[int(np.ceil(0.95 * len(latency))) - 1]), 1),
        "free_minutes": round(sum(row["minutes"] for row in rows), 2),
        "false_alarms": sum(row["alarms"] for row in rows),
    }  # fmt: skip


if __name__ == "__main__":
    main()
