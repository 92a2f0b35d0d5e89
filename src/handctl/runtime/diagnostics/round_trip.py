"""Round-trip time of a node: the time from the sending of a request to the arrival of the answer.

The request has no effect on the node.
"""

import math
import time
from typing import NamedTuple

from handctl.drives.discovery import DiscoveredNode
from handctl.drives.protocol_registry import DISCOVERY_BY_PROTOCOL
from handctl.runtime.buses.contract import Bus

REQUEST_COUNT = 20
"""Number of requests in a measurement."""
ANSWER_TIMEOUT_S = 0.1
"""Longest wait for an answer [s]."""
SECOND_ANSWER_WAIT_S = 0.005
"""Time for which a second answer is awaited after the first answer [s]."""


class RoundTrip(NamedTuple):
    """Result of a measurement of the round-trip time.

    Attributes:
        answers: number of requests with an answer.
        requests: number of requests sent.
        shortest_s: shortest round-trip time [s], NaN without an answer.
        median_s: median round-trip time [s], NaN without an answer.
        longest_s: longest round-trip time [s], NaN without an answer.
        double_answer_count: number of requests with more than one answer. Such answers show that two
            drives have the same node number.
    """

    answers: int
    requests: int
    shortest_s: float
    median_s: float
    longest_s: float
    double_answer_count: int = 0

    @property
    def is_node_number_shared(self) -> bool:
        """Return True if more than one answer arrived for most requests.

        Then two drives have the same node number.
        """
        return self.double_answer_count > self.requests / 2


def measure_round_trips(
    bus: Bus, node: DiscoveredNode, repetitions: int = REQUEST_COUNT
) -> RoundTrip:
    """Measure the round-trip time of a node.

    Each request is sent after the answer to the previous request has arrived.
    """
    trips = [_measure_round_trip(bus, node) for _ in range(repetitions)]
    took = sorted(first for first, _ in trips if first is not None)
    twice = sum(more for _, more in trips)
    if not took:
        return RoundTrip(0, repetitions, math.nan, math.nan, math.nan, twice)
    return RoundTrip(len(took), repetitions, took[0], took[len(took) // 2], took[-1], twice)


def _measure_round_trip(bus: Bus, node: DiscoveredNode) -> tuple[float | None, bool]:
    """Send a request to a node.

    Return the time until the answer arrives [s], and True if a second answer follows.

    If no answer arrives, the time is None.
    """
    discovery = DISCOVERY_BY_PROTOCOL[node.protocol]
    bus.drain()  # a late answer to the previous request must not count as an answer to this request
    start = time.perf_counter()
    bus.send((discovery.ping(node),))
    first = None
    answers = 0
    while (passed := time.perf_counter() - start) < (
        ANSWER_TIMEOUT_S if first is None else first + SECOND_ANSWER_WAIT_S
    ):
        answers += sum(discovery.is_ping_reply(node, frame) for frame in bus.drain())
        if answers and first is None:
            first = time.perf_counter() - start
        if answers > 1:
            break
        time.sleep(
            0.0001 if passed < 0.01 else 0.002
        )  # the first pauses are short for accuracy, and later pauses are longer to save processor time
    return first, answers > 1
