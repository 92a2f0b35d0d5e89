"""Plant and nodes together, driven by time and frames; knows neither sockets nor clocks.

What is injected stands between the nodes and the wire, in a node, a sensor or the plant: see ``faults``.
"""

import random
from operator import itemgetter
from typing import Any

import numpy as np

from firmware_sim.bus.frame import Frame
from firmware_sim.bus.records import to_frames, to_records
from firmware_sim.compiled import array_of, use
from firmware_sim.description import Hand, MotorSpec, SensorSpec, SimulatorError
from firmware_sim.exchange import Exchange
from firmware_sim.faults.active import Faults
from firmware_sim.nodes import PROTOCOLS, noise, sensors
from firmware_sim.nodes.cyclic import NEVER_NS
from firmware_sim.nodes.kind import SENSORS, DriveNode, Node
from firmware_sim.nodes.mit import codec as mit_codec
from firmware_sim.nodes.sensors import SensorNode, SensorNodeRow, SensorRow
from firmware_sim.plant.plant import STEP_NS, Plant
from firmware_sim.scene.scene import Scene
from firmware_sim.truth import TruthWriter

_ARRIVAL_NS = itemgetter(4)
MAX_ENCODER_OFFSET_RAD = 0.5
"""Angle that an encoder may show at theta = 0 when not homed; small against PMAX and the 3 rad of a grasp."""


class World:
    """The other side of the wire.

    Power-up, unless homed: each rope hangs slack by 1 to 3 mm (the motors were limp) and each encoder shows an angle
    within 0.5 rad of its ``zero_rad`` at the point where the rope is just taut at q = 0 (a spool clamped by hand). Both
    are seeded. A homed world starts with taut ropes and the encoders at ``zero_rad``.

    Attributes:
        plant: the mechanics.
        nodes: for each bus of the hand, what sits on it.
        t_ns: the clock of plant and nodes [ns].
        foreign: frames that no node knew.
        sensor_node: the load cells and joint encoders.
        faults: what is injected.
        encoder_offset: angle each encoder shows at theta = 0, by motor [rad].
    """

    def __init__(
        self,
        hand: Hand,
        scene: Scene,
        seed: int = 0,
        homed: bool = False,
        origin_ns: int = 0,
        compiled: bool = True,
    ) -> None:
        """Build plant and nodes.

        Args:
            hand: the hand. scene: object and support. seed: of everything random. homed: whether it starts homed.
            origin_ns: the clock at the start [ns]. compiled: whether laws are, see ``Plant``.
        """
        self.hand, self.seed, self.homed = hand, seed, homed
        self.plant = Plant(hand, scene, seed, homed, compiled)
        if compiled:
            for module in (mit_codec, sensors, noise):
                use(module)
        self.t_ns = self._origin_ns = origin_ns
        self.foreign = 0
        chance = random.Random(f"encoders {seed}")
        spread = 0.0 if homed else MAX_ENCODER_OFFSET_RAD
        self.encoder_offset = {motor.name: motor.zero + chance.uniform(-spread, spread) for motor in hand.motors}
        self.nodes: list[list[Node]] = [[] for _ in hand.buses]
        self.row_of: dict[int, tuple[int, int]] = {}
        rows: dict[type, Any] = {}
        self._motor_nodes = self._drives(compiled, rows)
        for motor in hand.motors:
            self.nodes[self._bus(motor.bus)].append(self._motor_nodes[motor.name])
        if hand.sensors:
            self.sensor_node = self._sensor_node(hand.sensors, compiled, rows)
            self.nodes[self._bus(hand.sensors.bus)].append(self.sensor_node)
        self._all = [(index, node) for index, bus in enumerate(self.nodes) for node in bus]
        self._without_row = [node for _, node in self._all if id(node) not in self.row_of]
        self._by_id: list[dict[int, list[tuple[Node, frozenset[int] | None]]]]
        self.exchange = Exchange(self, rows) if compiled else None
        self.look_again()
        self._spoken: list[Frame] = []
        self.faults = Faults(self)
        self._truth: TruthWriter | None = None
        self.slip_ns = 0

    def _bus(self, name: str) -> int:
        if name not in self.hand.buses:
            raise SimulatorError(f"{self.hand.name}: no bus {name}; expected one of {', '.join(self.hand.buses)}")
        return self.hand.buses.index(name)

    def _drives(self, compiled: bool, rows: dict[type, Any]) -> dict[str, DriveNode]:
        """Return the node of each motor by its name; those with rows are noted in ``rows`` and ``row_of``."""
        nodes: dict[str, DriveNode] = {}
        for motor in self.hand.motors:
            if motor.protocol not in PROTOCOLS:
                known = ", ".join(PROTOCOLS)
                raise SimulatorError(
                    f"{motor.name}: protocol {motor.protocol} is not simulated; expected one of {known}"
                )
        for protocol, kind in PROTOCOLS.items():
            motors = [motor for motor in self.hand.motors if motor.protocol == protocol]
            memory: Any = (kind.row * len(motors))() if compiled and kind.row else [None] * len(motors)
            for number, (motor, row) in enumerate(zip(motors, memory, strict=True)):
                about = motor, self.plant.motors[motor.name], self.encoder_offset[motor.name]
                if row is None:
                    nodes[motor.name] = kind.node(*about)
                    continue
                row.prepare(*about)
                row.bus = self._bus(motor.bus)
                nodes[motor.name], self.row_of[id(row)] = row, (kind.taker, number)
            if compiled and kind.row:
                rows[kind.row.layout] = array_of(memory, kind.row.layout)
        return nodes

    def _sensor_node(self, spec: SensorSpec, compiled: bool, rows: dict[type, Any]) -> SensorNode:
        plant, joints = self.plant, self.hand.joints
        names = [tendon.name for tendon in self.hand.tendons]
        tendon_order = np.array([names.index(name) for name in spec.tendons], np.int64)
        joint_order = np.array([joints.index(name) for name in spec.joints], np.int64)
        self.sensor_orders = tendon_order, joint_order
        about = spec, lambda: plant.cells()[tendon_order], lambda: plant.engine.q[joint_order], self.seed
        if not compiled:
            return SensorNode(*about)
        memory = (SensorNodeRow * 1)()
        node: SensorNodeRow = memory[0]
        node.prepare(*about)
        rows[SensorRow] = array_of(memory, SensorRow)
        self.row_of[id(node)] = SENSORS, 0
        return node

    def motor_spec(self, name: str) -> MotorSpec:
        """Return the description of a motor."""
        return next(motor for motor in self.hand.motors if motor.name == name)

    def node_of(self, name: str) -> Node:
        """Return the node of a motor."""
        return self._motor_nodes[name]

    def host_frame(self, name: str) -> Frame:
        """Return a frame that only the host of a motor may send, and that does nothing to it."""
        spec = self.motor_spec(name)
        can_id, data = PROTOCOLS[spec.protocol].host_frame(spec.node_id)
        return Frame(can_id, data, 0, self._bus(spec.bus), self.t_ns)

    def record(self, truth: TruthWriter) -> None:
        """Have every millisecond of plant time written down."""
        self._truth = truth

    def receive(self, frame: Frame) -> list[Frame]:
        """Hand a frame to the nodes of its bus and return their answers, stamped with the present time."""
        answers: list[Frame] = []
        known, t_ns, bus, faults = False, self.t_ns, frame[3], self.faults
        struck = faults.struck  # by a fault that may have something to do with frames for others
        takers = self._all_of[bus] if struck else self._by_id[bus].get(frame[0]) or self._takers(bus, frame[0])
        for node, ids in takers:
            replies = faults.exchange(node, frame, t_ns) if struck else node.receive(frame, t_ns)
            if node.ids is not ids:
                self.look_again()
            if replies is not None:
                known = True
                answers += replies
        if not known:
            self.foreign += 1
        for i, (can_id, data, flags, at_bus, at_ns) in enumerate(answers):
            if at_bus != bus or at_ns != t_ns:
                answers[i] = Frame(can_id, data, flags, bus, t_ns)
        return answers

    def heeds(self, frame: Frame) -> bool:
        """Return whether any node may answer a frame, which would sample the plant."""
        return bool(self._by_id[frame[3]].get(frame[0]) or self._takers(frame[3], frame[0]))

    def _takers(self, bus: int, can_id: int) -> list[tuple[Node, frozenset[int] | None]]:
        """Return the nodes that may answer an identifier, each with all of its own as they were when it was asked."""
        takers = [(node, ids) for node, ids in self._all_of[bus] if ids is None or can_id in ids]
        self._by_id[bus][can_id] = takers
        return takers

    def look_again(self) -> None:
        """Ask the nodes again who they are."""
        self._all_of = [[(node, node.ids) for node in bus] for bus in self.nodes]
        self._by_id = [{} for _ in self.nodes]
        if self.exchange:
            self.exchange.look_again()

    def advance(self, t_ns: int, known_wake_ns: int | None = None) -> None:
        """Let time pass until t_ns, in whole steps; what is left over waits for the next call.

        Args: t_ns: end [ns]. known_wake_ns: when time must pass for a drive with a row next [ns], if that is known.
        """
        plant, truth, faults = self.plant, self._truth, self.faults
        now_ns = self.t_ns - plant.part_ns
        if now_ns + STEP_NS > t_ns:
            return
        wake_ns = self._next_wake(known_wake_ns)
        while now_ns + STEP_NS <= t_ns:
            until_ns = t_ns
            if truth is not None:
                self._take_down(now_ns)
                until_ns = min(until_ns, now_ns + truth.due_ns - plant.t_ns)
            if faults.on:
                until_ns = min(until_ns, now_ns if plant.struck else faults.due_ns())
            count = _steps(now_ns, min(until_ns, wake_ns), t_ns)
            plant.advance(count)
            now_ns += count * STEP_NS
            if now_ns >= wake_ns:
                wake_ns = self._next_wake(self._wake(now_ns))
            if faults.on:
                self.t_ns = now_ns
                self._spoken += faults.advance(now_ns)
                wake_ns = self._next_wake()
        self.t_ns = now_ns

    def reach(self, t_ns: int) -> None:
        """Let time pass until exactly t_ns: what is sampled now is sampled at its instant, not up to a step before.

        Steps keep their places in time; the one around t_ns is divided, and the next call completes it.
        """
        self.advance(t_ns)
        rest_ns = t_ns - self.t_ns
        if rest_ns > 0:
            if not self.plant.part_ns:
                self._take_down(self.t_ns)
            self.plant.advance_part(rest_ns)
            self.t_ns = t_ns

    def _take_down(self, now_ns: int) -> None:
        """Write a row of the truth if one is due."""
        truth, plant = self._truth, self.plant
        if truth is not None and plant.t_ns >= truth.due_ns:
            truth.write(now_ns + self.slip_ns, plant)

    def _next_wake(self, known_ns: int | None = None) -> int:
        """Return when time must pass for a node next [ns]; ``known_ns``: for those with rows, if that is known."""
        if not self.exchange:
            return min([node.wake_ns for _, node in self._all], default=NEVER_NS)
        wake_ns = self.exchange.next_wake() if known_ns is None else known_ns
        return min(wake_ns, *[node.wake_ns for node in self._without_row]) if self._without_row else wake_ns

    def _wake(self, now_ns: int) -> int | None:
        """Wake the nodes whose time has come, and keep what they say; return when rows are due next [ns] if known."""
        if self.exchange and not self._without_row and self.exchange.speak(now_ns):
            return self.exchange.wake_ns
        for bus, node in self._all:
            if now_ns >= node.wake_ns:
                spoken = node.wake(now_ns)
                if spoken:
                    told = [frame._replace(bus=bus, t_ns=now_ns) for frame in spoken]
                    self._spoken += self.faults.spoken(node, told, now_ns) if self.faults.on else told
        return None

    def hear(self, frames: list[Frame]) -> None:
        """Have frames on the bus that no node of this hand sends."""
        self._spoken += frames

    def take_spoken(self) -> list[Frame]:
        """Return what nodes have sent of their own accord since the last call."""
        spoken, self._spoken = self._spoken, []
        if self.exchange and len(said := self.exchange.take_said()):
            return sorted(to_frames(said) + spoken, key=_ARRIVAL_NS)
        return spoken

    def take_spoken_records(self) -> Any:
        """Return the same as an array of ``records.RECORD``, valid until more is sent."""
        assert self.exchange
        return to_records(self.take_spoken()) if self._spoken else self.exchange.take_said()

    @property
    def malformed(self) -> int:
        """Frames that a node could not read."""
        return sum(node.malformed for _, node in self._all)

    def header(self, clock: str) -> dict[str, object]:
        """Return what the head of a truth file says about this world."""
        return {
            "clock": clock,
            "seed": self.seed,
            "hand": self.hand.name,
            "scene": self.plant.scene.name,
            "homed": self.homed,
            "encoder_offset_rad": self.encoder_offset,
        }


def _steps(now_ns: int, due_ns: int, end_ns: int) -> int:
    """Return how many steps, at least one, it takes until something is due, without going beyond the end."""
    return max(1, min(-((now_ns - due_ns) // STEP_NS), (end_ns - now_ns) // STEP_NS))


def make_world(
    hand: Hand,
    scene: Scene,
    seed: int = 0,
    homed: bool = False,
    origin_ns: int = 0,
    compiled: bool = True,
) -> World:
    """Build the world of a hand from a file; arguments as those of ``World``.

    Raises:
        SimulatorError: the numbers or names of the hand are not those of a plant.
    """
    try:
        return World(hand, scene, seed, homed, origin_ns, compiled)
    except SimulatorError:
        raise
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise SimulatorError(f"hand {hand.name}: cannot be simulated: {error}") from error
