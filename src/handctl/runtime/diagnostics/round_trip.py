"""How long a node takes to answer: from the call that sends a harmless question to the answer in our hands."""

import time
from typing import NamedTuple

from handctl.drives.discovery import Found
from handctl.drives.registry import DISCOVERIES
from handctl.runtime.buses.contract import Bus

TIMES, PATIENCE_S = 20, 0.1


class RoundTrip(NamedTuple):
    """Answers to so many questions; shortest, median and longest time [s], NaN without an answer."""

    answers: int
    asked: int
    shortest: float
    median: float
    longest: float


def round_trip(bus: Bus, node: Found, times: int = TIMES) -> RoundTrip:
    """Ask a node again and again, one question at a time."""
    took = sorted(filter(None, (_once(bus, node) for _ in range(times))))
    if not took:
        return RoundTrip(0, times, *[float("nan")] * 3)
    return RoundTrip(len(took), times, took[0], took[len(took) // 2], took[-1])


def _once(bus: Bus, node: Found) -> float | None:
    """Seconds to the answer; None if it does not come."""
    discovery = DISCOVERIES[node.protocol]
    bus.drain()
    begin = time.perf_counter()
    bus.send((discovery.ping(node),))
    while (passed := time.perf_counter() - begin) < PATIENCE_S:
        if any(discovery.pong(node, frame) for frame in bus.drain()):
            return time.perf_counter() - begin
        time.sleep(0.0001 if passed < 0.01 else 0.002)
    return None
