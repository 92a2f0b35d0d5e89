"""Discovery of the nodes on a bus. A scan moves no motor, because no drive obeys its requests as commands.

Each protocol has one ``ProtocolDiscovery``. A scan has four rounds. In round 0, the scan only
listens. In round 1, the scan sends requests to all nodes at once. In round 2, the scan sends
requests to every node number. In round 3, the scan requests details from discovered nodes. After
each round of the scan, the nodes are computed from all received frames. The functions of a
``ProtocolDiscovery`` store no state between the rounds. ``split_safe_requests`` leaves out each
request that a drive of another protocol would obey as a command.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from handctl.drives.frame import REMOTE_FLAG, Frame

PROBE_ROUNDS = range(4)
# Durations of the rounds of a scan [s]. Round 0 listens long enough for several heartbeats. A round
# with requests waits for answers.
SCAN_LISTEN_S = 0.7
PROBE_ANSWER_TIMEOUT_S = 0.25


@dataclass(frozen=True)
class DiscoveredNode:
    """Node discovered on a bus, with the data reported by the node.

    Attributes:
        protocol: name of the protocol in the hand file.
        node_id: node number.
        firmware: firmware version, empty if not reported.
        serial: serial number, empty if not reported.
        state: state of the node in words, empty if not reported.
        error: error of the node in words, empty if not reported.
        settings: values for the keys of a ``[[motor]]`` section, by key. The scan reads most values
            from the drive.
        options: values for the keys of ``[motor.options]``, by key. The scan reads most values from
            the drive.
        notes: warnings for the operator.
        origins: source of each value in ``settings`` and ``options`` that was not read from the
            drive, by key.
        twins: True if two drives answer with the same node number.
    """

    protocol: str
    node_id: int
    firmware: str = ""
    serial: str = ""
    state: str = ""
    error: str = ""
    settings: Mapping[str, float] = field(default_factory=dict)
    options: Mapping[str, bool | int | float | str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    origins: Mapping[str, str] = field(default_factory=dict)
    twins: bool = False


DUPLICATE_NODE_WARNING = (
    "two drives answer with this number: set another number with one drive on the bus at a time"
)
"""Warning for a node whose ``twins`` is True."""


def is_number_used_by_two_drives(
    payloads_by_command: Mapping[int, Sequence[bytes]], serial: int
) -> bool:
    """Return True if the answers come from two drives with the same node number.

    A bus can deliver one frame twice by mistake. Two answers to a single request are therefore no
    evidence of two drives. Two answers to each of two different requests are evidence of two
    drives, as are two different serial numbers.

    Args:
        payloads_by_command: received answers to each request of the scan, by request, for example by register
            number. The scan sends each request once.
        serial: key of the request for the serial number in ``payloads_by_command``. Two drives
            never answer the request for the serial number equally.
    """
    serials = set(payloads_by_command.get(serial, ()))
    return (
        len(serials) > 1 or sum(len(payloads) > 1 for payloads in payloads_by_command.values()) > 1
    )


def keep_node_unchanged(node: DiscoveredNode) -> DiscoveredNode:
    """Return the description of a discovered node unchanged.

    ``keep_node_unchanged`` is the default for protocols in which a missing answer to a scan request
    has no meaning.
    """
    return node


ReceivedFrames = Sequence[Frame]
"""All frames received on one bus, oldest first."""


class ProtocolDiscovery(NamedTuple):
    """Discovery functions of one protocol.

    Attributes:
        probe_frames: function returning the request frames of a round, from the frames received in
            earlier rounds.
        nodes: function returning the nodes that have sent the received frames.
        command_ids: function returning the identifiers of frames that a node obeys as commands.
        other_host_frames: function returning those received frames that only another host can have
            sent.
        ping: function returning a request to one node. The request ``ping`` does not move the
            motor.
        is_ping_reply: function returning True if a frame is the answer of a node to ``ping``.
        correct_passive_result: function that corrects the data of a node if the scan has only
            listened. A missing answer has no meaning if the scan sends no requests.
    """

    probe_frames: Callable[[int, ReceivedFrames], tuple[Frame, ...]]
    nodes: Callable[[ReceivedFrames], tuple[DiscoveredNode, ...]]
    command_ids: Callable[[DiscoveredNode], frozenset[int]]
    other_host_frames: Callable[[ReceivedFrames], tuple[Frame, ...]]
    ping: Callable[[DiscoveredNode], Frame]
    is_ping_reply: Callable[[DiscoveredNode, Frame], bool]
    correct_passive_result: Callable[[DiscoveredNode], DiscoveredNode] = keep_node_unchanged


def split_safe_requests(
    probe_frames: Iterable[Frame], command_ids: Iterable[frozenset[int]]
) -> tuple[tuple[Frame, ...], tuple[Frame, ...]]:
    """Split scan requests into safe and unsafe requests.

    A drive of another protocol would obey an unsafe request as a command.

    Args:
        probe_frames: requests, as data frames or remote frames. A remote frame has no payload, and
            no drive obeys it.
        command_ids: command identifiers of every discovered node of another protocol.
    """
    all_command_ids = frozenset().union(*command_ids)
    requests = tuple(probe_frames)
    safe_requests = tuple(
        frame
        for frame in requests
        if frame.can_id & REMOTE_FLAG or frame.can_id not in all_command_ids
    )
    return safe_requests, tuple(frame for frame in requests if frame not in safe_requests)
