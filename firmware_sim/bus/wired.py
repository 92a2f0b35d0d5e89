"""A port that serves a local bus whose frames take their time: every client and every node has a controller."""

import socket
import struct
from collections import deque
from collections.abc import Callable, Collection, Sequence

from firmware_sim.bus.frame import ERROR, EXTENDED, RECORD_SIZE, REMOTE, Frame, pack_record
from firmware_sim.bus.hub import Hub, Link
from firmware_sim.bus.local import split
from firmware_sim.wire.bits import Rate
from firmware_sim.wire.controller import Controller
from firmware_sim.wire.medium import Options, Wire
from firmware_sim.wire.options import parse

ALONE_BITRATES = (1_000_000, 5_000_000)
"""Of a bus without a hand: nominal and data [bit/s]."""
QUEUE_TOLD = EXTENDED | REMOTE | ERROR
"""Identifier, which no frame can have, of a record that tells a client how far its queue has been emptied."""
_QUEUE = struct.Struct("<II")
"""Frames that have left it, modulo 2**32; frames that it holds."""


class WiredPort:
    """See ``ports.Port``; what happens between two looks at the clock happens in the order of the wire.

    ``receive`` returns the frames of one moment, so that answers to them are on the wire before the next frame is;
    whoever serves the bus calls it until nothing comes. The nodes have a controller for each identifier they send.

    Attributes:
        wire: the wire.
    """

    def __init__(
        self, name: str, bus: int, rate: Rate, options: Options, now_ns: Callable[[], int], nodes: bool = True
    ) -> None:
        """Serve a bus.

        Args:
            name: of the bus. bus: its index in the hand.
            rate, options: of the wire.
            now_ns: the clock of the wire [ns].
            nodes: whether there are nodes here that acknowledge.

        Raises:
            SimulatorError: the bus is served already.
        """
        self._hub, self.wire = Hub(name), Wire(rate, options)
        self._bus, self._now_ns = bus, now_ns
        self._clients: dict[Link, Controller] = {}
        self._queues: dict[Link, tuple[int, int]] = {}
        """Records that came from each client, and how many of them it was told have left its queue; -1: nothing yet."""
        self._nodes: dict[int, Controller] = {}
        self._heard: deque[Frame] = deque()
        self._unreadable = self._refused = 0
        self._at_ns = self._begun_ns = now_ns()
        if nodes:
            self.wire.add(self._hear)

    @property
    def lost(self) -> int:
        """Frames dropped for slow clients, found no room in a node's queue, or were none."""
        return self._hub.dropped + self._unreadable + self._refused

    @property
    def due_ns(self) -> int:
        """See ``ports.Port``."""
        return self.wire.next_ns()

    @property
    def load(self) -> float:
        """Share of the time since the beginning in which the wire was occupied."""
        return self.wire.load(0, max(1, self._now_ns() - self._begun_ns))

    def readers(self) -> list[socket.socket]:
        """See ``ports.Port``."""
        return self._hub.readers()

    def writers(self) -> list[socket.socket]:
        """See ``ports.Port``."""
        return self._hub.writers()

    def receive(self, ready: Collection[socket.socket]) -> list[Frame]:
        """See ``ports.Port``; the frames that ended next on the wire, if they have by now."""
        now_ns = self._now_ns()
        if ready:
            self._take(ready, now_ns)
        while not self._heard and self.wire.next_ns() <= now_ns:
            self._at_ns = self.wire.next_ns()
            self.wire.step(now_ns)
        frames = list(self._heard)
        self._heard.clear()
        self._tell_queues()
        return frames

    def _tell_queues(self) -> None:
        """Tell each client how far its queue has been emptied: sending to a full one must fail there, and at once."""
        for link, controller in self._clients.items():
            came, told = self._queues[link]
            left = came - len(controller.queue)
            if left != told:
                dropped = link.dropped
                link.deliver(pack_record(Frame(QUEUE_TOLD, _QUEUE.pack(left & 0xFFFFFFFF, self.wire.options.queue))))
                self._queues[link] = came, left if link.dropped == dropped else -1

    def _take(self, ready: Collection[socket.socket], now_ns: int) -> None:
        """Clients' frames into their queues; what happened before they came happens first."""
        heard = self._hub.hear(ready)
        for link in self._hub.links:
            if link not in self._clients:
                self._clients[link] = self.wire.add(self._deliver(link))
                self._queues[link] = 0, -1
        for link, records in heard:
            came, told = self._queues[link]
            self._queues[link] = came + len(records) // RECORD_SIZE, told
            frames, unreadable = split(records, self._bus)
            self._unreadable += unreadable
            for frame in frames:
                if not frame.can_id & ERROR:
                    self._clients[link].offer(frame, now_ns)
        self._part()

    def _part(self) -> None:
        for link in [link for link in self._clients if link.gone]:
            self.wire.remove(self._clients.pop(link))
            del self._queues[link]
        self._hub.part()

    def _deliver(self, link: Link) -> Callable[[Frame, int], None]:
        return lambda frame, t_ns: link.deliver(pack_record(frame))

    def _hear(self, frame: Frame, t_ns: int) -> None:
        """What the nodes hear: everything but themselves."""
        if not frame.can_id & ERROR:
            self._heard.append(frame)

    def send(self, frames: list[Frame]) -> None:
        """See ``ports.Port``; answers to what was received last, from that moment on."""
        for frame in frames:
            controller = self._nodes.get(frame.can_id)
            if controller is None:
                controller = self._nodes[frame.can_id] = self.wire.add()
            self._refused += not controller.offer(frame, self._at_ns)

    def close(self) -> None:
        """See ``ports.Port``."""
        self._hub.close()


def maker(
    words: Sequence[str] | None, bitrates: Sequence[tuple[int, int]], now_ns: Callable[[], int], nodes: bool = True
) -> Callable[[str, int], WiredPort] | None:
    """Return what makes the ports of a hand's buses with a wire; None if none was asked for.

    Args:
        words: of ``--wire``; None if it was not given.
        bitrates: nominal and data of each bus [bit/s].
        now_ns: the clock of the wires [ns].
        nodes: whether there are nodes that acknowledge.

    Raises:
        SimulatorError: a word that means nothing.
    """
    if words is None:
        return None
    spec = parse(words)
    return lambda name, bus: WiredPort(name, bus, spec.rate(*bitrates[bus]), spec.options, now_ns, nodes)
