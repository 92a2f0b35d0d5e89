"""The wall clock beside the monotonic one, every ten seconds: nothing uses it, but a step of it can be told later.

Only the recorder looks at these clocks, and not in a lockstep run, whose messages depend on nothing outside.
"""

import struct
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from handctl.log.cdr import CdrWriter
from handctl.log.container import Run
from handctl.log.topics.streams import Registry, Stamps, loose

TOPIC = "/clock_pairs"
PERIOD_NS = 10_000_000_000
STEP_NS = 50_000_000
"""A wall clock that is slewed gains at most 5 ms in ten seconds (adjtimex: 500 ppm); more than this was a step."""
_BODY = struct.Struct("<4xII8xqq")
"""Encapsulation, stamp, empty frame_id with padding, the two clocks."""


class ClockPair(NamedTuple):
    """Both clocks at one moment.

    Attributes:
        t_ns: of the tick before, since the start of the run [ns].
        wall_ns: UNIX time [ns].
        monotonic_ns: CLOCK_MONOTONIC [ns].
    """

    t_ns: int
    wall_ns: int
    monotonic_ns: int


class ClockStep(NamedTuple):
    """A jump of the wall clock between two pairs: when it had happened [s], and by how much [s]."""

    t_s: float
    step_s: float


class ClockTopic:
    """The topic of the pairs."""

    def __init__(self, registry: Registry) -> None:
        self._channel = registry.add(TOPIC, "handctl_msgs/ClockPair")

    def run(self, stamps: Stamps, wall_ns: int, monotonic_ns: int) -> Run:
        """One pair."""
        out = CdrWriter()
        t_ns = int(stamps.log[0])
        out.put("I", t_ns // 10**9)
        out.put("I", t_ns % 10**9)
        out.text("")
        out.put("q", wall_ns)
        out.put("q", monotonic_ns)
        return loose(self._channel, stamps, [out.message()])


def pair_of(message: bytes, offset_ns: int) -> ClockPair:
    """A pair out of its message.

    Raises:
        struct.error: it is too short.
    """
    seconds, nanoseconds, wall, monotonic = _BODY.unpack_from(message)
    return ClockPair(seconds * 10**9 + nanoseconds - offset_ns, wall, monotonic)


def steps(pairs: Iterable[ClockPair]) -> Iterator[ClockStep]:
    """Jumps of the wall clock against the monotonic one."""
    before: ClockPair | None = None
    for pair in pairs:
        if before is not None:
            jump = (pair.wall_ns - before.wall_ns) - (pair.monotonic_ns - before.monotonic_ns)
            if abs(jump) > STEP_NS:
                yield ClockStep(pair.t_ns * 1e-9, jump * 1e-9)
        before = pair
