"""Measure the CPU time of the simulator in lockstep, without MuJoCo's ``mj_step``.

``python benchmarks/simulator_cpu.py [--quick] [--json]``. The measured runs include the controller,
as every run in lockstep does. The controller displaces code and data of the simulator from the
processor caches, and thus slows down the simulator. The benchmark measures the CPU time of
``LockstepHand.exchange`` in each tick, and subtracts the CPU time of ``mj_step`` alone for the same
motion. The benchmark runs the same motion several times. Because all runs are bit-identical, the
benchmark uses the shortest time of each tick.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

from lockstep import SETUP_BY_SCENE, record_rollout, repeat_rollout, sum_of_shortest
from lockstep_stack import CONTROL_RATES_HZ, LockstepStack

from handctl.campaign.run_stages import hand_with_protocol
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS

SIMULATED_TIME_S = 3.0
QUICK_SIMULATED_TIME_S = 1.2
RUNS_PER_CASE = 4
CLOCK_READ_COUNT = 10_000


def main() -> None:
    """Measure the CPU time for each combination of hand, protocol and scene, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="shorter runs")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    args = parser.parse_args()
    seconds = QUICK_SIMULATED_TIME_S if args.quick else SIMULATED_TIME_S
    rows = []
    for hand in CONTROL_RATES_HZ:
        for protocol in VERIFIABLE_PROTOCOLS:
            for scene in SETUP_BY_SCENE:
                rows.append(measure_simulator_cpu(hand, protocol, scene, seconds))
                if not args.json:
                    print_case(rows[-1])
    if args.json:
        print(json.dumps(rows, indent=2))


def measure_simulator_cpu(
    hand_name: str, protocol: str, scene_name: str, simulated_s: float
) -> dict:
    """Measure the CPU time of the simulator for one hand, one drive protocol and one scene."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hand.toml"
        path.write_text(hand_with_protocol(hand_name, protocol).to_toml())

        def make_lockstep_stack() -> LockstepStack:
            return LockstepStack(str(path), CONTROL_RATES_HZ[hand_name], SETUP_BY_SCENE[scene_name])

        rollout = record_rollout(make_lockstep_stack(), simulated_s)
        engine_only_s = sum_of_shortest(
            repeat_rollout(make_lockstep_stack(), rollout) for _ in range(RUNS_PER_CASE)
        )
        simulator_s = sum_of_shortest(
            make_lockstep_stack().simulator_tick_times(simulated_s) for _ in range(RUNS_PER_CASE)
        )
    ticks = round(simulated_s * CONTROL_RATES_HZ[hand_name])
    steps = len(rollout.torque)
    mujoco_us = (engine_only_s - steps * clock_read_cpu_s()) / ticks * 1e6
    exchange_us = (simulator_s - ticks * clock_read_cpu_s()) / ticks * 1e6
    return {
        "hand": hand_name,
        "protocol": protocol,
        "scene": scene_name,
        "bare_us_per_tick": mujoco_us,
        "exchange_us_per_tick": exchange_us,
        "behind_the_wire_us_per_tick": exchange_us - mujoco_us,
    }


def clock_read_cpu_s() -> float:
    """Measure the CPU time of two successive readings of the clock [s]."""
    read_cpu_time = time.process_time
    return min(-(read_cpu_time() - read_cpu_time()) for _ in range(CLOCK_READ_COUNT))


def print_case(case_row: dict) -> None:
    """Print the result of one case as text."""
    print(
        f"{case_row['hand']:8} {case_row['protocol']:7} {case_row['scene']:8} "
        f"mj_step {case_row['bare_us_per_tick']:6.1f} us, exchange "
        f"{case_row['exchange_us_per_tick']:6.1f} us, "
        f"behind the wire {case_row['behind_the_wire_us_per_tick']:5.1f} us per tick",
        flush=True,
    )


if __name__ == "__main__":
    main()
