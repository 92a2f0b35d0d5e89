"""Discovery of the nodes on a bus without motion. No drive obeys the requests as commands.

Each protocol has one ``Discovery``. Requests come in rounds: listen (0), ask all nodes at once (1),
ask every node number (2), ask discovered nodes for details (3). After each round the nodes are
computed from all received frames. The functions here keep no state. ``split_probes`` leaves out
requests that are a command to a drive of another protocol.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from handctl.drives.frame import REMOTE, Frame

ROUNDS = range(4)
# Time of several heartbeats in which a scan only listens, and time to wait for the answers of a
# round [s].
LISTEN_S = 0.7
ANSWER_S = 0.25


@dataclass(frozen=True)
class DiscoveredNode:
    """Node found on a bus, with the data that it reported.

    Attributes:
        protocol: name in the hand file.
        node_id: node number.
        firmware: version, empty if not reported.
        serial: serial number, empty if not reported.
        state: state in words, empty if not reported.
        error: error in words, empty if not reported.
        settings: keys of a ``[[motor]]`` section with values from the drive.
        options: keys of ``[motor.options]`` with values from the drive.
        notes: warnings for the operator.
        origins: source of each value in settings or options that the drive has not reported, by
            key.
        twins: True if more than one drive answers with this number.
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


TWO_DRIVES_WARNING = "two drives answer with this number: set another number with one drive on the bus at a time"
"""Warning for a node whose ``twins`` is True."""


def have_two_drives_answered(answers: Mapping[int, Sequence[bytes]], serial: int) -> bool:
    """Return True if single requests got answers from two drives.

    A bus may deliver one frame twice by mistake, but not the answers to two different requests.

    Args:
        answers: received answers by request (for example by register number). Each request was sent
            once.
        serial: the request for the serial number. Two drives never give equal answers to it.
    """
    serials = set(answers.get(serial, ()))
    return len(serials) > 1 or sum(len(payloads) > 1 for payloads in answers.values()) > 1


def unchanged_node(node: DiscoveredNode) -> DiscoveredNode:
    """Return the node unchanged, for protocols that draw no conclusion from a missing answer."""
    return node


ReceivedFrames = Sequence[Frame]
"""All frames received on one bus, oldest first."""


class Discovery(NamedTuple):
    """Discovery functions of one protocol.

    Attributes:
        probe_frames: request frames of a round, from the frames received before, for bus 0.
        nodes: the nodes that sent the received frames.
        command_ids: identifiers that a node obeys as commands, from any sender.
        other_host_frames: those received frames that only another host can have sent.
        ping: request to one node that causes no motion.
        is_ping_reply: True if a frame answers ``ping``.
        unasked: function that returns the node for a scan that only listened. No conclusion is
            drawn from a missing answer.
    """

    probe_frames: Callable[[int, ReceivedFrames], tuple[Frame, ...]]
    nodes: Callable[[ReceivedFrames], tuple[DiscoveredNode, ...]]
    command_ids: Callable[[DiscoveredNode], frozenset[int]]
    other_host_frames: Callable[[ReceivedFrames], tuple[Frame, ...]]
    ping: Callable[[DiscoveredNode], Frame]
    is_ping_reply: Callable[[DiscoveredNode, Frame], bool]
    unasked: Callable[[DiscoveredNode], DiscoveredNode] = unchanged_node


def split_probes(
    probe_frames: Iterable[Frame], command_ids: Iterable[frozenset[int]]
) -> tuple[tuple[Frame, ...], tuple[Frame, ...]]:
    """Split requests into safe ones and those that a drive of another protocol would obey.

    Args:
        probe_frames: data and remote frames. A remote frame has no payload, and no drive obeys it.
        command_ids: command identifiers of every discovered node of another protocol.
    """
    obeyed = frozenset().union(*command_ids)
    probes = tuple(probe_frames)
    safe = tuple(frame for frame in probes if frame.can_id & REMOTE or frame.can_id not in obeyed)
    return safe, tuple(frame for frame in probes if frame not in safe)
