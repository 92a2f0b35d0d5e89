"""A port that serves a local bus with simulated transmission times.

Each client has its own simulated CAN controller. The nodes have a simulated CAN controller for each
identifier that they send.
"""

import socket
import struct
from collections import deque
from collections.abc import Callable, Collection, Sequence
from heapq import heappop, heappush

from firmware_sim.bus.frame import (
    ERROR_FLAG,
    EXTENDED_FLAG,
    RECORD_SIZE,
    REMOTE_FLAG,
    Frame,
    pack_record,
)
from firmware_sim.bus.hub import BusHub, HubConnection
from firmware_sim.bus.local_ports import split_records
from firmware_sim.wire.can_adapter import NO_LATENCY_CLASS, AdapterLatency
from firmware_sim.wire.can_controller import CanController
from firmware_sim.wire.frame_bits import BitRates
from firmware_sim.wire.simulated_wire import SimulatedWire, WireOptions
from firmware_sim.wire.wire_options import parse_wire_options

DEFAULT_BITRATES = (1_000_000, 5_000_000)
"""Bit rates of a bus that belongs to no hand: nominal bit rate, and bit rate of the data phase [bit/s]."""
QUEUE_REPORT_ID = EXTENDED_FLAG | REMOTE_FLAG | ERROR_FLAG
"""Identifier of a queue report: a record with the number of frames in a client's send queue.

No CAN frame has the flags extended, remote and error at the same time.
"""
_QUEUE_REPORT_STRUCT = struct.Struct("<II")
"""Payload of a queue report: number of frames that have left the queue modulo 2**32, and queue capacity [frames]."""


class TimedPort:
    """Connection of the simulator to a simulated wire.

    The class ``bus_ports.BusPort`` describes the methods.

    Each call of a method processes the events since the last call, in the order in which the events
    occur on the wire. A call of ``receive`` returns only frames that end at the same time on the
    wire. The nodes must answer the frames from ``receive`` before the wire carries the next frame.
    The caller calls ``receive`` until the result is empty. The nodes have one CAN controller for
    each identifier that they send.

    Attributes:
        wire: the simulated wire.
    """

    def __init__(
        self,
        name: str,
        bus: int,
        rate: BitRates,
        options: WireOptions,
        now_ns: Callable[[], int],
        is_node_side: bool = True,
        latency: Callable[[int], AdapterLatency] | None = None,
    ) -> None:
        """Open the hub of the bus, and connect the nodes to the wire.

        Args:
            name: name of the bus.
            bus: index of the bus in the list of the hand's buses.
            rate: nominal bit rate and data bit rate of the wire.
            options: options that describe the behaviour of the wire.
            now_ns: function that returns the present time of the wire [ns].
            is_node_side: True if simulated nodes in this process acknowledge frames.
            latency: function that takes the number of a client, and returns the latency of this
                client's CAN adapter. None for clients without latency.

        Raises:
            SimulatorError: another process already serves the bus.
        """
        self._latency = latency or latency_without_adapter
        self._latencies: dict[HubConnection, AdapterLatency] = {}
        self._delayed_records: list[tuple[int, int, HubConnection, bytes]] = []
        """Records delayed by a client's adapter: time of delivery to the client [ns], serial number, client, record."""
        self._delayed_count = 0
        self._hub = BusHub(name)
        self.wire = SimulatedWire(rate, options)
        self._bus = bus
        self._now_ns = now_ns
        self._clients: dict[HubConnection, CanController] = {}
        self._queues: dict[HubConnection, tuple[int, int]] = {}
        """For each client, the number of received records, and the number of records reported as sent.

        The second number is -1 if no report has reached the client.
        """
        self._nodes: dict[int, CanController] = {}
        self._received: deque[Frame] = deque()
        self._unreadable = self._refused = 0
        self._at_ns = self._start_ns = now_ns()
        if is_node_side:
            self.wire.add_controller(self._receive_on_nodes)

    @property
    def lost_frame_count(self) -> int:
        """Return the number of frames that were lost on the bus of this port.

        A lost frame is a frame that was dropped for a slow client, a frame that the full queue of a
        node refused, or an invalid record.
        """
        return self._hub.dropped_record_count + self._unreadable + self._refused

    @property
    def due_ns(self) -> int:
        """See ``bus_ports.BusPort.due_ns``."""
        return (
            min(self.wire.next_event_ns(), self._delayed_records[0][0])
            if self._delayed_records
            else self.wire.next_event_ns()
        )

    @property
    def load(self) -> float:
        """Return the fraction of time in which frames occupied the wire, since the port was opened."""
        return self.wire.load(0, max(1, self._now_ns() - self._start_ns))

    def read_sockets(self) -> list[socket.socket]:
        """See ``bus_ports.BusPort.read_sockets``."""
        return self._hub.read_sockets()

    def write_sockets(self) -> list[socket.socket]:
        """See ``bus_ports.BusPort.write_sockets``."""
        return self._hub.write_sockets()

    def receive(self, ready_sockets: Collection[socket.socket]) -> list[Frame]:
        """Receive the next frames whose transmission on the wire has ended.

        If no transmission has ended since the last call, return an empty list.

        The class ``bus_ports.BusPort`` describes how to call this method.
        """
        now_ns = self._now_ns()
        if ready_sockets:
            self._read_clients(ready_sockets, now_ns)
        while not self._received and self.wire.next_event_ns() <= now_ns:
            self._at_ns = self.wire.next_event_ns()
            self.wire.step(now_ns)
        while self._delayed_records and self._delayed_records[0][0] <= now_ns:
            _, _, link, record = heappop(self._delayed_records)
            link.deliver(record)
        frames = list(self._received)
        self._received.clear()
        self._report_queues()
        return frames

    def _report_queues(self) -> None:
        """Report to each client how many frames of the client have left the send queue.

        From the reported number, a client computes how many frames are still in its send queue.
        When the queue is full, the client can refuse to send a frame.
        """
        for link, controller in self._clients.items():
            arrival_count, reported_count = self._queues[link]
            departed_frame_count = arrival_count - len(controller.queue)
            if departed_frame_count != reported_count:
                dropped_count = link.dropped_record_count
                link.deliver(
                    pack_record(
                        Frame(
                            QUEUE_REPORT_ID,
                            _QUEUE_REPORT_STRUCT.pack(
                                departed_frame_count & 0xFFFFFFFF, self.wire.options.queue
                            ),
                        )
                    )
                )
                self._queues[link] = (
                    arrival_count,
                    departed_frame_count if link.dropped_record_count == dropped_count else -1,
                )

    def _read_clients(self, ready_sockets: Collection[socket.socket], now_ns: int) -> None:
        """Read frames from the clients, and put the frames into the send queues of the clients.

        Args:
            ready_sockets: sockets that are ready for reading.
            now_ns: present time of the wire [ns].
        """
        received_records = self._hub.poll(ready_sockets)
        for link in self._hub.links:
            if link not in self._clients:
                self._clients[link] = self.wire.add_controller(self._make_delivery_function(link))
                self._queues[link] = 0, -1
                self._latencies[link] = self._latency(len(self._latencies))
        for link, records in received_records:
            arrival_count, reported_count = self._queues[link]
            self._queues[link] = arrival_count + len(records) // RECORD_SIZE, reported_count
            frames, unreadable = split_records(records, self._bus)
            self._unreadable += unreadable
            for frame in frames:
                if not frame.can_id & ERROR_FLAG:
                    self._clients[link].queue_frame(frame, self._latencies[link].send(now_ns))
        self._remove_closed_clients()

    def _remove_closed_clients(self) -> None:
        for link in [link for link in self._clients if link.closed]:
            self.wire.remove_controller(self._clients.pop(link))
            del self._queues[link], self._latencies[link]
        self._hub.remove_closed_clients()

    def _make_delivery_function(self, link: HubConnection) -> Callable[[Frame, int], None]:
        """Return the function that passes frames from the wire to a client.

        The function delays each frame by the latency of the client's CAN adapter.
        """

        def deliver(frame: Frame, t_ns: int) -> None:
            delivery_time_ns = self._latencies[link].receive(t_ns)
            if delivery_time_ns <= t_ns:
                link.deliver(pack_record(frame))
                return
            self._delayed_count += 1
            heappush(
                self._delayed_records,
                (delivery_time_ns, self._delayed_count, link, pack_record(frame)),
            )

        return deliver

    def _receive_on_nodes(self, frame: Frame, t_ns: int) -> None:
        """Store a frame that the nodes have received from the wire. Error frames are ignored."""
        if not frame.can_id & ERROR_FLAG:
            self._received.append(frame)

    def send(self, frames: list[Frame]) -> None:
        """Send the answers of the nodes.

        The transmission of an answer begins at the earliest at the end of the last received frame.
        See ``bus_ports.BusPort.send``.
        """
        for frame in frames:
            controller = self._nodes.get(frame.can_id)
            if controller is None:
                controller = self._nodes[frame.can_id] = self.wire.add_controller()
            self._refused += not controller.queue_frame(frame, self._at_ns)

    def close(self) -> None:
        """See ``bus_ports.BusPort.close``."""
        self._hub.close()


def timed_port_factory(
    wire_words: Sequence[str] | None,
    bitrates: Sequence[tuple[int, int]],
    now_ns: Callable[[], int],
    is_node_side: bool = True,
) -> Callable[[str, int], TimedPort] | None:
    """Return the function that opens the port of a bus with a simulated wire.

    Args:
        wire_words: words KEY=VALUE after the option ``--wire``, or None if the option was not given.
        bitrates: nominal and data bit rate of each bus [bit/s].
        now_ns: function that returns the present time of the wires [ns].
        is_node_side: True if simulated nodes in this process acknowledge frames.

    Returns:
        Function that opens the port of a bus with the given name and index. None if ``--wire`` was
        not given.

    Raises:
        SimulatorError: a word after ``--wire`` is not valid.
    """
    if wire_words is None:
        return None
    spec = parse_wire_options(wire_words)
    return lambda name, bus: TimedPort(
        name, bus, spec.bit_rates(*bitrates[bus]), spec.options, now_ns, is_node_side, spec.latency
    )


def latency_without_adapter(adapter_number: int) -> AdapterLatency:
    """Return a latency of zero, for a client that is connected to the wire without a CAN adapter."""
    return AdapterLatency(NO_LATENCY_CLASS)
