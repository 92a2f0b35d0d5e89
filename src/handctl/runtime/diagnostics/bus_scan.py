"""Scan of a CAN bus that finds the drives and other nodes on the bus.

The scan listens before it sends requests. The scan sends requests only if no other host is active
on the bus. The scan never sends commands to drives.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

from handctl.drives.discovery import (
    PROBE_ANSWER_TIMEOUT_S,
    PROBE_ROUNDS,
    SCAN_LISTEN_S,
    DiscoveredNode,
    split_safe_requests,
)
from handctl.drives.frame import Frame
from handctl.drives.protocol_registry import DISCOVERY_BY_PROTOCOL
from handctl.runtime.buses.contract import Bus

MAX_BURST_FRAMES = 4
"""Largest number of frames that are sent in each BURST_PAUSE_S.

The transmit queue of an interface can be as short as 10 frames.
"""
BURST_PAUSE_S = 0.003
"""Time in which the scan sends at most MAX_BURST_FRAMES frames [s].

The pause after a refused frame is equally long.
"""
MAX_SEND_TRIES = 50
"""Number of attempts to send a frame that the interface refuses."""


MAX_IGNORED_FRAMES = 1
"""Largest number of frames from another host that are ignored.

Ignored frames may come from a host that has just ended.
"""
ListenFunction = Callable[[Bus, float, list[Frame]], None]
"""Function that collects the frames received on a bus during a time [s]."""


class BusScan(NamedTuple):
    """Result of a scan of a bus.

    Attributes:
        found_nodes: discovered drives and other nodes, by protocol and number.
        foreign_frames: frames received from another host. If another host has sent frames, the scan
            has sent no requests.
        omitted_requests: requests that the scan has not sent, because a drive on the bus would have
            obeyed them as commands.
        bus_events: events of the bus during the scan.
        frame_count: number of received frames.
    """

    found_nodes: tuple[DiscoveredNode, ...]
    foreign_frames: tuple[Frame, ...]
    omitted_requests: tuple[Frame, ...]
    bus_events: tuple[tuple[str, str, int], ...]
    frame_count: int


def collect_frames(bus: Bus, duration_s: float, seen_frames: list[Frame]) -> None:
    """Append the frames that a bus receives within ``duration_s`` to ``seen_frames``."""
    end_s = time.monotonic() + duration_s
    while True:
        seen_frames += bus.drain()
        remaining_s = end_s - time.monotonic()
        if remaining_s <= 0:
            return
        time.sleep(min(remaining_s, 0.005))


def scan_bus(
    bus: Bus,
    force: bool = False,
    report_text: Callable[[str], None] = lambda text: None,
    listen_function: ListenFunction = collect_frames,
) -> BusScan:
    """Scan a bus for drives, in about two seconds.

    Args:
        bus: open bus.
        force: True to send requests even if another host seems to be active on the bus.
        report_text: function that is called with a text about each step of the scan.
        listen_function: function to collect frames during a time, see ``ListenFunction``.
    """
    seen_frames: list[Frame] = []
    omitted: list[Frame] = []
    foreign_frames: tuple[Frame, ...] = ()
    for turn in PROBE_ROUNDS:
        report_text("listening" if turn == 0 else f"asking, round {turn} of {PROBE_ROUNDS[-1]}")
        for frame in _requests_of_round(turn, seen_frames, omitted):
            if not _send_with_retries(bus, frame, seen_frames, listen_function):
                break
        listen_function(bus, SCAN_LISTEN_S if turn == 0 else PROBE_ANSWER_TIMEOUT_S, seen_frames)
        if turn == 0 and not force and (foreign_frames := _foreign_frames(seen_frames)):
            break
    drives = tuple(
        discovery.correct_passive_result(node) if foreign_frames else node
        for discovery in DISCOVERY_BY_PROTOCOL.values()
        for node in discovery.nodes(seen_frames)
    )
    return BusScan(
        drives, foreign_frames, tuple(omitted), tuple(bus.take_events()), len(seen_frames)
    )


def requests_without_answers() -> tuple[Frame, ...]:
    """Return the requests that a scan sends on a bus where no node answers."""
    return tuple(frame for turn in PROBE_ROUNDS for frame in _requests_of_round(turn, [], []))


def _requests_of_round(
    round_index: int, seen_frames: list[Frame], omitted_frames: list[Frame]
) -> list[Frame]:
    """Return the requests that the scan sends in a round to find drives of all protocols.

    A request that a drive with another protocol might execute as a command is left out, and
    appended to ``omitted_frames``.
    """
    requests: list[Frame] = []
    for name, discovery in DISCOVERY_BY_PROTOCOL.items():
        allowed_frames, dropped_probes = split_safe_requests(
            discovery.probe_frames(round_index, seen_frames),
            _command_ids_of_other_protocols(name, seen_frames),
        )
        requests += allowed_frames
        omitted_frames += dropped_probes
    return requests


def _command_ids_of_other_protocols(name: str, seen_frames: list[Frame]) -> list[frozenset[int]]:
    """Return the command identifiers of each discovered drive that uses another protocol than ``name``."""
    other_discoveries = (
        discovery for protocol, discovery in DISCOVERY_BY_PROTOCOL.items() if protocol != name
    )
    return [
        discovery.command_ids(node)
        for discovery in other_discoveries
        for node in discovery.nodes(seen_frames)
    ]


def _foreign_frames(seen_frames: list[Frame]) -> tuple[Frame, ...]:
    """Return the received frames from another host.

    Under the rules of one protocol, a frame from a drive with another protocol can look like a
    frame from another host. Frames from drives are not part of the result.
    """
    foreign_frames: list[Frame] = []
    for name, discovery in DISCOVERY_BY_PROTOCOL.items():
        known_command_ids = frozenset().union(*_command_ids_of_other_protocols(name, seen_frames))
        foreign_frames += [
            frame
            for frame in discovery.other_host_frames(seen_frames)
            if frame.can_id not in known_command_ids
        ]
    return tuple(dict.fromkeys(foreign_frames)) if len(foreign_frames) > MAX_IGNORED_FRAMES else ()


def _send_with_retries(
    bus: Bus, frame: Frame, seen_frames: list[Frame], listen_function: ListenFunction
) -> bool:
    """Send a frame, and receive frames in the pause after the sent frame.

    If the interface has refused the frame ``MAX_SEND_TRIES`` times, return False.
    """
    for _ in range(MAX_SEND_TRIES):
        if bus.send((frame,)):
            listen_function(bus, BURST_PAUSE_S / MAX_BURST_FRAMES, seen_frames)
            return True
        listen_function(bus, BURST_PAUSE_S, seen_frames)
    return False
