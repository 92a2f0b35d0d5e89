"""A hand on the simulator's bench: the real controller over the simulated bus, in lockstep."""

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from handctl.controller.gains import Gains
from handctl.controller.grasp import TaskProgram
from handctl.controller.model import HandModel
from handctl.controller.state import State
from handctl.controller.task import Task
from handctl.controller.tick import Controller
from handctl.controller.types import IoEvent, TickIn, TickOut, Vector
from handctl.drives.registry import make_drive
from handctl.drives.sensors.node import SensorNode
from handctl.errors import DriveError
from handctl.hand.load import load_hand
from handctl.runtime.lockstep import SIMULATED_HAND, LockstepBus, LockstepClock, load_peer
from handctl.runtime.loop import Loop

RATE_HZ = 500.0
PERIOD_NS = round(1e9 / RATE_HZ)


@dataclass
class Recording:
    """What the controller read from the bus and decided, tick by tick.

    Attributes:
        t_ns: of each tick.
        phase: of each tick.
        tension: (ticks, N) load cells [N].
        travel: (ticks, N) motor encoders [rad].
    """

    t_ns: list[int] = field(default_factory=list)
    phase: list[str] = field(default_factory=list)
    tension: list[Vector] = field(default_factory=list)
    travel: list[Vector] = field(default_factory=list)

    def take(self, entry: TickIn, out: TickOut) -> None:
        """Take down one tick."""
        self.t_ns.append(entry.t_ns)
        self.phase.append(out.phase)
        self.tension.append(out.telemetry.tension_raw)
        self.travel.append(out.telemetry.motor_position)

    def in_phase(self, name: str) -> Vector:
        """(ticks,) whether each tick belongs to a phase."""
        return np.array([phase == name for phase in self.phase])


def run(hand_file: str, scene: str | None, task: Task, truth: Path | None = None, seed: int = 0) -> Recording:
    """Let a homed hand carry out a task against the simulator.

    Args:
        hand_file: packaged name or file.
        scene: of the simulator.
        task: what the controller does.
        truth: where the simulator writes what really happened.
        seed: of its noise.

    Raises:
        DriveError: the controller gave up or safety ended the run.
    """
    model = _model(hand_file)
    path = None if truth is None else str(truth)
    peer = load_peer(
        SIMULATED_HAND, hand_path=hand_file, scene=scene, seed=seed, period_ns=PERIOD_NS, truth_path=path, homed=True
    )
    clock, recording = LockstepClock(peer, PERIOD_NS), Recording()
    controller = _controller(model, TaskProgram(task))
    try:
        state = _loop(clock, controller, recording).run(controller.initial())
    finally:
        peer.close()
    if state.failure:
        raise DriveError(state.failure, f"{task.name} with {model.hand.name} in the simulator")
    return recording


def _controller(model: HandModel, program: TaskProgram) -> Controller:
    """The same controller that ``handctl run`` puts together, on a bench where nothing needs a tare."""
    hand = model.hand
    buses, nothing = hand.bus_names, np.zeros(len(hand.tendon))
    motors = [hand.motor_of(name) for name in hand.tendon_names]
    drives = tuple(make_drive(motor, buses.index(motor.bus)) for motor in motors)
    sensors = SensorNode.of(hand.sensor_node, buses.index(hand.sensor_node.bus), hand.tendon_names, hand.joints)
    return Controller.of(model, drives, sensors, program, nothing, nothing)


@cache
def _model(hand_file: str) -> HandModel:
    """Gains are designed once for a hand, which takes a second."""
    return HandModel.of(load_hand(hand_file), Gains(), RATE_HZ)


def _loop(clock: LockstepClock, controller: Controller, recording: Recording) -> Loop[State]:
    def no_requests() -> tuple[str, ...]:
        return ()

    def no_events() -> list[IoEvent]:
        return []

    def show_nothing(entry: TickIn, out: TickOut) -> None:
        return

    buses = [LockstepBus(clock)]
    cut = controller.cut_frames()
    return Loop(clock, PERIOD_NS, buses, controller.tick, cut, no_requests, no_events, recording.take, show_nothing)
