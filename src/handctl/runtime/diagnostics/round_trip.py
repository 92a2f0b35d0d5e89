"""Round-trip time of a node.

The round-trip time is the time from the sending of a request to the arrival of the answer. The
request has no effect on the node.
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
DUPLICATE_ANSWER_WAIT_S = 0.005
"""Time for which a second answer is awaited after the first answer [s]."""


class RoundTrip(NamedTuple):
    """Result of a measurement of the round-trip time.

    Attributes:
        answers: number of requests with an answer.
        requests: number of requests sent.
        shortest_s: shortest round-trip time [s], NaN without an answer.
        median_s: median round-trip time [s], NaN without an answer.
        longest_s: longest round-trip time [s], NaN without an answer.
        duplicate_answer_count: number of requests with more than one answer. Duplicate answers show
            that two drives have the same node number.
    """

    answers: int
    requests: int
    shortest_s: float
    median_s: float
    longest_s: float
    duplicate_answer_count: int = 0

    @property
    def is_node_number_shared(self) -> bool:
        """Return True if more than one answer arrived for most requests.

        If the result is True, two drives have the same node number.
        """
        return self.duplicate_answer_count > self.requests / 2


def measure_round_trips(
    bus: Bus, node: DiscoveredNode, repetitions: int = REQUEST_COUNT
) -> RoundTrip:
    """Measure the round-trip time of a node.

    Each request is sent after the answer to the previous request has arrived.
    """
    round_trips = [_measure_round_trip(bus, node) for _ in range(repetitions)]
    durations = sorted(
        first_duration for first_duration, _ in round_trips if first_duration is not None
    )
    duplicate_count = sum(extra_answers for _, extra_answers in round_trips)
    if not durations:
        return RoundTrip(0, repetitions, math.nan, math.nan, math.nan, duplicate_count)
    return RoundTrip(
        len(durations),
        repetitions,
        durations[0],
        durations[len(durations) // 2],
        durations[-1],
        duplicate_count,
    )


def _measure_round_trip(bus: Bus, node: DiscoveredNode) -> tuple[float | None, bool]:
    """Send a request to a node.

    Return the time until the answer arrives [s], and True if a second answer follows.

    If no answer arrives, the time is None.
    """
    discovery = DISCOVERY_BY_PROTOCOL[node.protocol]
    bus.drain()  # a late answer to the previous request must not count as an answer to the new request
    start_s = time.perf_counter()
    bus.send((discovery.ping(node),))
    first_answer_delay_s = None
    answer_count = 0
    while (elapsed_s := time.perf_counter() - start_s) < (
        ANSWER_TIMEOUT_S
        if first_answer_delay_s is None
        else first_answer_delay_s + DUPLICATE_ANSWER_WAIT_S
    ):
        answer_count += sum(discovery.is_ping_reply(node, frame) for frame in bus.drain())
        if answer_count and first_answer_delay_s is None:
            first_answer_delay_s = time.perf_counter() - start_s
        if answer_count > 1:
            break
        time.sleep(
            0.0001 if elapsed_s < 0.01 else 0.002
        )  # the first pauses are short for accuracy, and later pauses are longer to save processor time
    return first_answer_delay_s, answer_count > 1
