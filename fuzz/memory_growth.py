"""Measure how the memory of controller and recorder grows: ``python -m fuzz.memory_growth --hours 1``.

The module ``fuzz.memory_growth`` runs the same control loop, controller and recorder as
``fuzz.soak``, but on a simulated clock and a simulated bus. The simulated clock makes the measured
growth independent of the load of the computer. To measure the memory growth in real time, run
``fuzz.soak --calm``.
"""

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

from fuzz.soak import MAX_GROWTH_MIB_PER_H, SOAK_TASK, MemorySample, memory_sample, memory_slope
from handctl.controller.run_setup import make_controller
from handctl.core.gains.gains import Gains
from handctl.core.tick_types import TickIn, TickOut
from handctl.hand.hand_loading import load_hand
from handctl.programs.task import load_task
from handctl.programs.task_program import TaskProgram
from handctl.runtime.mailbox import STOP_REQUEST
from handctl.session.lockstep_simulation import SimulatorSettings
from handctl.session.run import run_lockstep
from handctl.session.run_plan import RunPlan

SAMPLE_PERIOD_S = 30.0
WARM_UP_S = 600.0
"""Warm-up time before the growth is measured [s].

The buffer for the lateness of each tick becomes full during the warm-up, and takes 2 MiB when it is
full.
"""


class MemorySampler:
    """Observer that samples the memory of this process and of its child processes during a run."""

    def __init__(self, end_time_s: float) -> None:
        """Create a sampler without memory samples. The run must end at ``end_time_s`` [s]."""
        self.samples: list[MemorySample] = []
        self.until_s = end_time_s

    def poll_requests(self) -> tuple[str, ...]:
        """Return a stop request if the run has reached its end time."""
        return (STOP_REQUEST,) if self.samples and self.samples[-1].time_s >= self.until_s else ()

    def on_tick(self, tick_input: TickIn, tick_output: TickOut) -> None:
        """Measure the memory of the processes every ``SAMPLE_PERIOD_S``."""
        t = tick_input.t_ns / 1e9
        if not self.samples or t - self.samples[-1].time_s >= SAMPLE_PERIOD_S:
            self.samples.append(memory_sample(os.getpid(), t))
            print(f"{t:8.0f} s  {self.samples[-1].rss_mib:.2f} MiB", file=sys.stderr, flush=True)


def main() -> int:
    """Run controller and recorder in lockstep.

    Return 1 if the memory of controller or recorder grows, or if the run fails.
    """
    parser = argparse.ArgumentParser(prog="python -m fuzz.memory_growth", description=__doc__)
    parser.add_argument(
        "--hours",
        type=float,
        default=1.0,
        help="duration in simulated time [h] (default: %(default)s)",
    )
    args = parser.parse_args()
    hand = load_hand("jamia")
    plan = RunPlan(hand, Gains(), 500.0, ())
    simulator = SimulatorSettings("jamia", "none", 1, homed=True)
    with tempfile.TemporaryDirectory() as folder, simulator.lockstep_clock(plan.period_ns) as clock:
        task = Path(folder) / "long.toml"
        task.write_text(SOAK_TASK)
        program = TaskProgram(load_task(task))
        memory_sampler = MemorySampler(args.hours * 3600)
        controller = make_controller(hand, plan.gains, 500.0, program, None, arm_at_once=True)
        outcome = run_lockstep(plan, controller, Path(folder) / "long.mcap", clock, memory_sampler)
    growth_slope = memory_slope(memory_sampler.samples, WARM_UP_S)
    print(
        json.dumps(
            {
                "ticks": outcome.loop_stats.ticks,
                "failure": outcome.state.failure,
                "rss_slope_mib_per_h": growth_slope,
            }
        )
    )
    return int(
        bool(outcome.state.failure) or growth_slope is None or growth_slope > MAX_GROWTH_MIB_PER_H
    )


if __name__ == "__main__":
    sys.exit(main())
