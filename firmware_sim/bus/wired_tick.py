"""A tick in lockstep on wires: frames of the host, answers, and what nodes say by themselves take their time."""

from collections.abc import Callable, Iterable, Sequence

from firmware_sim.bus.frame import ERROR, Frame
from firmware_sim.wire.controller import Controller
from firmware_sim.wire.medium import Wire
from firmware_sim.wire.options import WireSpec
from firmware_sim.world import World


class WiredTick:
    """Each bus of a hand as a wire between the host and the nodes, in virtual time.

    Attributes:
        wires: of each bus. refused: frames that found no room in a node's queue.
    """

    def __init__(self, world: World, spec: WireSpec) -> None:
        """Args: the hand; what its wires are like."""
        self._world = world
        self.wires = [Wire(spec.rate(*bitrates), spec.options) for bitrates in world.hand.bitrates]
        self.refused = 0
        self._arrived: list[Frame] = []
        self._heard: list[Frame] = []
        self._hosts = [wire.add(self._to_host(bus)) for bus, wire in enumerate(self.wires)]
        for bus, wire in enumerate(self.wires):
            wire.add(self._to_nodes(bus))
        self._nodes: dict[tuple[int, int], Controller] = {}

    def _to_host(self, bus: int) -> Callable[[Frame, int], None]:
        return lambda frame, t_ns: self._arrived.append(Frame(frame[0], frame[1], frame[2], bus, t_ns))

    def _to_nodes(self, bus: int) -> Callable[[Frame, int], None]:
        def hear(frame: Frame, t_ns: int) -> None:
            can_id, data, flags, _, _ = frame
            if not can_id & ERROR:
                self._heard.append(Frame(can_id, data, flags, bus, t_ns))

        return hear

    def step(self, t_ns: int, frames: Iterable[Frame], end_ns: int) -> list[Frame]:
        """Queue the host's frames and let everything happen before the end; what has reached the host by then.

        Args:
            t_ns: beginning of the tick [ns]. frames: of the host. end_ns: beginning of the next tick [ns].
        """
        for frame in frames:
            self._hosts[frame.bus].offer(frame, t_ns)
        while True:
            at_ns = min([wire.next_ns() for wire in self.wires])
            self._world.advance(min(at_ns, end_ns))
            if self._say(self._world.take_spoken()):
                continue
            if at_ns >= end_ns:
                break
            for wire in self.wires:
                wire.advance(at_ns)
            if any(map(self._world.heeds, self._heard)):
                self._world.reach(at_ns)
            self._answer()
        arrived, self._arrived = self._arrived, []
        return sorted(arrived, key=_arrival_ns)

    def _answer(self) -> None:
        heard, self._heard = self._heard, []
        for frame in heard:
            for can_id, data, flags, bus, _ in self._world.receive(frame):
                self._queue(Frame(can_id, data, flags, bus, frame.t_ns))

    def _say(self, frames: Sequence[Frame]) -> bool:
        """Queue frames of nodes; whether there were any."""
        for frame in frames:
            self._queue(frame)
        return bool(frames)

    def _queue(self, frame: Frame) -> None:
        """Queue a frame of a node, each identifier in a controller of its own."""
        key = frame.bus, frame.can_id
        if key not in self._nodes:
            self._nodes[key] = self.wires[frame.bus].add()
        self.refused += not self._nodes[key].offer(frame, frame.t_ns)


def _arrival_ns(frame: Frame) -> int:
    return frame.t_ns
