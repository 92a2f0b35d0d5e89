"""Finding out what is on a bus without moving anything: questions that no drive takes as an order, and their answers.

A protocol offers one ``Discovery``. Its questions come in rounds: it listens (0), asks all at once (1), asks every
number (2), asks those that it has found for more (3). What is found is worked out anew from all frames seen so far, so
nothing here keeps a state. A question that means an order to a drive of another protocol is left out by ``allowed``.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from handctl.drives.frame import REMOTE, Frame

ROUNDS = range(4)
LISTEN_S, ANSWER_S = 0.7, 0.25
"""How long to listen at first: several heartbeats; and how long to wait for the answers of a round [s]."""


@dataclass(frozen=True)
class Found:
    """A node and what it tells of itself.

    Attributes:
        protocol: name in the hand file.
        node_id: its number.
        firmware, serial, state, error: in words; empty if it has not told.
        settings: keys of a ``[[motor]]`` section that the drive itself knows.
        options: the same for ``[motor.options]``.
        notes: what a person should know before trusting it.
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


Seen = Sequence[Frame]
"""All frames of one bus so far, oldest first."""


class Discovery(NamedTuple):
    """How a protocol is looked for.

    Attributes:
        questions: frames of a round, given what was seen; bus 0.
        found: nodes in what was seen.
        orders: identifiers that a node takes as an order, whoever sends them.
        foreign: frames that only another host can have sent.
        ping: a question to one node that moves nothing. pong: whether a frame is the answer to it.
    """

    questions: Callable[[int, Seen], tuple[Frame, ...]]
    found: Callable[[Seen], tuple[Found, ...]]
    orders: Callable[[Found], frozenset[int]]
    foreign: Callable[[Seen], tuple[Frame, ...]]
    ping: Callable[[Found], Frame]
    pong: Callable[[Found, Frame], bool]


def allowed(
    questions: Iterable[Frame], orders: Iterable[frozenset[int]]
) -> tuple[tuple[Frame, ...], tuple[Frame, ...]]:
    """Split questions into those that may be sent and those that a drive of another protocol would obey.

    Args:
        questions: data and remote frames; a remote frame carries nothing that could be obeyed.
        orders: of every node found that is not of the questions' protocol.
    """
    taken = frozenset().union(*orders)
    asked = tuple(questions)
    kept = tuple(frame for frame in asked if frame.can_id & REMOTE or frame.can_id not in taken)
    return kept, tuple(frame for frame in asked if frame not in kept)
