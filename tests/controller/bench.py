"""A hand with scripted motors, tendons and load cells, and a bench that runs a controller tick by tick with it.

This hand models much less than the simulator, and is therefore fast. Every digit stands on its open
stop, and its rotor winds an elastic tendon against the stop. A test can lose, change or invent
frames in both directions.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from handctl.controller.controller_state import ControllerState
from handctl.controller.tick import Controller
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, IoEvent, TickEvent, TickIn, TickOut
from handctl.drives.frame import Frame
from handctl.drives.mit.drive import MitDrive
from handctl.drives.sensors.sensor_node import SensorNode
from handctl.hand.description import Hand
from handctl.programs.program import Program
from tests.drives.motor import ScriptedMotor

SUBSTEPS = 4
SLACK_M = 0.3e-3
"""Length that a rotor must wind before its tendon is taut [m]."""


class ToyHand:
    """The simulated hand. A controller in lockstep calls its ``step`` once in each tick.

    Attributes:
        motors: the scripted motors, one per tendon.
        tension: (N,) true tension of each tendon [N].
        bias: (N,) error that each load cell adds to the tension [N].
        order: index of the tendon that each load-cell channel measures.
        silent_sensors: whether the sensor node sends no frames.
        braked: whether the rotor of a disabled motor stands still.
    """

    def __init__(self, hand: Hand, period_ns: int) -> None:
        self.hand, self.period_s = hand, period_ns * 1e-9
        motors = [hand.motor_of(name) for name in hand.tendon_names]
        self.motors = [
            ScriptedMotor(m.node_id, m.options.get("reply_id", m.node_id + 0x10)) for m in motors
        ]
        self.spool = np.array([m.spool_radius_m for m in motors])
        self.mass = np.array([m.inertia_kg_m2 for m in motors]) / self.spool**2
        self.coulomb = np.array([m.coulomb_N_m for m in motors]) / self.spool
        self.stiffness = np.array([t.stiffness_N_per_m for t in hand.tendon])
        self.damping = np.full(len(self.stiffness), 150.0)
        n = len(motors)
        self.x, self.v, self.tension, self.bias = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self.order, self.silent_sensors, self.braked = list(range(n)), False, False
        self.force_of = [0.0] * n

    def step(self, t_ns: int, frames: list[Frame]) -> list[Frame]:
        """Reply to the frames of a tick, and advance the tendons to the next tick."""
        answers: list[Frame] = []
        for raw in frames:
            frame = Frame(*raw)
            if frame.can_id == self.hand.sensor_node.sync_id:
                answers += [] if self.silent_sensors else self._sensors(frame.data[0])
            for i, motor in enumerate(self.motors):
                motor.codes = self._codes(i)
                answers += motor.answer(frame, t_ns)
                if motor.torques:
                    self.force_of[i] = (motor.torques.pop() / 4095.0 * 1.6 - 0.8) / self.spool[i]
                if motor.nibble != 1:
                    self.force_of[i] = 0.0
        self._move()
        return [answer._replace(t_ns=t_ns + 100_000 + i) for i, answer in enumerate(answers)]

    def tear(self, i: int) -> None:
        """Tear tendon i. From then on its tension is zero, at any speed of its spool."""
        self.stiffness[i] = self.damping[i] = 0.0

    def close(self) -> None:
        """Do nothing, because this peer has nothing to close."""

    def _codes(self, i: int) -> tuple[int, int, int]:
        angle, speed = self.x[i] / self.spool[i], self.v[i] / self.spool[i]
        torque = self.force_of[i] * self.spool[i]
        scaled = ((angle / 12.5, 65535), (speed / 50.0, 4095), (torque / 0.8, 4095))
        position, velocity, effort = (
            round((min(max(v, -1.0), 1.0) + 1) / 2 * top) for v, top in scaled
        )
        return position, velocity, effort

    def _move(self) -> None:
        dt = self.period_s / SUBSTEPS
        force = np.array(self.force_of)
        free = np.array([motor.nibble == 1 for motor in self.motors]) | (not self.braked)
        for _ in range(SUBSTEPS):
            stretch = self.x - SLACK_M
            self.tension = np.where(
                stretch > 0, np.maximum(self.stiffness * stretch + self.damping * self.v, 0.0), 0.0
            )
            friction = self.coulomb * np.tanh(self.v / 2e-3)
            self.v = np.where(
                free, self.v + dt * (force - self.tension - friction) / self.mass, 0.0
            )
            self.x = self.x + dt * self.v

    def _sensors(self, counter: int) -> list[Frame]:
        node = self.hand.sensor_node
        cells = (self.tension + self.bias)[self.order]
        raw = [int(np.clip(round((f + 6.0) / 0.0625), 0, 4095)) for f in cells]
        frames = [(node.base_id, raw)]
        if node.joints and counter % node.joint_decimation == 0:
            flicker = counter // node.joint_decimation % 2
            frames.append((node.base_id + 0x10, [2048 + flicker] * len(node.joints)))
        return [
            frame
            for base, values in frames
            for frame in _pack_channels(base, counter & 0xF, values)
        ]


def _pack_channels(base: int, counter: int, values: list[int]) -> list[Frame]:
    """Pack up to five channels of 12 bits into each frame, after a counter of four bits, from the lowest bit."""
    frames = []
    for group, start in enumerate(range(0, len(values), 5)):
        part = values[start : start + 5]
        bits = counter | sum(value << (4 + 12 * i) for i, value in enumerate(part))
        frames.append(Frame(base + group, bits.to_bytes((4 + 12 * len(part) + 7) // 8, "little")))
    return frames


def register(value: float) -> bytes:
    """Return the bytes of a register's float value in the order in which they are sent on the bus."""
    return struct.pack("<f", value)


def controller(model: HandModel, program: Program, arm: bool = True) -> Controller:
    """Return a controller of all tendons of a hand that is not commissioned."""
    hand, n = model.hand, model.tendon_count
    buses = hand.bus_names
    motors = [hand.motor_of(name) for name in hand.tendon_names]
    drives = tuple(MitDrive.from_motor(motor, buses.index(motor.bus)) for motor in motors)
    sensors = SensorNode.from_description(hand.sensor_node, 0, hand.tendon_names, hand.joints)
    return Controller(model, drives, sensors, program, np.zeros(n), np.zeros(n), arm_at_once=arm)


@dataclass
class Bench:
    """A controller and the simulated hand, tick by tick.

    Attributes:
        controller: the controller under test.
        peer: the simulated hand that replies to the controller.
        to_host, to_nodes: functions that change the frames of a tick on their way to the host or to the nodes.
        history: input and output of every tick so far, with the controller's state before the tick.
    """

    controller: Controller
    peer: ToyHand
    to_host: Callable[[list[Frame]], list[Frame]] = lambda frames: frames
    to_nodes: Callable[[list[Frame]], list[Frame]] = lambda frames: frames
    history: list[tuple[ControllerState, TickIn, TickOut]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.state, self.k, self.waiting = self.controller.initial_state(), 0, list[Frame]()
        self.period_ns = round(self.controller.model.period * 1e9)

    def tick(
        self,
        *requests: str,
        io: tuple[IoEvent, ...] = (),
        late_ns: int = 0,
        skip: int = 0,
        extra: tuple[Frame, ...] = (),
    ) -> TickOut:
        """Run one tick of the controller, after ``skip`` ticks that it missed."""
        for _ in range(skip):
            self.waiting += self.peer.step(self.k * self.period_ns, [])
            self.k += 1
        t_ns = self.k * self.period_ns
        entry = TickIn(self.k, t_ns, late_ns, (*self.to_host(self.waiting), *extra), io, requests)
        before = self.state
        self.state, out = self.controller.tick(before, entry)
        self.history.append((before, entry, out))
        self.waiting = self.peer.step(t_ns, self.to_nodes(list(out.frames)))
        self.k += 1
        return out

    def until(self, mode: HandMode, timeout: float = 12.0) -> TickOut:
        """Run ticks until the controller enters a mode."""
        for _ in range(round(timeout / self.controller.model.period)):
            out = self.tick()
            if out.mode == mode:
                return out
        raise AssertionError(
            f"{mode.name} is not reached: {self.state.mode.name}, {self.events[-3:]}"
        )

    def run(self, seconds: float) -> TickOut:
        """Run ticks for a duration."""
        for _ in range(round(seconds / self.controller.model.period)):
            out = self.tick()
        return out

    @property
    def modes(self) -> list[HandMode]:
        """Return the modes of the controller so far, in order."""
        seen: list[HandMode] = []
        for _, _, out in self.history:
            if not seen or seen[-1] != out.mode:
                seen.append(out.mode)
        return seen

    @property
    def events(self) -> list[TickEvent]:
        """Return all events that the controller has emitted so far."""
        return [event for _, _, out in self.history for event in out.events]


def bench(model: HandModel, program: Program, arm: bool = True) -> Bench:
    """Return a bench that connects a controller with a hand without faults."""
    return Bench(controller(model, program, arm), ToyHand(model.hand, round(model.period * 1e9)))
