"""Controller and simulated hand in lockstep, without a recorder.

The script ``lockstep.py`` measures the speed of the controller and of the simulated hand.
"""

import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

import numpy as np

from handctl.controller.run_setup import make_controller
from handctl.core.gains.gains import Gains
from handctl.hand.hand_loading import load_hand
from handctl.programs.task import load_task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatorSettings

CONTROL_RATES_HZ = {"jamia": 500.0, "jamia11": 200.0}
"""Default control rate of each hand on one classical bus [Hz]."""
TASK_HEADER = 'schema = 1\nname = "benchmark"\ndescription = "for lockstep.py"\n'


@dataclass(frozen=True)
class FreeMotionSetup:
    """Setup of a run that moves the fingers in a scene without an object."""

    scene: ClassVar[str | None] = None
    task: ClassVar[str] = (
        '[[phase]]\nkind = "move"\nname = "out"\nangle_deg = 25.0\nduration_s = 0.5\n'
        '[[phase]]\nkind = "move"\nname = "back"\nangle_deg = 5.0\nduration_s = 0.5\n'
    )
    repeat_count: ClassVar[int] = 9


@dataclass(frozen=True)
class GraspSetup:
    """Setup of a run that grasps a cylinder from a table and holds the cylinder."""

    scene: ClassVar[str | None] = "cylinder"
    task: ClassVar[str] = (
        '[[phase]]\nkind = "move"\nname = "preshape"\nduration_s = 0.4\n'
        "angle_deg = { index = 18.0, middle = 18.0, ring = 18.0, thumb = 3.0 }\n"
        '[[phase]]\nkind = "close"\nangle_deg = 85.0\nspeed_deg_s = 120.0\ncontact_tension_N = 14.0\n'
        '[[phase]]\nkind = "hold"\ntension_N = 24.0\nrate_N_per_s = 80.0\nduration_s = 9.0\n'
    )
    repeat_count: ClassVar[int] = 1


class LockstepStack:
    """A simulated hand with known motor zeros, and a controller of this hand.

    Controller and simulated hand run tick by tick.

    Attributes:
        engine: rigid bodies and contact.
        simulation: state of the simulated run.
        peer: simulated hand. The nodes of the simulated hand exchange frames with the controller.
    """

    def __init__(
        self, hand_name: str, rate_hz: float, setup: type[FreeMotionSetup | GraspSetup]
    ) -> None:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "task.toml"
            path.write_text(TASK_HEADER + setup.task * setup.repeat_count)
            program = TaskProgram(load_task(path))
        controller = make_controller(
            load_hand(hand_name), Gains(), rate_hz, program, None, arm_at_once=True
        )
        self._open = ExitStack()
        self.simulation = self._open.enter_context(
            SimulatorSettings(hand_name, setup.scene, homed=True).begin_run(controller)
        )
        self.simulation.are_ticks_recorded = False
        self.peer = self.simulation.simulated_hand
        self.engine = self.peer.world.plant.engine

    def run(self, simulated_s: float) -> list[float]:
        """Run controller and simulator for a simulated time [s]. Return the CPU time of each tick [s]."""
        tick = self.simulation.run_tick
        step_times = []
        read_cpu_time = time.process_time
        for _ in range(round(simulated_s * 1e9) // self.simulation.period_ns):
            start_time_s = read_cpu_time()
            tick()
            step_times.append(read_cpu_time() - start_time_s)
        return step_times

    def simulator_tick_times(self, simulated_s: float) -> list[float]:
        """Run controller and simulator for a simulated time [s].

        Return the CPU time of the simulator in each tick, including MuJoCo [s].
        """
        clock = self.simulation._clock
        tick_times = []
        read_cpu_time = time.process_time
        exchange = clock._exchange

        def timed_exchange(t_ns: int, records: np.ndarray) -> np.ndarray:
            start_time_s = read_cpu_time()
            answer_frames = exchange(t_ns, records)
            tick_times.append(read_cpu_time() - start_time_s)
            return answer_frames

        clock._exchange = timed_exchange
        self.run(simulated_s)
        return tick_times
