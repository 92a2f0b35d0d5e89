"""Scan of one bus for drives. It listens first, and asks only if no other host is active on the bus.

No frame that the scan sends is a command.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

from handctl.drives.discovery import ANSWER_S, LISTEN_S, ROUNDS, DiscoveredNode, split_probes
from handctl.drives.frame import Frame
from handctl.drives.registry import DISCOVERIES
from handctl.runtime.buses.contract import Bus

BURST = 4
"""Frames that are sent at once. An interface may queue as few as 10 frames."""
PAUSE_S = 0.003
"""Pause after a burst [s]."""
TRIES = 50
"""Tries for a frame that the interface refuses."""


STRAY = 1
"""Frames of another host that are ignored. They may be the last ones of a host that has just ended."""
Listen = Callable[[Bus, float, list[Frame]], None]
"""Function that collects the frames that arrive on a bus during a time [s]."""


class Scan(NamedTuple):
    """Result of a scan.

    Attributes:
        found: drives, by protocol and number.
        foreign: frames of another host. If there are any, the scan has sent no request.
        omitted: requests that were omitted because a present drive would have taken them as commands.
        events: of the bus during the scan.
        frames: number of received frames.
    """

    found: tuple[DiscoveredNode, ...]
    foreign: tuple[Frame, ...]
    omitted: tuple[Frame, ...]
    events: tuple[tuple[str, str, int], ...]
    frames: int


def listen(bus: Bus, for_s: float, seen: list[Frame]) -> None:
    """Append the frames that arrive during a time [s] to ``seen``."""
    end = time.monotonic() + for_s
    while True:
        seen += bus.drain()
        left = end - time.monotonic()
        if left <= 0:
            return
        time.sleep(min(left, 0.005))


def scan(
    bus: Bus, force: bool = False, report: Callable[[str], None] = lambda text: None, listen: Listen = listen
) -> Scan:
    """Scan a bus for drives, in some two seconds.

    Args:
        bus: open bus.
        force: send requests although another host seems to be active.
        report: called with a text about each step.
        listen: lets time pass on the bus.
    """
    seen: list[Frame] = []
    omitted: list[Frame] = []
    foreign: tuple[Frame, ...] = ()
    for turn in ROUNDS:
        report("listening" if turn == 0 else f"asking, round {turn} of {ROUNDS[-1]}")
        for frame in _requests(turn, seen, omitted):
            if not _send(bus, frame, seen, listen):
                break
        listen(bus, LISTEN_S if turn == 0 else ANSWER_S, seen)
        if turn == 0 and not force and (foreign := _foreign(seen)):
            break
    drives = tuple(
        discovery.unasked(node) if foreign else node
        for discovery in DISCOVERIES.values()
        for node in discovery.nodes(seen)
    )
    return Scan(drives, foreign, tuple(omitted), tuple(bus.take_events()), len(seen))


def all_questions() -> tuple[Frame, ...]:
    """Return the requests that a scan sends on a bus without any answer."""
    return tuple(frame for turn in ROUNDS for frame in _requests(turn, [], []))


def _requests(turn: int, seen: list[Frame], omitted: list[Frame]) -> list[Frame]:
    """Return the requests of all protocols in a round.

    Requests that a present drive of another protocol would take as commands are omitted. They are
    appended to ``omitted``.
    """
    requests: list[Frame] = []
    for name, discovery in DISCOVERIES.items():
        allowed_frames, dropped = split_probes(discovery.probe_frames(turn, seen), _commands_of_others(name, seen))
        requests += allowed_frames
        omitted += dropped
    return requests


def _commands_of_others(name: str, seen: list[Frame]) -> list[frozenset[int]]:
    """Return the command identifiers of each present drive that has another protocol than ``name``."""
    others = (discovery for other, discovery in DISCOVERIES.items() if other != name)
    return [discovery.command_ids(node) for discovery in others for node in discovery.nodes(seen)]


def _foreign(seen: list[Frame]) -> tuple[Frame, ...]:
    """Return the frames of another host.

    An identifier that belongs to a present drive of another protocol does not count as foreign.
    """
    foreign: list[Frame] = []
    for name, discovery in DISCOVERIES.items():
        explained = frozenset().union(*_commands_of_others(name, seen))
        foreign += [frame for frame in discovery.other_host_frames(seen) if frame.can_id not in explained]
    return tuple(dict.fromkeys(foreign)) if len(foreign) > STRAY else ()


def _send(bus: Bus, frame: Frame, seen: list[Frame], listen: Listen) -> bool:
    """Send a frame with pauses and listen meanwhile. Returns False if the interface refused it."""
    for _ in range(TRIES):
        if bus.send((frame,)):
            listen(bus, PAUSE_S / BURST, seen)
            return True
        listen(bus, PAUSE_S, seen)
    return False
