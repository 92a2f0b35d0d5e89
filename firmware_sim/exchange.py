"""A tick's frames as records: the cyclic ones are answered by a compiled law, the others by the nodes one by one."""

from operator import is_not
from typing import Any

import numpy as np

from firmware_sim.bus.frame import Frame
from firmware_sim.bus.records import RECORD, to_frames, to_records
from firmware_sim.compiled import addresses, machine_code
from firmware_sim.nodes import cyclic
from firmware_sim.nodes.cia402.laws import Cia402Row
from firmware_sim.nodes.cyclic import ANSWERS, IN_ORDER, NEXT_FRAME, SAID, WAKE_NS, Taker
from firmware_sim.nodes.kind import SENSORS
from firmware_sim.nodes.mit.codec import MitRow
from firmware_sim.nodes.odrive.laws import OdriveRow
from firmware_sim.nodes.sensors import CHANNELS, SensorRow

ROOM = 64
"""Answers that there is room for in a tick at first."""


class Exchange:
    """What answers the frames of a tick; the nodes of its world have rows.

    Attributes:
        speaks: whether it sends what drives send of their own accord; otherwise the world does.
    """

    def __init__(self, world: Any, rows: dict[type, Any]) -> None:
        """Args: the world; the rows of its nodes by their type, an array for each."""
        self._world, self._laws = world, machine_code(cyclic)
        self._room = ROOM
        self._progress = np.zeros(5, np.int64)
        sensor = world.sensor_node if SensorRow in rows else None
        self._noise, self._most = sensor.noise if sensor else None, 1
        orders, bias = (np.empty(0, np.int64),) * 2, np.empty(0)
        if sensor:
            orders, bias = world.sensor_orders, sensor.bias
            self._most += sum(-(-len(order) // CHANNELS) for order in orders)
        self._most += len(world.row_of)
        self._draws = 2 * len(orders[0]) + len(orders[1])
        self._drives = tuple(rows.get(layout, np.empty(0, layout)) for layout in (MitRow, OdriveRow, Cia402Row))
        self._sensing = rows.get(SensorRow, np.empty(0, SensorRow)), *orders, bias
        self.speaks = True
        self._said = np.empty(ROOM, RECORD)
        noise = (sensor.noise.left, sensor.noise.places) if sensor else (np.empty(0), np.zeros(2, np.int64))
        self._sampling = *noise, *world.plant.sampled
        self._table: Any = None
        self._takers: Any = None

    def look_again(self) -> None:
        """Ask the nodes again who they are before the next frame."""
        self._table = None

    def answer(self, frames: Any, t_ns: int, last_ns: int) -> tuple[Any, bool]:
        """Return the answers to frames, stamped as if they followed one another, and whether their times rise.

        Args:
            frames: array of ``RECORD``.
            t_ns: beginning of the tick [ns].
            last_ns: the latest that an answer comes after it [ns].
        """
        world, progress, answers = self._world, self._progress, np.empty(self._room, RECORD)
        if not frames.flags.writeable:
            frames = frames.copy()
        progress[:SAID] = 0
        one_by_one = world.faults.in_frames
        while True:
            if one_by_one:
                for frame in to_frames(frames):
                    answers = self._add(answers, world.receive(frame))
                progress[NEXT_FRAME] = len(frames)
                self._check()
            self._run(frames, answers, t_ns, last_ns)
            at = int(progress[NEXT_FRAME])
            if at == len(frames):
                return answers[: progress[ANSWERS]], bool(progress[IN_ORDER])
            if progress[ANSWERS] + self._most > len(answers):
                answers = self._more(answers)
                continue
            (frame,) = to_frames(frames[at : at + 1])
            answers = self._add(answers, world.receive(frame))
            progress[NEXT_FRAME] = at + 1
            self._check()

    def _run(self, frames: Any, answers: Any, t_ns: int, last_ns: int) -> None:
        if self._table is None:
            self._look()
        if self._noise:
            self._noise.draw(self._draws)
        self._laws.answer(frames, answers, self._addresses, t_ns, last_ns, self._most)

    def _more(self, answers: Any) -> Any:
        """Return the answers in twice as much room."""
        self._room = 2 * len(answers)
        return np.concatenate((answers, np.empty(len(answers), RECORD)))

    def _add(self, answers: Any, frames: list[Frame]) -> Any:
        """Return the answers with more of them."""
        count, new = int(self._progress[ANSWERS]), len(frames)
        while count + new > len(answers):
            answers = self._more(answers)
        answers[count : count + new] = to_records(frames)
        self._progress[ANSWERS] = count + new
        return answers

    def _look(self) -> None:
        """Note who takes which identifier; what a node without a row may answer is left to Python."""
        world, takers = self._world, list[tuple[int, int, int]]()
        table = cyclic.empty_table(len(world.nodes))
        for bus, nodes in enumerate(world.nodes):
            # whoever puts another ``receive`` into a node, as tests do, wants to see every frame
            lawful = [id(node) in world.row_of and "receive" not in vars(node) for node in nodes]
            cycles = {id(node): node.cyclic if law else () for node, law in zip(nodes, lawful, strict=True)}
            for can_id in {can_id for ids in cycles.values() for can_id in ids}:
                heard = [node for node in nodes if _takes(node, can_id)]
                if not all(can_id in cycles[id(node)] for node in heard):
                    continue
                following = -1
                for node in reversed(heard):
                    takers.append((*world.row_of[id(node)], following))
                    following = len(takers) - 1
                table[cyclic.place(bus, can_id)] = following
        self._known = self._taken()
        self._table, self._takers = table, np.array(takers, Taker)
        rows = [world.row_of.get(id(node), (SENSORS, 0)) for nodes in world.nodes for node in nodes]
        self._speakers = np.array([(*row, -1) for row in rows if row[0] != SENSORS], Taker)
        every = self._progress, table, self._takers, *self._drives, self._speakers, *self._sensing, *self._sampling
        self._addresses = np.array(addresses(every), np.int64)

    def _taken(self) -> list[Any]:
        """Return the identifiers that each node takes, objects that are others whenever they change."""
        return [getattr(node, "takes", node.ids) for nodes in self._world.nodes for node in nodes]

    def _check(self) -> None:
        """Look again if a node takes other identifiers than before."""
        if self._table is not None and any(map(is_not, self._known, self._taken())):
            self._table = None

    @property
    def wake_ns(self) -> int:
        """When time must pass for a drive with a row next [ns], as of the end of ``answer`` or ``speak``."""
        return int(self._progress[WAKE_NS])

    def next_wake(self) -> int:
        """Return when time must pass for a drive with a row next [ns], now."""
        if self._table is None:
            self._look()
        return int(self._laws.next_wake(self._speakers, *self._drives))

    def speak(self, now_ns: int) -> bool:
        """Let drives send what is due; return False, with nothing done, if a node has to decide something."""
        if not self.speaks or self._world.faults.in_frames:
            return False
        if self._table is None:
            self._look()
        while self._progress[SAID] + 2 * len(self._speakers) > len(self._said):
            self._said = np.concatenate((self._said, np.empty(len(self._said), RECORD)))
        rotors = self._world.plant.sampled[3]
        return bool(self._laws.speak(self._speakers, *self._drives, rotors, now_ns, self._said, self._progress))

    def take_said(self) -> Any:
        """Return what drives have sent of their own accord since the last call; valid until they send more."""
        count, self._progress[SAID] = int(self._progress[SAID]), 0
        return self._said[:count]

    def merged(self, first: Any, second: Any) -> Any:
        """Return frames of two arrays, sorted by their times."""
        out = np.empty(len(first) + len(second), RECORD)
        self._laws.merge(first, second, out)
        return out


def _takes(node: Any, can_id: int) -> bool:
    """Return whether a node may answer an identifier."""
    takes = getattr(node, "takes", node.ids)
    return takes is None or can_id in takes
