"""Measure the speed of controller and simulator in lockstep, and profile them.

For comparison, the benchmark runs MuJoCo's ``mj_step`` alone with the same motion.

``python benchmarks/lockstep.py [--quick] [--json]``. A first run of controller and simulator
records the torques that the tendons apply to the joints in each simulation step. Then the benchmark
repeats the motion with ``mj_step`` alone and the recorded torques. The final positions of both runs
must be bit-identical. Several further runs are timed, and one further run is profiled. All runs are
bit-identical. For each tick and each simulation step, the benchmark uses the shortest time over all
runs. Of all measured times, the shortest time is least affected by other load on the processor
core.
"""

import argparse
import json
import time
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from cpu_profile import cpu_time_fractions
from lockstep_stack import CONTROL_RATES_HZ, FreeMotionSetup, GraspSetup, LockstepStack

SIMULATED_TIME_S = 4.0
QUICK_SIMULATED_TIME_S = 1.2
RUNS_PER_CASE = 4


class BodyRollout(NamedTuple):
    """Record of a run: the inputs of MuJoCo in each simulation step, and the final joint angles.

    Attributes:
        torque: (steps, joints) torque that tendons apply to each joint [N m].
        damping: (steps, tendons) damping of each tendon [N s/m].
        table_height: (steps, bodies, 3) position of the table [m].
        final_angles: (joints,) joint angles after the last step [rad].
        contacts: mean number of contacts in a simulation step.
    """

    torque: np.ndarray
    damping: np.ndarray
    table_height: np.ndarray
    final_angles: np.ndarray
    contacts: float


def main() -> None:
    """Measure the speed of controller and simulator for all hands and scenes, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="short measurement (less than half a minute)"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    args = parser.parse_args()
    result = {
        hand: {
            name: measure_lockstep_speed(
                hand, rate, name, QUICK_SIMULATED_TIME_S if args.quick else SIMULATED_TIME_S
            )
            for name in SETUP_BY_SCENE
        }
        for hand, rate in CONTROL_RATES_HZ.items()
    }
    print(json.dumps(result, indent=2)) if args.json else print_results(result)


SETUP_BY_SCENE = {"free": FreeMotionSetup, "contact": GraspSetup}


def measure_lockstep_speed(
    hand_name: str, rate_hz: float, scene_name: str, simulated_s: float
) -> dict:
    """Measure the CPU times of controller and simulator for one hand in one scene."""
    run_setup = SETUP_BY_SCENE[scene_name]
    rollout = record_rollout(LockstepStack(hand_name, rate_hz, run_setup), simulated_s)
    mujoco_only_s = sum_of_shortest(
        repeat_rollout(LockstepStack(hand_name, rate_hz, run_setup), rollout)
        for _ in range(RUNS_PER_CASE)
    )
    total_s = sum_of_shortest(
        LockstepStack(hand_name, rate_hz, run_setup).run(simulated_s) for _ in range(RUNS_PER_CASE)
    )
    simulator_s = sum_of_shortest(
        LockstepStack(hand_name, rate_hz, run_setup).simulator_tick_times(simulated_s)
        for _ in range(RUNS_PER_CASE // 2)
    )
    ticks = round(simulated_s * rate_hz)
    return {
        "rate_hz": rate_hz,
        "simulated_s": simulated_s,
        "contacts": rollout.contacts,
        "bare_times_real_time": simulated_s / mujoco_only_s,
        "whole_times_real_time": simulated_s / total_s,
        "share_of_bare": mujoco_only_s / total_s,
        "bare_us_a_tick": mujoco_only_s / ticks * 1e6,
        "rest_us_a_tick": (total_s - mujoco_only_s) / ticks * 1e6,
        "simulator_us_a_tick": (simulator_s - mujoco_only_s) / ticks * 1e6,
        "spent": cpu_time_fractions(
            lambda: LockstepStack(hand_name, rate_hz, run_setup).run(simulated_s)
        ),
    }


def sum_of_shortest(times_by_run: Iterable[list[float]]) -> float:
    """Find the shortest time of each tick or simulation step, and return the sum of these times [s].

    The shortest time is the minimum over several bit-identical runs.
    """
    return sum(map(min, zip(*times_by_run, strict=True)))


def record_rollout(lockstep_stack: LockstepStack, simulated_s: float) -> BodyRollout:
    """Run controller and simulator, and record the inputs of MuJoCo in each simulation step."""
    engine = lockstep_stack.engine
    plant = lockstep_stack.peer.world.plant
    advance = plant.advance
    rows = []
    contacts = []

    def advance_stepwise(count: int) -> None:
        for _ in range(count):
            table = engine._data.mocap_pos.copy()
            advance(1)
            rows.append((engine.applied.copy(), engine.tendon_damping.copy(), table))
            contacts.append(engine._data.ncon)

    plant.advance = advance_stepwise
    lockstep_stack.run(simulated_s)
    torque, damping, table = (np.array(column) for column in zip(*rows, strict=True))
    return BodyRollout(torque, damping, table, engine.q.copy(), float(np.mean(contacts)))


def repeat_rollout(lockstep_stack: LockstepStack, rollout: BodyRollout) -> list[float]:
    """Repeat a recorded motion with MuJoCo alone. Return the CPU time of each simulation step [s].

    Raises:
        RuntimeError: the repeated motion differs from the recorded motion.
    """
    engine = lockstep_stack.engine
    step = engine.step
    applied_torque = engine.applied
    damping = engine.tendon_damping
    table = engine._data.mocap_pos
    step_times = []
    read_cpu_time = time.process_time
    for torque, slope, table_position in zip(
        rollout.torque, rollout.damping, rollout.table_height, strict=True
    ):
        start_time_s = read_cpu_time()
        applied_torque[:] = torque
        damping[:] = slope
        table[:] = table_position
        step()
        step_times.append(read_cpu_time() - start_time_s)
    if not np.array_equal(engine.q, rollout.final_angles):
        raise RuntimeError("the repeated motion differs from the recorded motion")
    return step_times


def print_results(result: dict) -> None:
    """Print the CPU times of one hand in one scene as text."""
    for hand, scenes in result.items():
        for scene, row in scenes.items():
            print(
                f"{hand}, {scene} ({row['contacts']:.1f} contacts), {row['rate_hz']:g} Hz: bare "
                f"{row['bare_times_real_time']:.1f}, whole stack {row['whole_times_real_time']:.1f} times real "
                f"time: {100 * row['share_of_bare']:.0f} %"
            )
            print(
                f"  mj_step {row['bare_us_a_tick']:.0f} us a tick, the rest {row['rest_us_a_tick']:.0f} us, of it "
                f"{row['simulator_us_a_tick']:.0f} us behind the wire:"
            )
            other_fractions = {
                who: fraction for who, fraction in row["spent"].items() if who != "mj_step"
            }
            for who, fraction in sorted(other_fractions.items(), key=lambda row: -row[1]):
                print(f"    {100 * fraction / sum(other_fractions.values()):5.1f} %  {who}")


if __name__ == "__main__":
    main()
