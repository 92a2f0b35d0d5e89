"""The faults of one simulated hand: what waits, what acts, and what was felt of it."""

import random
from typing import Any

from firmware_sim.bus.frame import Frame
from firmware_sim.faults import of_plant as fault_plant
from firmware_sim.faults import of_wire as fault_wire
from firmware_sim.faults.of_wire import Active
from firmware_sim.faults.text import BUS, DIGIT, FOREVER_NS, KINDS, NODE, SENSORS, TENDON, Fault, instances, parse_fault

TURN_NS = 1_000_000
FOREIGN_NS = 10_000_000
FLOOD_ID, UNKNOWN_ID = 0x000, 0x7E5
INVENTED = ("flood", "unknown", "foreign")
"""Kinds of fault in which nobody speaks, every so often."""


class Faults:
    """Faults of a world, by its clock: deterministic, in lockstep and in real time.

    Attributes:
        on: whether any fault waits or acts.
        struck: what acts on the wire of a node, by its identity.
        everything: every fault so far, in the order of injection.
        in_frames: whether a fault acts on the wire, in a node or in a sensor, so that frames may differ by it.
    """

    def __init__(self, world: Any) -> None:
        """Args: the world that they strike."""
        self._world = world
        self.on = self.in_frames = False
        self._waiting: list[Active] = []
        self._acting: list[tuple[Active, fault_plant.Undo]] = []
        self.struck: dict[int, list[Active]] = {}
        self._all_wire: list[tuple[int, Active]] = []
        self._turn_ns = self._foreign_ns = 0
        self.everything: list[Active] = []

    @property
    def t_ns(self) -> int:
        """The time that the truth file is in [ns]: the world's, and what it has given up."""
        return int(self._world.t_ns + self._world.slip_ns)

    @property
    def slip_ns(self) -> int:
        """Time in which nothing happened here, since this process did not run [ns]."""
        return int(self._world.slip_ns)

    def inject(self, text: str) -> Fault:
        """Let a fault begin, at once or later.

        Raises:
            SimulatorError: there is no such fault in this hand.
        """
        fault = parse_fault(text, self._world.hand, self._world.t_ns)
        one = Active(fault, random.Random(f"fault {fault.seed} {fault.text}"))
        self.everything.append(one)
        self._waiting.append(one)
        self.on = True
        self._world.hear(self.advance(self._world.t_ns))
        return fault

    def kinds(self) -> list[dict[str, object]]:
        """Every kind of fault, what this hand has to put it on, and what it does."""
        hand = self._world.hand
        return [
            {
                "kind": name,
                "on": {component: instances(component, hand, name) for component in kind.components},
                "size": kind.size,
                "text": kind.text,
            }
            for name, kind in KINDS.items()
        ]

    def told(self) -> list[dict[str, object]]:
        """Every fault so far, and what was felt of it."""
        acting = [one for one, _ in self._acting]
        return [
            {
                "fault": one.fault.text,
                "state": "waiting" if one in self._waiting else "acting" if one in acting else "over",
                "start_ns": one.fault.start_ns,
                "felt": one.felt,
                "first_ns": one.first_ns,
            }
            for one in self.everything
        ]

    def advance(self, t_ns: int) -> list[Frame]:
        """Begin and end what is due; frames that come of it."""
        for one in [one for one in self._waiting if one.fault.start_ns <= t_ns]:
            self._waiting.remove(one)
            self._acting.append((one, fault_plant.begin(self._world, one)))
            self._index()
        for one, undo in [(a, u) for a, u in self._acting if a.fault.start_ns + a.fault.duration_ns <= t_ns]:
            undo()
            self._acting.remove((one, undo))
            self._index()
        frames = [frame for bus, one in self._all_wire for frame in fault_wire.due([one], t_ns)]
        if not self._turn_ns or (t_ns >= self._turn_ns and (t_ns - self._turn_ns) % TURN_NS == 0):
            # turns are at ends of whole steps, also if the first fault comes within one
            self._turn_ns = t_ns - self._world.plant.part_ns + TURN_NS
            frames += self._invented(t_ns)
        return frames

    def due_ns(self) -> int:
        """Return when something begins, ends, is let go or is said by nobody next [ns]."""
        due = [one.fault.start_ns for one in self._waiting]
        for one, _ in self._acting:
            due += [one.fault.start_ns + one.fault.duration_ns, *(at_ns for at_ns, _ in one.held)]
            if one.fault.kind in INVENTED:
                due.append(self._turn_ns)
        return min(due, default=FOREVER_NS)

    def _index(self) -> None:
        """Who is struck on the wire; a node that was reset may have another number."""
        self._world.look_again()
        self.struck, self._all_wire = {}, []
        self.in_frames = any(one.fault.component not in (TENDON, DIGIT) for one, _ in self._acting)
        for one, _ in self._acting:
            if one.fault.component not in (NODE, BUS):
                continue
            for node, bus in self._struck(one.fault):
                self.struck.setdefault(id(node), []).append(one)
                self._all_wire.append((bus, one))

    def _struck(self, fault: Fault) -> list[tuple[Any, int]]:
        world = self._world
        if fault.component == BUS:
            bus = world.hand.buses.index(fault.instance)
            return [(node, bus) for node in world.nodes[bus]]
        node = world.sensor_node if fault.instance == SENSORS else world.node_of(fault.instance)
        return [(node, next(bus for bus, nodes in enumerate(world.nodes) if node in nodes))]

    def exchange(self, node: Any, frame: Frame, t_ns: int) -> list[Frame] | None:
        """What a node answers to a frame, if it gets it and the answer arrives."""
        active = self.struck.get(id(node))
        if not active:
            answers: list[Frame] | None = node.receive(frame, t_ns)
            return answers
        if fault_wire.deaf(active, t_ns):
            return None
        answers = node.receive(frame, t_ns)
        if not answers:
            return answers
        stamped = [answer._replace(bus=frame.bus, t_ns=t_ns) for answer in answers]
        return fault_wire.transmit(active, stamped, t_ns)

    def spoken(self, node: Any, frames: list[Frame], t_ns: int) -> list[Frame]:
        """What becomes of frames that a node sends of its own accord."""
        active = self.struck.get(id(node))
        return fault_wire.transmit(active, frames, t_ns) if active else frames

    def _invented(self, t_ns: int) -> list[Frame]:
        """Frames of nobody."""
        frames = []
        for one, _ in self._acting:
            fault = one.fault
            if fault.kind in ("flood", "unknown"):
                bus = self._world.hand.buses.index(fault.instance)
                can_id = FLOOD_ID if fault.kind == "flood" else UNKNOWN_ID
                frames += [Frame(can_id, bytes(8), 0, bus, t_ns)] * int(fault.size)
                one.feel(t_ns)
            elif fault.kind == "foreign" and t_ns >= self._foreign_ns:
                self._foreign_ns = t_ns + FOREIGN_NS
                frames.append(self._world.host_frame(fault.instance)._replace(t_ns=t_ns))
                one.feel(t_ns)
        return frames
