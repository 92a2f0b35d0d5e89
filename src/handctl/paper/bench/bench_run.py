"""Simulated bench: the real controller over the simulated bus, in lockstep."""

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from handctl.core.gains.gains import Gains
from handctl.core.model import HandModel
from handctl.core.types import TickIn, TickOut, Vector
from handctl.errors import DriveError
from handctl.hand.load import load_hand
from handctl.programs.grasp import TaskProgram
from handctl.programs.task import Task
from handctl.session.simulate import Simulator, homed_controller, simulate

RATE_HZ = 500.0
"""Control rate of all experiments [Hz]."""


@dataclass
class BenchRecording:
    """Measurements and decisions of the controller, tick by tick.

    Attributes:
        t_ns: time of each tick [ns].
        phase: phase of each tick.
        tension: (ticks, N) load cells [N].
        travel: (ticks, N) motor encoders [rad].
    """

    t_ns: list[int] = field(default_factory=list)
    phase: list[str] = field(default_factory=list)
    tension: list[Vector] = field(default_factory=list)
    travel: list[Vector] = field(default_factory=list)

    def record(self, entry: TickIn, out: TickOut) -> None:
        """Record the input and output of a tick."""
        self.t_ns.append(entry.t_ns)
        self.phase.append(out.phase)
        self.tension.append(out.telemetry.tension_raw)
        self.travel.append(out.telemetry.motor_position)

    def in_phase(self, name: str) -> Vector:
        """Return a mask (ticks,) that is True for the ticks of a phase."""
        return np.array([phase == name for phase in self.phase])


def run_bench_task(
    hand_file: str, scene: str | None, task: Task, truth: Path | None = None, seed: int = 0
) -> BenchRecording:
    """Run a task on the simulator with a homed hand.

    Args:
        hand_file: name of a packaged hand, or path of a hand file.
        scene: scene of the simulator.
        task: task of the controller.
        truth: path of the file for the simulator's ground truth.
        seed: seed of the noise.

    Raises:
        DriveError: The run ended early, by the controller or by the safety monitor.
    """
    model = _hand_model(hand_file)
    recording = BenchRecording()
    bench = Simulator(hand_file, scene, seed, homed=True, truth=truth)
    state = simulate(homed_controller(model, TaskProgram(task)), bench, recording.record)
    if state.failure:
        raise DriveError(state.failure, f"{task.name} with {model.hand.name} in the simulator")
    return recording


@cache
def _hand_model(hand_file: str) -> HandModel:
    """Return the model of a hand. The gains are designed only once, which takes about a second."""
    return HandModel.of(load_hand(hand_file), Gains(), RATE_HZ)
