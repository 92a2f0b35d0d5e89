"""Round-trip time of a node: from the call that sends a harmless request to the reception of the answer."""

import time
from typing import NamedTuple

from handctl.drives.discovery import DiscoveredNode
from handctl.drives.registry import DISCOVERIES
from handctl.runtime.buses.contract import Bus

TIMES = 20
"""Number of requests."""
ANSWER_S = 0.1
"""Longest wait for an answer [s]."""


class RoundTrip(NamedTuple):
    """Result of a measurement.

    Attributes:
        answers: number of answers.
        asked: number of requests.
        shortest: round-trip time [s]. NaN without an answer, as the next two.
        median: round-trip time [s].
        longest: round-trip time [s].
    """

    answers: int
    asked: int
    shortest: float
    median: float
    longest: float


def round_trip(bus: Bus, node: DiscoveredNode, times: int = TIMES) -> RoundTrip:
    """Measure the round-trip time of a node with one request at a time."""
    took = sorted(filter(None, (_once(bus, node) for _ in range(times))))
    if not took:
        return RoundTrip(0, times, *[float("nan")] * 3)
    return RoundTrip(len(took), times, took[0], took[len(took) // 2], took[-1])


def _once(bus: Bus, node: DiscoveredNode) -> float | None:
    """Return the time to the answer [s]. None if no answer arrives."""
    discovery = DISCOVERIES[node.protocol]
    bus.drain()  # a late reply to the request before must not count
    start = time.perf_counter()
    bus.send((discovery.ping(node),))
    while (passed := time.perf_counter() - start) < ANSWER_S:
        if any(discovery.is_pong(node, frame) for frame in bus.drain()):
            return time.perf_counter() - start
        time.sleep(0.0001 if passed < 0.01 else 0.002)  # fine at first, then sparing of the processor
    return None
