"""Discovery of the sensor node by its answers, which contain the low four bits of the SYNC counter.

SYNC does not move a motor that handctl has set up. Other CANopen drives apply pending PDOs at SYNC.
No SYNC is sent on a bus with a CANopen drive or an ODrive with node number 4, because their
``command_ids`` include the identifier of SYNC. Source: ``node``.
"""

from handctl.drives.discovery import DiscoveredNode, Discovery, ReceivedFrames
from handctl.drives.frame import Frame

SYNC = 0x080
"""Identifier of SYNC, as in CANopen."""
COUNTERS = (0x35, 0x3A)
"""Counters of the two SYNCs.

The counters differ, so that a frame of another device does not count as two answers.
"""
# Bits of the counter and of a channel.
HEADER_BITS = 4
CHANNEL_BITS = 12
MAX_FRAME_BYTES = 8
"""Largest payload of an answer [bytes]."""


def probe_frames(turn: int, received: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the request frames of a round: two SYNCs in round 3."""
    return tuple(ping_with_counter(counter) for counter in COUNTERS) if turn == 3 else ()


def sensor_nodes_in(received: ReceivedFrames) -> tuple[DiscoveredNode, ...]:
    """Return the discovered sensor nodes: identifiers that answered both SYNCs.

    Consecutive identifiers are one node.
    """
    ids = sorted({frame.can_id for frame in received if _answers_both_syncs(received, frame.can_id)})
    first = [can_id for can_id in ids if can_id - 1 not in ids]
    return tuple(_describe_node(can_id, received) for can_id in first)


def _answers_both_syncs(received: ReceivedFrames, can_id: int) -> bool:
    """Return True if all frames of an identifier contain the SYNC counters, in the order sent."""
    counters = [
        frame.data[0] & 0xF for frame in received if frame.can_id == can_id and 2 <= len(frame.data) <= MAX_FRAME_BYTES
    ]
    return can_id < SYNC << 3 and counters == [counter & 0xF for counter in COUNTERS]


def _describe_node(can_id: int, received: ReceivedFrames) -> DiscoveredNode:
    """Return the discovered sensor node with its data."""
    size = next(len(frame.data) for frame in received if frame.can_id == can_id)
    channels = (8 * size - HEADER_BITS) // CHANNEL_BITS
    note = f"answers SYNC 0x{SYNC:03x}: a sensor node with base_id = 0x{can_id:x} and {channels} channels in a frame?"
    return DiscoveredNode("sensor", can_id, state="answers SYNC", notes=(note,))


def command_ids(node: DiscoveredNode) -> frozenset[int]:
    """Return an empty set: SYNC makes the node sample and has no effect on a motor."""
    return frozenset()


def other_host_frames(received: ReceivedFrames) -> tuple[Frame, ...]:
    """Return no frames, because CANopen's discovery reports a SYNC of another host."""
    return ()


def ping_with_counter(counter: int) -> Frame:
    """Return a SYNC frame with this counter."""
    return Frame(SYNC, bytes((counter,)))


def ping(node: DiscoveredNode) -> Frame:
    """Return a SYNC frame."""
    return ping_with_counter(COUNTERS[0])


def is_ping_reply(node: DiscoveredNode, frame: Frame) -> bool:
    """Return True if the frame is an answer with the counter of ``ping``."""
    return frame.can_id == node.node_id and len(frame.data) >= 2 and frame.data[0] & 0xF == COUNTERS[0] & 0xF


DISCOVERY = Discovery(probe_frames, sensor_nodes_in, command_ids, other_host_frames, ping, is_ping_reply)
