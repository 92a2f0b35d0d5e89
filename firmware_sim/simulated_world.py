"""The simulated world of a hand: the plant and the nodes.

The caller passes times and frames to the world. The world itself uses no sockets and no clocks.

Injected faults act on frames of nodes, on a node, on a sensor or on the plant. See the package
``faults``.
"""

import random
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from firmware_sim.bus.frame import Frame
from firmware_sim.bus.frame_records import frames_to_records, records_to_frames
from firmware_sim.compiled import structure_array, use_compiled_kernels
from firmware_sim.compiled_nodes import CompiledNodes
from firmware_sim.description.hand_description import Hand, MotorSpec, SensorSpec, SimulatorError
from firmware_sim.faults.active_faults import ActiveFaults
from firmware_sim.nodes import PROTOCOL_SPECS, noise, sensor_node
from firmware_sim.nodes.cia404.node import LoadCellAmplifiers
from firmware_sim.nodes.cyclic_kernels import NEVER_NS
from firmware_sim.nodes.mit import codec as mit_codec
from firmware_sim.nodes.protocol_spec import SENSOR_NODE_KIND, DriveNode, SimulatedNode
from firmware_sim.nodes.sensor_node import SensorNode, SensorNodeRow, SensorStruct
from firmware_sim.plant.mjcf import scene_shapes
from firmware_sim.plant.plant import STEP_NS, Plant
from firmware_sim.scene.scene import Scene
from firmware_sim.truth_file import TruthWriter

if TYPE_CHECKING:
    from firmware_sim.plant.camera import Camera

_ARRIVAL_NS = itemgetter(4)
MAX_ENCODER_OFFSET_RAD = 0.5
"""Maximum encoder angle at theta = 0 in a hand that is not homed [rad].

The angle is small compared with the position range of the drives, and with the 3 rad that a grasp
needs.
"""


class SimulatedWorld:
    """The plant and the simulated nodes of one hand.

    A world that is not homed starts like a hand at power-up. At the start, each tendon is slack by
    1 to 3 mm, because the motors were off. At the spool angle theta = 0 and the joint angles q = 0,
    a tendon is just taut.

    At theta = 0, the encoder of a motor reads ``zero_rad`` with an error of at most 0.5 rad. A
    spool that a person has clamped by hand can have an error of up to 0.5 rad. The slack and the
    encoder error are random numbers that depend on a seed. A homed world starts with taut tendons
    and without encoder errors.

    Attributes:
        hand: description of the hand.
        plant: mechanics of the hand.
        nodes: list of the nodes on each bus of the hand.
        t_ns: present time of plant and nodes [ns].
        slip_ns: total time that the slips of the clock have skipped [ns].
        foreign_frame_count: number of received frames that no simulated node has handled.
        sensor_node: node with load cells and joint encoders, or an object for all load-cell
            amplifiers.
        sensor_nodes: all nodes that read load cells, on the bus of these nodes.
        faults: faults that have been injected.
        encoder_offset: encoder angle at the spool angle theta = 0 [rad], by the name of the motor.
        row_of: kind and array row of each node that compiled kernels handle, by the ``id()`` of the
            node.
        exchange: exchange of frames by a compiled kernel, or None without compiled kernels.
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
        """Build the plant and the simulated nodes of a hand.

        Args:
            hand: description of the hand.
            scene: description of object, support and later events.
            seed: seed of all random numbers.
            homed: True to start as a homed hand.
            origin_ns: time of the world at the start [ns].
            compiled: True to use compiled kernels, see ``Plant``.
        """
        self.hand = hand
        self.seed = seed
        self.homed = homed
        self.plant = Plant(hand, scene, seed, homed, compiled)
        if compiled:
            for module in (mit_codec, sensor_node, noise):
                use_compiled_kernels(module)
        self.t_ns = self._origin_ns = origin_ns
        self.foreign_frame_count = 0
        rng = random.Random(f"encoders {seed}")
        max_offset_rad = 0.0 if homed else MAX_ENCODER_OFFSET_RAD
        self.encoder_offset = {
            motor.name: motor.zero_angle + rng.uniform(-max_offset_rad, max_offset_rad)
            for motor in hand.motors
        }
        self.nodes: list[list[SimulatedNode]] = [[] for _ in hand.buses]
        self.row_of: dict[int, tuple[int, int]] = {}
        rows: dict[type, Any] = {}
        self._motor_nodes = self._build_drives(compiled, rows)
        for motor in hand.motors:
            self.nodes[self._bus_index(motor.bus)].append(self._motor_nodes[motor.name])
        if hand.sensors:
            self.sensor_node = self._build_sensor_node(hand.sensors, compiled, rows)
            self.sensor_nodes = self.sensor_node.nodes
            self.nodes[self._bus_index(hand.sensors.bus)] += self.sensor_nodes
        self._nodes_by_bus = [(index, node) for index, bus in enumerate(self.nodes) for node in bus]
        self._without_row = [node for _, node in self._nodes_by_bus if id(node) not in self.row_of]
        self._receivers_by_id: list[dict[int, list[tuple[SimulatedNode, frozenset[int] | None]]]]
        self.compiled_nodes = CompiledNodes(self, rows) if compiled else None
        self.refresh_identifiers()
        self._unsolicited: list[Frame] = []
        self.faults = ActiveFaults(self)
        self._truth: TruthWriter | None = None
        self.slip_ns = 0

    def open_camera(self, width_px: int, height_px: int) -> "Camera":
        """Return a camera that draws the hand and the object. The caller must close the camera.

        Args:
            width_px: width of the pictures [pixels].
            height_px: height of the pictures [pixels].

        Raises:
            SimulatorError: the machine has no graphics library.
        """
        # The import is inside the method, because most runs draw no pictures and need no graphics
        # library.
        from firmware_sim.plant.camera import Camera

        return Camera(self.hand, self.plant.scene, width_px, height_px)

    def _bus_index(self, name: str) -> int:
        """Return the index of the bus with the given name."""
        if name not in self.hand.buses:
            raise SimulatorError(
                f"{self.hand.name}: no bus {name}; expected one of {', '.join(self.hand.buses)}"
            )
        return self.hand.buses.index(name)

    def _build_drives(self, compiled: bool, rows: dict[type, Any]) -> dict[str, DriveNode]:
        """Build the simulated drive of each motor.

        Args:
            compiled: True to store the state of each drive in an array row, for compiled kernels.
            rows: rows with the states of nodes, by the type of the row. The method adds the rows of
                the drives.

        Returns:
            The drive node of each motor, by the name of the motor.
        """
        nodes: dict[str, DriveNode] = {}
        for motor in self.hand.motors:
            if motor.protocol not in PROTOCOL_SPECS:
                names = ", ".join(PROTOCOL_SPECS)
                raise SimulatorError(
                    f"{motor.name}: protocol {motor.protocol} is not simulated; expected one of {names}"
                )
        for protocol, kind in PROTOCOL_SPECS.items():
            motors = [motor for motor in self.hand.motors if motor.protocol == protocol]
            memory: Any = (
                (kind.row * len(motors))() if compiled and kind.row else [None] * len(motors)
            )
            for number, (motor, row) in enumerate(zip(motors, memory, strict=True)):
                arguments = motor, self.plant.motors[motor.name], self.encoder_offset[motor.name]
                if row is None:
                    nodes[motor.name] = kind.node(*arguments)
                    continue
                row.initialise(*arguments)
                row.bus = self._bus_index(motor.bus)
                nodes[motor.name] = row
                self.row_of[id(row)] = (kind.node_kind, number)
            if compiled and kind.row:
                rows[kind.row.layout] = structure_array(memory, kind.row.layout)
        return nodes

    def _build_sensor_node(
        self, spec: SensorSpec, compiled: bool, rows: dict[type, Any]
    ) -> SensorNode | LoadCellAmplifiers:
        """Build the sensor node, or the load-cell amplifiers.

        If compiled kernels are used, the state of the sensor node is stored in a row of an array.
        """
        plant = self.plant
        joints = self.hand.joints
        names = [tendon.name for tendon in self.hand.tendons]
        tendon_order = np.array([names.index(name) for name in spec.tendons], np.int64)
        joint_order = np.array([joints.index(name) for name in spec.joints], np.int64)
        self.sensor_orders = tendon_order, joint_order
        if spec.node_ids:
            return LoadCellAmplifiers(spec, lambda: plant.cells()[tendon_order], self.seed)
        arguments = (
            spec,
            lambda: plant.cells()[tendon_order],
            lambda: plant.engine.q[joint_order],
            self.seed,
        )
        if not compiled:
            return SensorNode(*arguments)
        memory = (SensorNodeRow * 1)()
        node: SensorNodeRow = memory[0]
        node.initialise(*arguments)
        rows[SensorStruct] = structure_array(memory, SensorStruct)
        self.row_of[id(node)] = SENSOR_NODE_KIND, 0
        return node

    def motor_spec(self, name: str) -> MotorSpec:
        """Return the description of the motor with the given name."""
        return next(motor for motor in self.hand.motors if motor.name == name)

    def node_of(self, name: str) -> SimulatedNode:
        """Return the simulated drive of the motor with the given name."""
        return self._motor_nodes[name]

    def host_frame(self, name: str) -> Frame:
        """Build a frame that has no effect on a motor, and that only the host of the motor would send."""
        spec = self.motor_spec(name)
        can_id, data = PROTOCOL_SPECS[spec.protocol].host_frame(spec.node_id)
        return Frame(can_id, data, 0, self._bus_index(spec.bus), self.t_ns)

    def record(self, truth: TruthWriter) -> None:
        """Record the true state of the plant in a truth file, once per ``TruthWriter.period_ns`` of plant time."""
        self._truth = truth

    def receive(self, frame: Frame) -> list[Frame]:
        """Pass a frame to the nodes of the frame's bus, and return the answers.

        Args:
            frame: frame of the host.

        Returns:
            The answers of the nodes. The time of each answer is the present time.
        """
        answer_frames: list[Frame] = []
        is_handled = False
        t_ns = self.t_ns
        bus = frame[3]
        faults = self.faults
        # a fault can act on frames that are meant for other nodes
        has_wire_fault = faults.wire_faults_of
        receivers = (
            self._nodes_of_bus[bus]
            if has_wire_fault
            else self._receivers_by_id[bus].get(frame[0]) or self._receivers(bus, frame[0])
        )
        for node, ids in receivers:
            replies = (
                faults.exchange(node, frame, t_ns) if has_wire_fault else node.receive(frame, t_ns)
            )
            if node.ids is not ids:
                self.refresh_identifiers()
            if replies is not None:
                is_handled = True
                answer_frames += replies
        if not is_handled:
            self.foreign_frame_count += 1
        for i, (can_id, data, flags, bus_number, send_time_ns) in enumerate(answer_frames):
            if bus_number != bus or send_time_ns != t_ns:
                answer_frames[i] = Frame(can_id, data, flags, bus, t_ns)
        return answer_frames

    def has_receiver(self, frame: Frame) -> bool:
        """Return True if a node accepts the frame. The node can then sample the plant for its answer."""
        return bool(
            self._receivers_by_id[frame[3]].get(frame[0]) or self._receivers(frame[3], frame[0])
        )

    def _receivers(
        self, bus: int, can_id: int
    ) -> list[tuple[SimulatedNode, frozenset[int] | None]]:
        """Return the nodes that accept frames with the given identifier.

        The function returns each node together with all present identifiers of the node.
        """
        receivers = [
            (node, ids) for node, ids in self._nodes_of_bus[bus] if ids is None or can_id in ids
        ]
        self._receivers_by_id[bus][can_id] = receivers
        return receivers

    def refresh_identifiers(self) -> None:
        """Read the identifiers of all nodes again, because a node can have new identifiers."""
        self._nodes_of_bus = [[(node, node.ids) for node in bus] for bus in self.nodes]
        self._receivers_by_id = [{} for _ in self.nodes]
        if self.compiled_nodes:
            self.compiled_nodes.refresh_identifiers()

    def advance(self, t_ns: int, row_wake_ns: int | None = None) -> None:
        """Advance the plant and the nodes by whole time steps, but not beyond the time ``t_ns``.

        The next call simulates the remaining time, which is less than a time step.

        Args:
            t_ns: time to which the world advances [ns].
            row_wake_ns: earliest wake time of the drives whose state is in array rows [ns], or None
                if the wake time is not known.
        """
        plant = self.plant
        truth = self._truth
        faults = self.faults
        now_ns = self.t_ns - plant.step_progress_ns
        if now_ns + STEP_NS > t_ns:
            return
        wake_ns = self._next_wake(row_wake_ns)
        while now_ns + STEP_NS <= t_ns:
            until_ns = t_ns
            if truth is not None:
                self._write_truth_row(now_ns)
                until_ns = min(until_ns, now_ns + truth.due_ns - plant.t_ns)
            if faults.on:
                until_ns = min(until_ns, now_ns if plant.faulty_motors else faults.due_ns())
            count = _count_steps_until(now_ns, min(until_ns, wake_ns), t_ns)
            plant.advance(count)
            now_ns += count * STEP_NS
            if now_ns >= wake_ns:
                wake_ns = self._next_wake(self._wake(now_ns))
            if faults.on:
                self.t_ns = now_ns
                self._unsolicited += faults.advance(now_ns)
                wake_ns = self._next_wake()
        self.t_ns = now_ns

    def advance_exactly(self, t_ns: int) -> None:
        """Advance plant and nodes to exactly ``t_ns``.

        A node that answers a frame then samples the plant at exactly ``t_ns``. The method divides
        the time step that contains ``t_ns``, and the next call completes this step. Every step that
        the method does not divide begins and ends at multiples of ``STEP_NS``.
        """
        self.advance(t_ns)
        remaining_ns = t_ns - self.t_ns
        if remaining_ns > 0:
            if not self.plant.step_progress_ns:
                self._write_truth_row(self.t_ns)
            self.plant.advance_within_step(remaining_ns)
            self.t_ns = t_ns

    def _write_truth_row(self, now_ns: int) -> None:
        """Write a row of the truth file if a row is due."""
        truth = self._truth
        plant = self.plant
        if truth is not None and plant.t_ns >= truth.due_ns:
            truth.write(now_ns + self.slip_ns, plant)

    def _next_wake(self, row_wake_ns: int | None = None) -> int:
        """Return the earliest wake time of all nodes [ns].

        Args:
            row_wake_ns: earliest wake time of the drives whose state is in array rows [ns], None if
                not known.
        """
        if not self.compiled_nodes:
            return min([node.wake_ns for _, node in self._nodes_by_bus], default=NEVER_NS)
        wake_ns = self.compiled_nodes.next_wake() if row_wake_ns is None else row_wake_ns
        return (
            min(wake_ns, *[node.wake_ns for node in self._without_row])
            if self._without_row
            else wake_ns
        )

    def _wake(self, now_ns: int) -> int | None:
        """Wake the nodes whose wake time has come, and store the frames that they send.

        Returns:
            The earliest wake time of the drives whose state is in array rows [ns], or None if the
            wake time is not known.
        """
        if (
            self.compiled_nodes
            and not self._without_row
            and self.compiled_nodes.send_due_frames(now_ns)
        ):
            return self.compiled_nodes.wake_ns
        for bus, node in self._nodes_by_bus:
            if now_ns >= node.wake_ns:
                unsolicited_frames = node.wake(now_ns)
                if unsolicited_frames:
                    stamped_frames = [
                        frame._replace(bus=bus, t_ns=now_ns) for frame in unsolicited_frames
                    ]
                    self._unsolicited += (
                        self.faults.frames_after_node_faults(node, stamped_frames, now_ns)
                        if self.faults.on
                        else stamped_frames
                    )
        return None

    def queue_frames(self, frames: list[Frame]) -> None:
        """Store frames from senders outside of the hand. The frames will be sent on the bus."""
        self._unsolicited += frames

    def take_unsolicited_frames(self) -> list[Frame]:
        """Return the unsolicited frames of the nodes since the last call, sorted by time."""
        unsolicited_frames = self._unsolicited
        self._unsolicited = []
        if self.compiled_nodes and len(from_drives := self.compiled_nodes.take_sent_frames()):
            return sorted(records_to_frames(from_drives) + unsolicited_frames, key=_ARRIVAL_NS)
        return unsolicited_frames

    def take_unsolicited_records(self) -> Any:
        """Return the unsolicited frames of the nodes as an array of ``frame_records.FRAME_DTYPE``.

        The array stays valid until a node sends the next frame.
        """
        assert self.compiled_nodes
        return (
            frames_to_records(self.take_unsolicited_frames())
            if self._unsolicited
            else self.compiled_nodes.take_sent_frames()
        )

    @property
    def malformed_frame_count(self) -> int:
        """Return the number of frames that the nodes could not decode."""
        return sum(node.malformed_frame_count for _, node in self._nodes_by_bus)

    def header(self, clock: str) -> dict[str, object]:
        """Return the header for a truth file of this world.

        Args:
            clock: name of the clock to which the times in the file belong.
        """
        return {
            "clock": clock,
            "seed": self.seed,
            "hand": self.hand.name,
            "scene": self.plant.scene.name,
            "homed": self.homed,
            "encoder_offset_rad": self.encoder_offset,
            "shapes": scene_shapes(self.plant.scene, self.plant.hand.gravity),
        }


def _count_steps_until(now_ns: int, due_ns: int, end_ns: int) -> int:
    """Count the time steps until an event is due or the time ``end_ns`` is reached.

    The returned number of steps is at least 1.

    Args:
        now_ns: present time [ns].
        due_ns: time of the event [ns].
        end_ns: time that the steps must not pass [ns].
    """
    return max(1, min(-((now_ns - due_ns) // STEP_NS), (end_ns - now_ns) // STEP_NS))


def make_world(
    hand: Hand,
    scene: Scene,
    seed: int = 0,
    homed: bool = False,
    origin_ns: int = 0,
    compiled: bool = True,
) -> SimulatedWorld:
    """Build the world of a hand that was read from a file, and raise SimulatorError if the file contains wrong values.

    Args:
        hand: description of the hand.
        scene: description of object, support and later events.
        seed: seed of all random numbers.
        homed: True to start as a homed hand.
        origin_ns: time of the world at its start [ns].
        compiled: True to use compiled kernels, see ``Plant``.

    Raises:
        SimulatorError: a plant cannot be built from the numbers or names in the description of the
            hand.
    """
    try:
        return SimulatedWorld(hand, scene, seed, homed, origin_ns, compiled)
    except SimulatorError:
        raise
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise SimulatorError(f"hand {hand.name}: cannot be simulated: {error}") from error
