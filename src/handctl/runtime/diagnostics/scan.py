"""Looks for drives on one bus: listens, and asks unless somebody else controls it. Nothing that is sent is an order."""

import time
from collections.abc import Callable
from typing import NamedTuple

from handctl.drives.discovery import ANSWER_S, LISTEN_S, ROUNDS, Found, allowed
from handctl.drives.frame import Frame
from handctl.drives.registry import DISCOVERIES
from handctl.runtime.buses.contract import Bus

BURST, PAUSE_S = 4, 0.003
"""Frames that are sent at once, and the pause after them: an interface may queue as few as ten [s]."""
PATIENCE = 50
"""Tries for a frame that the interface does not take."""


STRAY = 1
"""So many frames of another host may be the last ones of one that has just ended."""
Hear = Callable[[Bus, float, list[Frame]], None]
"""Collects what arrives on a bus during a time [s]."""


class Scan(NamedTuple):
    """What was found on a bus.

    Attributes:
        found: drives, by protocol and number.
        foreign: frames of another host, because of which nothing was asked; empty if there were none.
        unasked: questions that were left out because a drive that is there would have obeyed them.
        events: what happened to the bus meanwhile.
        frames: how many were heard.
    """

    found: tuple[Found, ...]
    foreign: tuple[Frame, ...]
    unasked: tuple[Frame, ...]
    events: tuple[tuple[str, str, int], ...]
    frames: int


def hear(bus: Bus, for_s: float, seen: list[Frame]) -> None:
    """Collect what arrives during a time [s]."""
    end = time.monotonic() + for_s
    while True:
        seen += bus.drain()
        left = end - time.monotonic()
        if left <= 0:
            return
        time.sleep(min(left, 0.005))


def scan(bus: Bus, force: bool = False, tell: Callable[[str], None] = lambda text: None, hear: Hear = hear) -> Scan:
    """Look for drives on a bus, some two seconds long.

    Args:
        bus: open.
        force: ask although another host seems to be at work.
        tell: is called with what is being done.
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
    """Everything that is asked on a bus where nothing answers."""
    return tuple(frame for turn in ROUNDS for frame in _questions(turn, [], []))


def _questions(turn: int, seen: list[Frame], unasked: list[Frame]) -> list[Frame]:
    """Questions of all protocols in a round, without those that a drive which is there would obey."""
    asked: list[Frame] = []
    for name, discovery in DISCOVERIES.items():
        kept, dropped = allowed(discovery.questions(turn, seen), _orders_of_others(name, seen))
        asked += kept
        unasked += dropped
    return asked


def _orders_of_others(name: str, seen: list[Frame]) -> list[frozenset[int]]:
    others = (discovery for other, discovery in DISCOVERIES.items() if other != name)
    return [discovery.orders(node) for discovery in others for node in discovery.found(seen)]


def _foreign(seen: list[Frame]) -> tuple[Frame, ...]:
    """Frames of another host; what a drive of one protocol says is no order of another's."""
    strange: list[Frame] = []
    for name, discovery in DISCOVERIES.items():
        explained = frozenset().union(*_orders_of_others(name, seen))
        strange += [frame for frame in discovery.foreign(seen) if frame.can_id not in explained]
    return tuple(dict.fromkeys(strange)) if len(strange) > STRAY else ()


def _send(bus: Bus, frame: Frame, seen: list[Frame], hear: Hear) -> bool:
    """Send with pauses, and listen meanwhile; whether the interface took it."""
    for _ in range(PATIENCE):
        if bus.send((frame,)):
            hear(bus, PAUSE_S / BURST, seen)
            return True
        hear(bus, PAUSE_S, seen)
    return False
