"""Scan of one bus for drives. It listens first, and asks only if no other host is active on the bus.

No frame that the scan sends is a command.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

from handctl.drives.discovery import ANSWER_S, LISTEN_S, ROUNDS, Found, allowed
from handctl.drives.frame import Frame
from handctl.drives.registry import DISCOVERIES
from handctl.runtime.buses.contract import Bus

BURST, PAUSE_S = 4, 0.003
"""Frames that are sent at once, and the pause after them [s]. An interface may queue as few as 10 frames."""
PATIENCE = 50
"""Tries for a frame that the interface refuses."""


STRAY = 1
"""Frames of another host that are ignored. They may be the last ones of a host that has just ended."""
Hear = Callable[[Bus, float, list[Frame]], None]
"""Function that collects the frames that arrive on a bus during a time [s]."""


class Scan(NamedTuple):
    """Result of a scan.

    Attributes:
        found: drives, by protocol and number.
        foreign: frames of another host. If there are any, the scan has sent no request.
        unasked: requests that were omitted because a present drive would have taken them as commands.
        events: of the bus during the scan.
        frames: number of received frames.
    """

    found: tuple[Found, ...]
    foreign: tuple[Frame, ...]
    unasked: tuple[Frame, ...]
    events: tuple[tuple[str, str, int], ...]
    frames: int


def hear(bus: Bus, for_s: float, seen: list[Frame]) -> None:
    """Append the frames that arrive during a time [s] to ``seen``."""
    end = time.monotonic() + for_s
    while True:
        seen += bus.drain()
        left = end - time.monotonic()
        if left <= 0:
            return
        time.sleep(min(left, 0.005))


def scan(bus: Bus, force: bool = False, tell: Callable[[str], None] = lambda text: None, hear: Hear = hear) -> Scan:
    """Scan a bus for drives, in some two seconds.

    Args:
        bus: open bus.
        force: send requests although another host seems to be active.
        tell: called with a text about each step.
        hear: lets time pass on the bus.
    """
    seen: list[Frame] = []
    unasked: list[Frame] = []
    foreign: tuple[Frame, ...] = ()
    for turn in ROUNDS:
        tell("listening" if turn == 0 else f"asking, round {turn} of {ROUNDS[-1]}")
        for frame in _questions(turn, seen, unasked):
            if not _send(bus, frame, seen, hear):
                break
        hear(bus, LISTEN_S if turn == 0 else ANSWER_S, seen)
        if turn == 0 and not force and (foreign := _foreign(seen)):
            break
    found = tuple(node for discovery in DISCOVERIES.values() for node in discovery.found(seen))
    return Scan(found, foreign, tuple(unasked), tuple(bus.take_events()), len(seen))


def all_questions() -> tuple[Frame, ...]:
    """Return the requests that a scan sends on a bus without any answer."""
    return tuple(frame for turn in ROUNDS for frame in _questions(turn, [], []))


def _questions(turn: int, seen: list[Frame], unasked: list[Frame]) -> list[Frame]:
    """Return the requests of all protocols in a round.

    Requests that a present drive of another protocol would take as commands are omitted. They are
    appended to ``unasked``.
    """
    asked: list[Frame] = []
    for name, discovery in DISCOVERIES.items():
        kept, dropped = allowed(discovery.questions(turn, seen), _orders_of_others(name, seen))
        asked += kept
        unasked += dropped
    return asked


def _orders_of_others(name: str, seen: list[Frame]) -> list[frozenset[int]]:
    """Return the command identifiers of each present drive that has another protocol than ``name``."""
    others = (discovery for other, discovery in DISCOVERIES.items() if other != name)
    return [discovery.orders(node) for discovery in others for node in discovery.found(seen)]


def _foreign(seen: list[Frame]) -> tuple[Frame, ...]:
    """Return the frames of another host.

    An identifier that belongs to a present drive of another protocol does not count as foreign.
    """
    strange: list[Frame] = []
    for name, discovery in DISCOVERIES.items():
        explained = frozenset().union(*_orders_of_others(name, seen))
        strange += [frame for frame in discovery.foreign(seen) if frame.can_id not in explained]
    return tuple(dict.fromkeys(strange)) if len(strange) > STRAY else ()


def _send(bus: Bus, frame: Frame, seen: list[Frame], hear: Hear) -> bool:
    """Send a frame with pauses and listen meanwhile. Returns False if the interface refused it."""
    for _ in range(PATIENCE):
        if bus.send((frame,)):
            hear(bus, PAUSE_S / BURST, seen)
            return True
        hear(bus, PAUSE_S, seen)
    return False
