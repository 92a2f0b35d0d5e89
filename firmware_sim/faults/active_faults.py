"""Injected faults of a simulated hand: waiting, acting and finished faults.

Each fault counts its effects.
"""

import random
from typing import Any

from firmware_sim.bus.frame import Frame
from firmware_sim.faults import plant_faults, wire_faults
from firmware_sim.faults.fault_text import (
    FAULT_KINDS,
    FAULT_TARGET_BUS,
    FAULT_TARGET_DIGIT,
    FAULT_TARGET_NODE,
    FAULT_TARGET_TENDON,
    FOREVER_NS,
    SENSOR_NODE_NAME,
    Fault,
    instances_of_component,
    parse_fault,
)
from firmware_sim.faults.wire_faults import ActiveFault

FAULT_FRAME_PERIOD_NS = 1_000_000
"""Period of the frames that a fault of kind ``flood`` or ``unknown`` generates [ns]."""
SECOND_HOST_PERIOD_NS = 10_000_000
"""Period with which a simulated second host sends commands [ns]."""
FLOOD_CAN_ID = 0x000
"""Identifier of the frames of a flood: the identifier with the highest priority on the bus."""
UNKNOWN_CAN_ID = 0x7E5
"""Identifier that belongs to no node."""
FRAME_SENDING_FAULTS = ("flood", "unknown", "foreign")
"""Kinds of fault that periodically send additional frames."""


class ActiveFaults:
    """The faults of a simulated world, timed by the clock of this world.

    The effects of faults are deterministic, in lockstep and in real time.

    Attributes:
        on: True after the first fault has been injected.
        wire_faults_of: faults that act on the frames of a node, by the ``id()`` of the node object.
        injected: all faults injected so far, in the order of injection.
        in_frames: True if a fault acts on frames, on a node or on a sensor, so that the fault can
            change frames.
    """

    def __init__(self, simulated_world: Any) -> None:
        """Start without faults.

        Args:
            simulated_world: world in which the faults act.
        """
        self._world = simulated_world
        self.on = self.in_frames = False
        self._waiting: list[ActiveFault] = []
        self._acting: list[tuple[ActiveFault, plant_faults.UndoFunction]] = []
        self.wire_faults_of: dict[int, list[ActiveFault]] = {}
        self._all_wire: list[tuple[int, ActiveFault]] = []
        self._turn_ns = self._foreign_ns = 0
        self.injected: list[ActiveFault] = []

    @property
    def t_ns(self) -> int:
        """Return the present time of the truth file (the record of the true plant state) [ns].

        The time of the truth file is a sum: the time of the simulated world, plus the plant time
        that was skipped to keep up with the clock (``slip_ns``).
        """
        return int(self._world.t_ns + self._world.slip_ns)

    @property
    def slip_ns(self) -> int:
        """Return the total plant time that was skipped to keep up with the clock [ns]."""
        return int(self._world.slip_ns)

    def inject(self, fault_line: str) -> Fault:
        """Start a fault now, or at the later time that the fault text states.

        Args:
            fault_line: fault as text, see ``parse_fault``.

        Returns:
            The fault.

        Raises:
            SimulatorError: the hand of this simulation cannot have the fault.
        """
        fault = parse_fault(fault_line, self._world.hand, self._world.t_ns)
        active_fault = ActiveFault(fault, random.Random(f"fault {fault.seed} {fault.text}"))
        self.injected.append(active_fault)
        self._waiting.append(active_fault)
        self.on = True
        self._world.queue_frames(self.advance(self._world.t_ns))
        return fault

    def describe_kinds(self) -> list[dict[str, object]]:
        """List each kind of fault with the possible targets in this hand, the default size and the effect."""
        hand = self._world.hand
        return [
            {
                "kind": name,
                "on": {
                    component: instances_of_component(component, hand, name)
                    for component in kind.components
                },
                "size": kind.size,
                "text": kind.text,
            }
            for name, kind in FAULT_KINDS.items()
        ]

    def fault_states(self) -> list[dict[str, object]]:
        """List each fault injected so far, with state and number of effects."""
        acting_faults = [active_fault for active_fault, _ in self._acting]
        return [
            {
                "fault": active_fault.fault.text,
                "state": "waiting"
                if active_fault in self._waiting
                else "acting"
                if active_fault in acting_faults
                else "over",
                "start_ns": active_fault.fault.start_ns,
                "felt": active_fault.effect_count,
                "first_ns": active_fault.first_effect_ns,
            }
            for active_fault in self.injected
        ]

    def advance(self, t_ns: int) -> list[Frame]:
        """Start the faults whose start is due, and end the faults whose end is due.

        Args:
            t_ns: present time [ns].

        Returns:
            Frames that the faults send now: new frames, and frames that a fault has delayed.
        """
        for active_fault in [
            active_fault for active_fault in self._waiting if active_fault.fault.start_ns <= t_ns
        ]:
            self._waiting.remove(active_fault)
            self._acting.append(
                (active_fault, plant_faults.start_plant_fault(self._world, active_fault))
            )
            self._index_faults_by_node()
        for active_fault, undo_fault in [
            (a, u) for a, u in self._acting if a.fault.start_ns + a.fault.duration_ns <= t_ns
        ]:
            undo_fault()
            self._acting.remove((active_fault, undo_fault))
            self._index_faults_by_node()
        frames = [
            frame
            for bus, active_fault in self._all_wire
            for frame in wire_faults.released_frames([active_fault], t_ns)
        ]
        if not self._turn_ns or (
            t_ns >= self._turn_ns and (t_ns - self._turn_ns) % FAULT_FRAME_PERIOD_NS == 0
        ):
            # Frames that a fault generates are sent at the ends of whole steps of the plant. A
            # fault can start within a step of the plant. So the already completed part of the
            # present plant step is subtracted.
            self._turn_ns = t_ns - self._world.plant.step_progress_ns + FAULT_FRAME_PERIOD_NS
            frames += self._generated_frames(t_ns)
        return frames

    def due_ns(self) -> int:
        """Return the time of the next event [ns]: a fault starts or ends, or a delayed or generated frame is due."""
        due_times_ns = [active_fault.fault.start_ns for active_fault in self._waiting]
        for active_fault, _ in self._acting:
            due_times_ns += [
                active_fault.fault.start_ns + active_fault.fault.duration_ns,
                *(release_ns for release_ns, _ in active_fault.delayed_frames),
            ]
            if active_fault.fault.kind in FRAME_SENDING_FAULTS:
                due_times_ns.append(self._turn_ns)
        return min(due_times_ns, default=FOREVER_NS)

    def _index_faults_by_node(self) -> None:
        """Update the table that lists the faults of each node, and the identifiers of the nodes.

        After a reset, a node can have another identifier.
        """
        self._world.refresh_identifiers()
        self.wire_faults_of = {}
        self._all_wire = []
        self.in_frames = any(
            active_fault.fault.component not in (FAULT_TARGET_TENDON, FAULT_TARGET_DIGIT)
            for active_fault, _ in self._acting
        )
        for active_fault, _ in self._acting:
            if active_fault.fault.component not in (FAULT_TARGET_NODE, FAULT_TARGET_BUS):
                continue
            for node, bus in self._target_nodes(active_fault.fault):
                self.wire_faults_of.setdefault(id(node), []).append(active_fault)
                self._all_wire.append((bus, active_fault))

    def _target_nodes(self, fault: Fault) -> list[tuple[Any, int]]:
        """List the target nodes of a fault, each with the index of the node's bus."""
        world = self._world
        if fault.component == FAULT_TARGET_BUS:
            bus = world.hand.buses.index(fault.instance)
            return [(node, bus) for node in world.nodes[bus]]
        nodes = (
            world.sensor_nodes
            if fault.instance == SENSOR_NODE_NAME
            else [world.node_of(fault.instance)]
        )
        return [
            (node, next(bus for bus, bus_nodes in enumerate(world.nodes) if node in bus_nodes))
            for node in nodes
        ]

    def exchange(self, node: Any, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Return the answers of a node to a request.

        The faults of the node can suppress the request and the answers, and can change the answers.

        Args:
            node: the node.
            frame: frame with the request to the node.
            t_ns: present time [ns].

        Returns:
            The answers that reach the host, or None if the node does not receive or does not handle
            the request.
        """
        node_faults = self.wire_faults_of.get(id(node))
        if not node_faults:
            answer_frames: list[Frame] | None = node.receive(frame, t_ns)
            return answer_frames
        if wire_faults.is_request_lost(node_faults, t_ns):
            return None
        answer_frames = node.receive(frame, t_ns)
        if not answer_frames:
            return answer_frames
        stamped_answers = [answer._replace(bus=frame.bus, t_ns=t_ns) for answer in answer_frames]
        return wire_faults.frames_after_faults(node_faults, stamped_answers, t_ns)

    def frames_after_node_faults(self, node: Any, frames: list[Frame], t_ns: int) -> list[Frame]:
        """Return the unsolicited frames of a node, as changed or removed by the injected faults."""
        node_faults = self.wire_faults_of.get(id(node))
        return wire_faults.frames_after_faults(node_faults, frames, t_ns) if node_faults else frames

    def _generated_frames(self, t_ns: int) -> list[Frame]:
        """Generate the frames of the acting faults: floods, unknown identifiers and commands of a second host."""
        frames = []
        for active_fault, _ in self._acting:
            fault = active_fault.fault
            if fault.kind in ("flood", "unknown"):
                bus = self._world.hand.buses.index(fault.instance)
                can_id = FLOOD_CAN_ID if fault.kind == "flood" else UNKNOWN_CAN_ID
                frames += [Frame(can_id, bytes(8), 0, bus, t_ns)] * int(fault.size)
                active_fault.count_effect(t_ns)
            elif fault.kind == "foreign" and t_ns >= self._foreign_ns:
                self._foreign_ns = t_ns + SECOND_HOST_PERIOD_NS
                frames.append(self._world.host_frame(fault.instance)._replace(t_ns=t_ns))
                active_fault.count_effect(t_ns)
        return frames
