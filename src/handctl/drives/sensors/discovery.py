"""Discovery of the sensor node by its answers to SYNC.

An answer of the sensor node contains the low four bits of the counter in the SYNC.

SYNC does not move a motor that handctl has set up. A CANopen drive that handctl has not set up may
obey stored PDOs at SYNC. A scan sends no SYNC on a bus with a CANopen drive. A scan also sends no
SYNC on a bus with an ODrive whose node number is 4, because the identifier of SYNC is then an
identifier of this ODrive. The function ``command_ids`` of each protocol tells the scan if a drive
uses the identifier of SYNC. Source: ``sensor_node``.
"""

from handctl.drives.discovery import DiscoveredNode, ProtocolDiscovery, ReceivedFrames
from handctl.drives.frame import Frame

SYNC_ID = 0x080
"""Identifier of SYNC, as in CANopen."""
PROBE_SYNC_COUNTERS = (0x35, 0x3A)
"""Counters of the two SYNC frames that a scan sends.

The counters of the two SYNC frames differ, so that a frame that another device repeats does not
count as two answers.
"""
# Number of bits of the counter in an answer, and number of bits of each channel.
HEADER_BITS = 4
CHANNEL_BITS = 12
MAX_FRAME_BYTES = 8
"""Largest payload of an answer of the sensor node [bytes]."""


def probe_frames(scan_round: int, received_frames: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the SYNC frames that the scan sends in a round.

    In round 3, the scan sends two SYNC frames. In rounds 0 to 2, the scan sends no SYNC frame.
    """
    return (
        tuple(sync_with_counter(counter) for counter in PROBE_SYNC_COUNTERS)
        if scan_round == 3
        else ()
    )


def discovered_sensor_nodes(received_frames: ReceivedFrames) -> tuple[DiscoveredNode, ...]:
    """Return the discovered sensor nodes.

    An identifier belongs to a sensor node if each of the two SYNC frames was answered by a frame
    with the identifier. Consecutive identifiers belong to one sensor node.
    """
    ids = sorted(
        {
            frame.can_id
            for frame in received_frames
            if _answers_both_sync_frames(received_frames, frame.can_id)
        }
    )
    first_ids = [can_id for can_id in ids if can_id - 1 not in ids]
    return tuple(_describe_node(can_id, received_frames) for can_id in first_ids)


def _answers_both_sync_frames(received_frames: ReceivedFrames, can_id: int) -> bool:
    """Return True if the frames with an identifier repeat the counters of both SYNC frames in order."""
    counters = [
        frame.data[0] & 0xF
        for frame in received_frames
        if frame.can_id == can_id and 2 <= len(frame.data) <= MAX_FRAME_BYTES
    ]
    return can_id < SYNC_ID << 3 and counters == [counter & 0xF for counter in PROBE_SYNC_COUNTERS]


def _describe_node(can_id: int, received_frames: ReceivedFrames) -> DiscoveredNode:
    """Return the description of the sensor node whose first identifier is ``can_id``."""
    size = next(len(frame.data) for frame in received_frames if frame.can_id == can_id)
    channels = (8 * size - HEADER_BITS) // CHANNEL_BITS
    note = (
        f"answers SYNC 0x{SYNC_ID:03x}: a sensor node with base_id "
        f"= 0x{can_id:x} and {channels} channels in a frame?"
    )
    return DiscoveredNode("sensor", can_id, state="answers SYNC", notes=(note,))


def command_ids(node: DiscoveredNode) -> frozenset[int]:
    """Return no identifiers of commands, because SYNC only makes the sensor node take a sample."""
    return frozenset()


def other_host_frames(received_frames: ReceivedFrames) -> tuple[Frame, ...]:
    """Return an empty tuple, because the discovery of CANopen drives already reports the SYNC of another host."""
    return ()


def sync_with_counter(counter: int) -> Frame:
    """Return a SYNC frame with the given counter."""
    return Frame(SYNC_ID, bytes((counter,)))


def ping_request(node: DiscoveredNode) -> Frame:
    """Return a SYNC frame, which a sensor node answers."""
    return sync_with_counter(PROBE_SYNC_COUNTERS[0])


def is_ping_reply(node: DiscoveredNode, frame: Frame) -> bool:
    """Return True if the frame is an answer of the node with the counter of ``ping_request``."""
    return (
        frame.can_id == node.node_id
        and len(frame.data) >= 2
        and frame.data[0] & 0xF == PROBE_SYNC_COUNTERS[0] & 0xF
    )


DISCOVERY = ProtocolDiscovery(
    probe_frames,
    discovered_sensor_nodes,
    command_ids,
    other_host_frames,
    ping_request,
    is_ping_reply,
)
