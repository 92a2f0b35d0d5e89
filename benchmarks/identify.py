"""What ``handctl identify`` makes of simulated hands unlike their file: how near, how often covered.

Each seed draws plant parameters off by up to 30 % and gains detuned by up to a factor of 3 either way, excites one
digit in lockstep and fits its log. The simulator's truth is used for judging only.

    python benchmarks/identify.py            # four seeds
    python benchmarks/identify.py --seeds 100 --json
"""

import argparse
import json
import random
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from handctl.cli.plan import Plan
from handctl.cli.session import make_controller, run_lockstep
from handctl.controller.excite import ExciteProgram
from handctl.controller.gain_bounds import with_values
from handctl.controller.gains import Gains
from handctl.hand.description import hand_path, load_hand
from handctl.log.reader import RunLog
from handctl.runtime.lockstep import SIMULATED_HAND, LockstepClock, load_peer
from handctl.tune.excitation import excitation
from handctl.tune.identify import identify

OFF, DETUNED = 0.3, 3.0
DRAWN = ("stiffness", "damping", "friction", "mass", "spring", "motor_inertia", "torque_constant")
WITHIN = {
    "rope_stiffness": 0.05, "spring_stiffness": 0.05, "motor_inertia": 0.05,
    "motor_coulomb": 0.15, "motor_viscous": 0.15, "capstan": 0.15, "torque_gain": 0.05,
}  # fmt: skip
"""What is judged, and how near it is to come."""
DETUNABLE = ("motion.position_error_m", "motion.speed_error_m_s", "motion.force_N", "tension.tension_error_N",
             "tension.speed_error_m_s", "tension.force_N", "tension.integral_per_s")  # fmt: skip


def plant(seed: int) -> dict[str, float]:
    """Factors on a plant's parameters."""
    chance = random.Random(f"plant {seed}")
    return {key: chance.uniform(1.0 - OFF, 1.0 + OFF) for key in DRAWN}


def detuned(seed: int) -> Gains:
    """Gains off by up to a factor of 3 either way."""
    chance, packaged = random.Random(f"gains {seed}"), Gains()
    values = {}
    for key in DETUNABLE:
        section, _, name = key.partition(".")
        values[key] = getattr(getattr(packaged, section), name) * DETUNED ** chance.uniform(-1.0, 1.0)
    return with_values(packaged, values, "detuned")


def truth(hand: Any, tendon: str, factors: dict[str, float]) -> dict[str, float]:
    """What identification should find."""
    rope = hand.tendon[hand.tendon_names.index(tendon)]
    motor = hand.motor_of(tendon)
    return {
        "rope_stiffness": rope.stiffness_N_per_m * factors["stiffness"],
        "spring_stiffness": factors["spring"],
        "motor_inertia": motor.inertia_kg_m2 * factors["motor_inertia"],
        "motor_coulomb": motor.coulomb_N_m * factors["friction"],
        "motor_viscous": motor.viscous_N_m_s_per_rad * factors["damping"],
        "capstan": rope.friction_coefficient * factors["friction"],
        "torque_gain": factors["torque_constant"],
    }


def one(seed: int, digit: str, folder: Path) -> dict[str, Any]:
    """Excite and fit one digit of one hand; error and coverage of every parameter, or why it failed."""
    hand, factors, gains = load_hand("jamia"), plant(seed), detuned(seed)
    plan = Plan(hand, gains, 500.0, ())
    options = {"hand_path": str(hand_path("jamia")), "seed": seed, "homed": True, "perturb": factors}
    peer = load_peer(SIMULATED_HAND, **options, period_ns=plan.period_ns)
    log = folder / f"{seed}.mcap"
    program = ExciteProgram(excitation(hand, (digit,)))
    controller = make_controller(plan, program, None, arm_at_once=True)
    began = time.perf_counter()
    outcome = run_lockstep(plan, controller, log, LockstepClock(peer, plan.period_ns))
    peer.close()
    row: dict[str, Any] = {"seed": seed, "digit": digit, "simulated_s": outcome.state.k * 1e-9 * plan.period_ns}
    row["excite_s"] = time.perf_counter() - began
    if outcome.state.failure:
        return row | {"failure": outcome.state.failure}
    with RunLog(log) as record:
        found = identify(record, hand)[f"{digit}_tendon"]
    log.unlink()
    row["fit_s"] = time.perf_counter() - began - row["excite_s"]
    values, widths = found.fit.values, found.fit.half_widths
    for name, real in truth(hand, f"{digit}_tendon", factors).items():
        known = name in found.judged.names
        error = values[name] / real - 1.0
        row[name] = {
            "identified": known,
            "error": error,
            "half_width": widths[name] / real,
            "covered": known and abs(values[name] - real) <= widths[name],
            "within": known and abs(error) <= WITHIN[name],
        }
    return row


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Of every parameter: how often within its limit, how often covered, and the spread of its errors."""
    good = [row for row in rows if "failure" not in row]
    told: dict[str, Any] = {"seeds": len(rows), "failed": [row for row in rows if "failure" in row]}
    for name, limit in WITHIN.items():
        errors = sorted(abs(row[name]["error"]) for row in good)
        told[name] = {
            "limit": limit,
            "within": sum(row[name]["within"] for row in good),
            "covered": sum(row[name]["covered"] for row in good),
            "median_error": errors[len(errors) // 2] if errors else None,
            "worst_error": errors[-1] if errors else None,
            "mean_error": sum(row[name]["error"] for row in good) / max(len(good), 1),
            "median_half_width": sorted(row[name]["half_width"] for row in good)[len(good) // 2] if good else None,
        }
    return told


def main() -> int:
    """Run the seeds and print a table or JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--quick", action="store_true", help="one seed")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    digits, rows = load_hand("jamia").digit_names, []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(args.first, args.first + (1 if args.quick else args.seeds)):
            rows.append(one(seed, digits[seed % len(digits)], Path(folder)))
            print(f"seed {seed}: {rows[-1].get('failure', 'done')}, {rows[-1]['excite_s']:.0f} s", file=sys.stderr)
    told = summary(rows)
    if args.json:
        json.dump(told | {"rows": rows}, sys.stdout, indent=2)
        return 0
    print(f"{told['seeds']} seeds, {len(told['failed'])} failed")
    for name, limit in WITHIN.items():
        t = told[name]
        print(
            f"{name:<17} within {100 * limit:.0f} %: {t['within']}, covered by the 95 % interval: {t['covered']}; "
            f"error median {100 * (t['median_error'] or 0):.1f} %, worst {100 * (t['worst_error'] or 0):.1f} %"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
