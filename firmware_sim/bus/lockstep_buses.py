"""Buses for a simulation in lockstep: each frame occupies a simulated wire for its transmission time."""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence

from firmware_sim.bus.frame import ERROR_FLAG, Frame
from firmware_sim.simulated_world import SimulatedWorld
from firmware_sim.wire.can_controller import CanController
from firmware_sim.wire.simulated_wire import SimulatedWire
from firmware_sim.wire.wire_options import WireSpec


class LockstepBuses:
    """The simulated buses of a hand, for a simulation in lockstep.

    Each bus is a simulated wire between the host and the nodes.

    Attributes:
        wires: one simulated wire for each bus.
        refused: number of frames that a node could not send because the queue of its CAN controller
            was full.
    """

    def __init__(self, world: SimulatedWorld, spec: WireSpec) -> None:
        """Connect the host and the nodes of each bus to the simulated wire of the bus.

        Args:
            world: the simulated hand.
            spec: behaviour of the simulated wires.
        """
        self._world = world
        self.wires = [
            SimulatedWire(spec.bit_rates(*bitrates), spec.options)
            for bitrates in world.hand.bitrates
        ]
        self.refused = 0
        self._arrived: list[Frame] = []
        self._received: list[Frame] = []
        self._latencies = [spec.latency(bus) for bus in range(len(self.wires))]
        self._hosts = [
            wire.add_controller(self._delivery_to_host(bus)) for bus, wire in enumerate(self.wires)
        ]
        for bus, wire in enumerate(self.wires):
            wire.add_controller(self._delivery_to_nodes(bus))
        self._nodes: dict[tuple[int, int], CanController] = {}

    def _delivery_to_host(self, bus: int) -> Callable[[Frame, int], None]:
        latency = self._latencies[bus]

        def receive(frame: Frame, t_ns: int) -> None:
            can_id, data, flags, _, _ = frame
            self._arrived.append(Frame(can_id, data, flags, bus, latency.receive(t_ns)))

        return receive

    def _delivery_to_nodes(self, bus: int) -> Callable[[Frame, int], None]:
        def receive(frame: Frame, t_ns: int) -> None:
            can_id, data, flags, _, _ = frame
            if not can_id & ERROR_FLAG:
                self._received.append(Frame(can_id, data, flags, bus, t_ns))

        return receive

    def step(self, t_ns: int, frames: Iterable[Frame], end_ns: int) -> list[Frame]:
        """Queue the frames of the host, and process all wire events of the tick.

        Args:
            t_ns: start of the tick [ns].
            frames: frames of the host.
            end_ns: start of the next tick [ns].

        Returns:
            The frames that have reached the host before ``end_ns``, in the order of arrival.
        """
        for frame in frames:
            self._hosts[frame.bus].queue_frame(frame, self._latencies[frame.bus].send(t_ns))
        while True:
            event_time_ns = min([wire.next_event_ns() for wire in self.wires])
            self._world.advance(min(event_time_ns, end_ns))
            # A frame that a node has just queued can start before ``event_time_ns``. So each wire
            # must determine its next event again.
            if self._queue_node_frames(self._world.take_unsolicited_frames()):
                continue
            if event_time_ns >= end_ns:
                break
            for wire in self.wires:
                wire.advance(event_time_ns)
            # The answer of a node contains readings of the plant. Therefore, before the node
            # answers, the plant advances to the time at which the wire has carried the whole
            # request.
            if any(map(self._world.has_receiver, self._received)):
                self._world.advance_exactly(event_time_ns)
            self._answer_received_frames()
        arrived_frames = sorted(self._arrived, key=_arrival_ns)
        ready_count = bisect_left(arrived_frames, end_ns, key=_arrival_ns)
        self._arrived = arrived_frames[ready_count:]
        return arrived_frames[:ready_count]

    def _answer_received_frames(self) -> None:
        received_frames = self._received
        self._received = []
        for frame in received_frames:
            for can_id, data, flags, bus, _ in self._world.receive(frame):
                self._queue_node_frame(Frame(can_id, data, flags, bus, frame.t_ns))

    def _queue_node_frames(self, frames: Sequence[Frame]) -> bool:
        """Put each frame that a node sends into the send queue of the frame's CAN controller.

        Returns:
            True if there was at least one frame.
        """
        for frame in frames:
            self._queue_node_frame(frame)
        return bool(frames)

    def _queue_node_frame(self, frame: Frame) -> None:
        """Queue a frame of a node for sending, in the CAN controller for the identifier of the frame.

        Each frame identifier has its own CAN controller. The frames of different nodes therefore do
        not wait for each other in one queue.
        """
        key = frame.bus, frame.can_id
        if key not in self._nodes:
            self._nodes[key] = self.wires[frame.bus].add_controller()
        self.refused += not self._nodes[key].queue_frame(frame, frame.t_ns)


def _arrival_ns(frame: Frame) -> int:
    return frame.t_ns
