"""Test bench in the simulator, for the experiments of the paper.

The real controller runs in lockstep with a simulated hand, over a simulated bus.
"""

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickIn, TickOut, Vector
from handctl.errors import DriveError
from handctl.hand.hand_loading import load_hand
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import (
    SimulatorSettings,
    homed_controller,
    simulate_controller,
)

RATE_HZ = 500.0
"""Control rate of all experiments [Hz]."""


@dataclass
class BenchRecording:
    """Measurements and task phases of a run on the simulated test bench, for every tick.

    Attributes:
        t_ns: time of each tick [ns].
        phase: phase of the task in each tick.
        tension: (ticks, N) readings of the load cells [N].
        travel: (ticks, N) readings of the motor encoders [rad].
    """

    t_ns: list[int] = field(default_factory=list)
    phase: list[str] = field(default_factory=list)
    tension: list[Vector] = field(default_factory=list)
    travel: list[Vector] = field(default_factory=list)

    def record(self, entry: TickIn, tick_output: TickOut) -> None:
        """Append the time, the phase, the tensions and the motor positions of a tick to the lists."""
        self.t_ns.append(entry.t_ns)
        self.phase.append(tick_output.phase)
        self.tension.append(tick_output.telemetry.tension_raw)
        self.travel.append(tick_output.telemetry.motor_position)

    def mask_of_phase(self, name: str) -> Vector:
        """Return a mask (ticks,) that is True in the ticks of the given phase."""
        return np.array([phase == name for phase in self.phase])


def run_bench_task(
    hand_file: str, scene: str | None, task: Task, truth: Path | None = None, seed: int = 0
) -> BenchRecording:
    """Run a task on a simulated hand that is already homed and tared.

    Args:
        hand_file: name of a packaged hand, or path of a hand file.
        scene: scene for the simulator.
        task: task of the controller.
        truth: file to which the simulator writes the ground truth, or None.
        seed: seed of the simulated noise.

    Raises:
        DriveError: the controller or the safety monitor ended the run early.
    """
    model = _hand_model(hand_file)
    recording = BenchRecording()
    simulator_settings = SimulatorSettings(hand_file, scene, seed, homed=True, truth=truth)
    state = simulate_controller(
        homed_controller(model, TaskProgram(task)), simulator_settings, recording.record
    )
    if state.failure:
        raise DriveError(state.failure, f"{task.name} with {model.hand.name} in the simulator")
    return recording


@cache
def _hand_model(hand_file: str) -> HandModel:
    """Return the model of a hand, including the gains that are designed for this hand.

    The function caches the model, because the design of the gains takes about a second.
    """
    return HandModel.from_hand(load_hand(hand_file), Gains(), RATE_HZ)
