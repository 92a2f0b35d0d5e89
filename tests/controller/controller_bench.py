"""A simple simulated hand, and a bench in which a controller runs with this hand.

The simple hand ``ToyHand`` is fast because it models much less than the simulator. All digits of
the simple hand stay fully open, and each rotor winds an elastic tendon. A test can drop, change or
add frames on their way from and to the controller.
"""

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
from tests.drives.scripted_motor import ScriptedMotor

SUBSTEPS_PER_TICK = 4
INITIAL_SLACK_M = 0.3e-3
"""Length of tendon that a rotor must wind up before the tendon is taut [m]."""


class ToyHand:
    """Simple simulated hand. A controller in lockstep calls the method ``step`` of the hand once in each tick.

    Attributes:
        motors: the scripted motors, one per tendon.
        tension: (tendons,) true tension of each tendon [N].
        cell_bias: (tendons,) error that each load cell adds to the tension [N].
        tendon_of_channel: index of the tendon whose tension each load-cell channel measures.
        silent_sensors: True if the sensor node sends no frames.
        locked_when_disabled: True if the rotor of a disabled motor cannot turn.
    """

    def __init__(self, hand: Hand, period_ns: int) -> None:
        self.hand, self.period_s = hand, period_ns * 1e-9
        motors = [hand.motor_of_tendon(name) for name in hand.tendon_names]
        self.motors = [
            ScriptedMotor(m.node_id, m.options.get("reply_id", m.node_id + 0x10)) for m in motors
        ]
        self.spool_radius = np.array([m.spool_radius_m for m in motors])
        self.motor_mass = np.array([m.inertia_kg_m2 for m in motors]) / self.spool_radius**2
        self.coulomb_friction = np.array([m.coulomb_N_m for m in motors]) / self.spool_radius
        self.tendon_stiffness = np.array([t.stiffness_N_per_m for t in hand.tendon])
        self.tendon_damping = np.full(len(self.tendon_stiffness), 150.0)
        n = len(motors)
        self.spool_travel, self.spool_speed, self.tension, self.cell_bias = (
            np.zeros(n),
            np.zeros(n),
            np.zeros(n),
            np.zeros(n),
        )
        self.tendon_of_channel, self.silent_sensors, self.locked_when_disabled = (
            list(range(n)),
            False,
            False,
        )
        self.motor_force = [0.0] * n

    def step(self, t_ns: int, frames: list[Frame]) -> list[Frame]:
        """Return the replies of the simple hand to the frames of a tick, and advance its tendons to the next tick."""
        answers: list[Frame] = []
        for sent_frame in frames:
            frame = Frame(*sent_frame)
            if frame.can_id == self.hand.sensor_node.sync_id:
                answers += [] if self.silent_sensors else self._sensor_frames(frame.data[0])
            for i, motor in enumerate(self.motors):
                motor.feedback_codes = self._feedback_codes(i)
                answers += motor.answer_frame(frame, t_ns)
                if motor.torque_codes:
                    self.motor_force[i] = (
                        motor.torque_codes.pop() / 4095.0 * 1.6 - 0.8
                    ) / self.spool_radius[i]
                if motor.state_nibble != 1:
                    self.motor_force[i] = 0.0
        self._advance_tendons()
        return [answer._replace(t_ns=t_ns + 100_000 + i) for i, answer in enumerate(answers)]

    def snap_tendon(self, tendon_index: int) -> None:
        """Tear the tendon with the index ``tendon_index``.

        A torn tendon has no tension, whatever the speed of its spool is.
        """
        self.tendon_stiffness[tendon_index] = self.tendon_damping[tendon_index] = 0.0

    def close(self) -> None:
        """Do nothing, because the simple hand has no file or connection to close."""

    def _feedback_codes(self, tendon_index: int) -> tuple[int, int, int]:
        angle, speed = (
            self.spool_travel[tendon_index] / self.spool_radius[tendon_index],
            self.spool_speed[tendon_index] / self.spool_radius[tendon_index],
        )
        torque = self.motor_force[tendon_index] * self.spool_radius[tendon_index]
        scaled = ((angle / 12.5, 65535), (speed / 50.0, 4095), (torque / 0.8, 4095))
        position, velocity, effort = (
            round((min(max(v, -1.0), 1.0) + 1) / 2 * top) for v, top in scaled
        )
        return position, velocity, effort

    def _advance_tendons(self) -> None:
        dt = self.period_s / SUBSTEPS_PER_TICK
        force = np.array(self.motor_force)
        free = np.array([motor.state_nibble == 1 for motor in self.motors]) | (
            not self.locked_when_disabled
        )
        for _ in range(SUBSTEPS_PER_TICK):
            stretch = self.spool_travel - INITIAL_SLACK_M
            self.tension = np.where(
                stretch > 0,
                np.maximum(
                    self.tendon_stiffness * stretch + self.tendon_damping * self.spool_speed, 0.0
                ),
                0.0,
            )
            friction = self.coulomb_friction * np.tanh(self.spool_speed / 2e-3)
            self.spool_speed = np.where(
                free,
                self.spool_speed + dt * (force - self.tension - friction) / self.motor_mass,
                0.0,
            )
            self.spool_travel = self.spool_travel + dt * self.spool_speed

    def _sensor_frames(self, counter: int) -> list[Frame]:
        node = self.hand.sensor_node
        cells = (self.tension + self.cell_bias)[self.tendon_of_channel]
        raw = [int(np.clip(round((f + 6.0) / 0.0625), 0, 4095)) for f in cells]
        frames = [(node.base_id, raw)]
        if node.joints and counter % node.joint_decimation == 0:
            alternating_bit = counter // node.joint_decimation % 2
            frames.append((node.base_id + 0x10, [2048 + alternating_bit] * len(node.joints)))
        return [
            frame
            for base, values in frames
            for frame in _pack_channels(base, counter & 0xF, values)
        ]


def _pack_channels(
    first_can_id: int, sync_counter: int, channel_readings: list[int]
) -> list[Frame]:
    """Pack load-cell channels into frames.

    The lowest 4 bits of each frame contain a counter. The higher bits contain up to five load-cell
    channels with 12 bits each.
    """
    frames = []
    for group, start in enumerate(range(0, len(channel_readings), 5)):
        frame_readings = channel_readings[start : start + 5]
        bits = sync_counter | sum(value << (4 + 12 * i) for i, value in enumerate(frame_readings))
        frames.append(
            Frame(
                first_can_id + group,
                bits.to_bytes((4 + 12 * len(frame_readings) + 7) // 8, "little"),
            )
        )
    return frames


def uncommissioned_controller(
    model: HandModel, program: Program, arms_at_start: bool = True
) -> Controller:
    """Return a controller of a hand that has not been commissioned."""
    hand, n = model.hand, model.tendon_count
    buses = hand.bus_names
    motors = [hand.motor_of_tendon(name) for name in hand.tendon_names]
    drives = tuple(MitDrive.from_motor(motor, buses.index(motor.bus)) for motor in motors)
    sensors = SensorNode.from_description(hand.sensor_node, 0, hand.tendon_names, hand.joints)
    return Controller(
        model, drives, sensors, program, np.zeros(n), np.zeros(n), arm_at_once=arms_at_start
    )


@dataclass
class ControllerBench:
    """Bench in which a controller and the simple hand ``ToyHand`` run tick by tick.

    Attributes:
        controller: the controller under test.
        toy_hand: the simple hand, which replies to the controller.
        modify_frames_to_host, modify_frames_to_nodes: functions that change the frames of a tick on
            their way to the host and to the nodes.
        tick_history: for every tick so far, its input, its output, and the state of the controller
            before the tick.
    """

    controller: Controller
    toy_hand: ToyHand
    modify_frames_to_host: Callable[[list[Frame]], list[Frame]] = lambda frames: frames
    modify_frames_to_nodes: Callable[[list[Frame]], list[Frame]] = lambda frames: frames
    tick_history: list[tuple[ControllerState, TickIn, TickOut]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.state, self.k, self.frames_on_bus = self.controller.initial_state(), 0, list[Frame]()
        self.period_ns = round(self.controller.model.period * 1e9)

    def tick(
        self,
        *requests: str,
        io_events: tuple[IoEvent, ...] = (),
        lateness_ns: int = 0,
        missed_ticks: int = 0,
        extra_frames: tuple[Frame, ...] = (),
    ) -> TickOut:
        """Let the controller miss ``missed_ticks`` ticks, then run one tick of the controller."""
        for _ in range(missed_ticks):
            self.frames_on_bus += self.toy_hand.step(self.k * self.period_ns, [])
            self.k += 1
        t_ns = self.k * self.period_ns
        entry = TickIn(
            self.k,
            t_ns,
            lateness_ns,
            (*self.modify_frames_to_host(self.frames_on_bus), *extra_frames),
            io_events,
            requests,
        )
        state_before = self.state
        self.state, tick_output = self.controller.tick(state_before, entry)
        self.tick_history.append((state_before, entry, tick_output))
        self.frames_on_bus = self.toy_hand.step(
            t_ns, self.modify_frames_to_nodes(list(tick_output.frames))
        )
        self.k += 1
        return tick_output

    def run_until_mode(self, mode: HandMode, timeout_s: float = 12.0) -> TickOut:
        """Run ticks until the controller enters a mode."""
        for _ in range(round(timeout_s / self.controller.model.period)):
            tick_output = self.tick()
            if tick_output.mode == mode:
                return tick_output
        raise AssertionError(
            f"{mode.name} is not reached: {self.state.mode.name}, {self.events[-3:]}"
        )

    def run(self, duration_s: float) -> TickOut:
        """Run ticks of the controller for a given duration."""
        for _ in range(round(duration_s / self.controller.model.period)):
            tick_output = self.tick()
        return tick_output

    @property
    def mode_history(self) -> list[HandMode]:
        """Return all modes that the controller has had so far, in their order."""
        modes: list[HandMode] = []
        for _, _, tick_output in self.tick_history:
            if not modes or modes[-1] != tick_output.mode:
                modes.append(tick_output.mode)
        return modes

    @property
    def events(self) -> list[TickEvent]:
        """Return all events that the controller has emitted so far."""
        return [event for _, _, tick_output in self.tick_history for event in tick_output.events]


def make_controller_bench(
    model: HandModel, program: Program, arms_at_start: bool = True
) -> ControllerBench:
    """Return a bench that connects a controller with a ``ToyHand``, a simple hand without faults."""
    return ControllerBench(
        uncommissioned_controller(model, program, arms_at_start),
        ToyHand(model.hand, round(model.period * 1e9)),
    )
