"""Topic with readings of the wall clock and the monotonic clock.

The wall clock and the monotonic clock are read at the same moment, every ten seconds. The readings
of both clocks show whether the wall clock was set during the run. The recorder, and not the
controller, reads both clocks. The log of a lockstep run contains no readings of clocks. In a
lockstep run, every message of the log depends only on the ticks.
"""

import struct
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from handctl.log.cdr import CdrWriter
from handctl.log.mcap_container import MessageBlock
from handctl.log.topics.message_streams import MessageStamps, TopicRegistry, variable_length_block

CLOCK_PAIRS_TOPIC = "/clock_pairs"
CLOCK_PAIR_PERIOD_NS = 10_000_000_000
"""Time after which the recorder reads both clocks again [ns]."""
MIN_STEP_NS = 50_000_000
"""Smallest step of the wall clock that is reported [ns].

A gradual adjustment (slewing) shifts the wall clock by at most 5 ms in ten seconds (adjtimex: 500
ppm). Therefore a gradual adjustment of the wall clock is not reported.
"""
_CLOCK_PAIR_STRUCT = struct.Struct("<4xII8xqq")
"""Layout of a message: encapsulation, stamp, empty frame_id with padding, readings of both clocks."""


class ClockPair(NamedTuple):
    """Readings of the wall clock and the monotonic clock, taken at the same moment.

    Attributes:
        t_ns: time of the last tick before both clocks were read, since the start of the run [ns].
        wall_ns: reading of the wall clock as UNIX time [ns].
        monotonic_ns: reading of CLOCK_MONOTONIC [ns].
    """

    t_ns: int
    wall_ns: int
    monotonic_ns: int


class ClockStep(NamedTuple):
    """Step of the wall clock between two readings of both clocks.

    Attributes:
        t_s: time of the first reading after the step, since the start of the run [s].
        step_s: size of the step [s].
    """

    t_s: float
    step_s: float


class ClockTopic:
    """Topic with the readings of both clocks during a run."""

    def __init__(self, registry: TopicRegistry) -> None:
        """Register the topic."""
        self._channel = registry.register_topic(CLOCK_PAIRS_TOPIC, "handctl_msgs/ClockPair")

    def block(self, stamps: MessageStamps, wall_ns: int, monotonic_ns: int) -> MessageBlock:
        """Return the message with the readings of both clocks."""
        writer = CdrWriter()
        t_ns = int(stamps.log_times[0])
        writer.put_number("I", t_ns // 10**9)
        writer.put_number("I", t_ns % 10**9)
        writer.put_string("")
        writer.put_number("q", wall_ns)
        writer.put_number("q", monotonic_ns)
        return variable_length_block(self._channel, stamps, [writer.finished_message()])


def decode_clock_pair(message: bytes, offset_ns: int) -> ClockPair:
    """Decode a message with readings of the wall clock and the monotonic clock.

    Raises:
        struct.error: the message is too short.
    """
    seconds, nanoseconds, wall_ns, monotonic = _CLOCK_PAIR_STRUCT.unpack_from(message)
    return ClockPair(seconds * 10**9 + nanoseconds - offset_ns, wall_ns, monotonic)


def clock_steps(pairs: Iterable[ClockPair]) -> Iterator[ClockStep]:
    """Compare the wall clock with the monotonic clock, and yield each step of the wall clock."""
    previous_pair: ClockPair | None = None
    for pair in pairs:
        if previous_pair is not None:
            clock_jump_ns = (pair.wall_ns - previous_pair.wall_ns) - (
                pair.monotonic_ns - previous_pair.monotonic_ns
            )
            if abs(clock_jump_ns) > MIN_STEP_NS:
                yield ClockStep(pair.t_ns * 1e-9, clock_jump_ns * 1e-9)
        previous_pair = pair
