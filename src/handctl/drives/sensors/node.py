"""The sensor node: load cells and joint encoders, in frames of our own (``sensor_node.dbc``).

    SYNC   counter 8
    frame  counter 4 | channel 12 | channel 12 | channel 12 | channel 12 | channel 12

The host sends SYNC with a counter byte; the node samples at once and answers with the low four bits of that byte in
every frame, so that a stale frame cannot pass for a fresh one. Successive counters do not repeat with period 16: see
``counters``. Up to five channels of 12 bits a frame,
after a counter of four bits, packed from the lowest bit. Tension: 62.5 mN a count from -6 N. Joint angle: 1/4096
turn a count from -180 degrees; joint frames come on every SYNC whose counter is a multiple of ``joint_decimation``.
"""

import functools
import math
from dataclasses import dataclass, field
from typing import Protocol, Self

from handctl.drives.frame import Frame
from handctl.drives.signals import Message, Quantity, Signal

CHANNELS = 5
CHANNEL_BITS = 12
COUNTER_BITS = 4
SHIFTS = tuple(range(COUNTER_BITS, COUNTER_BITS + CHANNELS * CHANNEL_BITS, CHANNEL_BITS))
FULL = (1 << CHANNEL_BITS) - 1
TENSION_STEP_N = 0.0625
TENSION_ZERO_N = -6.0
TENSION_TOP_N = TENSION_ZERO_N + FULL * TENSION_STEP_N
"""Reading of a channel that is full, as zero is of one that is empty: the cell is saturated."""
LOW_MARGIN_N = 2.0
TARE_LEAST_N, TARE_MOST_N = TENSION_ZERO_N + LOW_MARGIN_N, 6.0
"""What a load cell may read without tension: lower, and noise takes it to the end of its range, so that a broken wire
looks like a loose rope; higher, and its range ends below what ``tension_rail`` says."""
TENSION_RAIL_N = TENSION_TOP_N - TARE_MOST_N
"""Tension, after any tare, from which on a load cell may be saturated."""
COUNTER_PERIOD, DISTINCT = 4096, 8
"""Ticks after which the counters of SYNC repeat, and among which the four bits of the answers are all different."""
JOINT_STEP_RAD = 2 * math.pi / 4096
JOINT_ZERO = 2048
JOINT_FRAMES = 0x10
"""Joint frames begin this far above the tension frames."""


class SensorDescription(Protocol):
    """What is needed of the hand file's section ``sensor_node``."""

    @property
    def sync_id(self) -> int: ...
    @property
    def base_id(self) -> int: ...
    @property
    def tendons(self) -> tuple[str, ...]: ...
    @property
    def joints(self) -> tuple[str, ...]: ...
    @property
    def joint_decimation(self) -> int: ...


@dataclass(frozen=True, slots=True)
class SensorNode:
    """The node as the host sees it; immutable.

    Attributes:
        bus: index of its bus.
        sync_id: identifier of SYNC.
        ids: identifier of each frame, tension frames first.
        channels: of each frame, the tendon or joint of each of its channels, in the hand's order.
        lengths: of each frame [bytes].
        tension_frames: how many of them carry tensions.
        frame_of: of each tendon of the hand, the tension frame that has its load cell; -1 without one.
        decimation: joint frames come on every such SYNC.
        counters: byte of SYNC by tick, repeated; follows from the decimation.
    """

    bus: int
    sync_id: int
    ids: tuple[int, ...]
    channels: tuple[tuple[int, ...], ...]
    lengths: tuple[int, ...]
    tension_frames: int
    frame_of: tuple[int, ...]
    decimation: int
    counters: bytes = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "counters", counters(self.decimation))

    @classmethod
    def of(cls, node: SensorDescription, bus: int, tendons: tuple[str, ...], joints: tuple[str, ...]) -> Self:
        """The node of a hand.

        Args:
            node: its description.
            bus: index of its bus.
            tendons, joints: all names of the hand, in order.
        """
        tension = _groups([tendons.index(name) for name in node.tendons])
        angle = _groups([joints.index(name) for name in node.joints])
        frame = {index: g for g, group in enumerate(tension) for index in group}
        ids = [node.base_id + g for g in range(len(tension))]
        ids += [node.base_id + JOINT_FRAMES + g for g in range(len(angle))]
        return cls(
            bus=bus,
            sync_id=node.sync_id,
            ids=tuple(ids),
            channels=(*tension, *angle),
            lengths=tuple(_length(len(group)) for group in tension + angle),
            tension_frames=len(tension),
            frame_of=tuple(frame.get(index, -1) for index in range(len(tendons))),
            decimation=node.joint_decimation,
        )

    @property
    def node_ids(self) -> frozenset[int]:
        """Identifiers that the node answers on."""
        return frozenset(self.ids)

    @property
    def host_ids(self) -> frozenset[int]:
        """Identifiers that only the host sends."""
        return frozenset((self.sync_id,))

    @property
    def tension_rail(self) -> float:
        """Tension, after any tare, from which on a load cell may be saturated [N]."""
        return TENSION_RAIL_N

    @property
    def tension_low(self) -> float:
        """Tared reading below which a cell or its wire is broken [N]: near the lower rail, far from any noise."""
        return TENSION_ZERO_N + LOW_MARGIN_N

    @property
    def exchange(self) -> tuple[tuple[int, float], ...]:
        """Frames of a tick as (payload bytes, how many a tick): SYNC, tension frames, and a share of joint frames."""
        rates = [1.0] * self.tension_frames + [1.0 / self.decimation] * (len(self.ids) - self.tension_frames)
        return ((1, 1.0), *zip(self.lengths, rates, strict=True))

    @property
    def messages(self) -> tuple[Message, ...]:
        """Its frames as tables of signals, in the order of ``ids``; a channel is the index of its tendon or joint."""
        found = []
        for g, (can_id, channels, length) in enumerate(zip(self.ids, self.channels, self.lengths, strict=True)):
            tensions = g < self.tension_frames
            signals = [Signal("counter", Quantity.COUNTER, 0, COUNTER_BITS)]
            signals += [_channel(place, index, tensions) for place, index in enumerate(channels)]
            name = f"tensions_{g}" if tensions else f"joints_{g - self.tension_frames}"
            found.append(Message(name, can_id, length, tuple(signals)))
        return tuple(found)

    def counter(self, k: int) -> int:
        """Return the counter byte of the SYNC of tick k; answers carry its low four bits."""
        return self.counters[k % len(self.counters)]

    def sync(self, k: int) -> Frame:
        """Return the SYNC of tick k."""
        return Frame(self.sync_id, bytes((self.counter(k),)), bus=self.bus)

    def lost(self, syncs: int, came: int, stale: int) -> int:
        """Return how many tension frames never came, those of the last SYNC aside, which may be on their way.

        Args:
            syncs: SYNCs sent. came: tension frames accepted. stale: frames that answered an older SYNC.
        """
        return max(0, (syncs - 1) * self.tension_frames - came - stale)

    def group_of_tendon(self, index: int) -> int:
        """Return the frame that carries a tendon's load cell; -1 without one."""
        return self.frame_of[index]

    def group_of_joint(self, index: int) -> int:
        """Return the frame that carries a joint's encoder; -1 without one."""
        groups = range(self.tension_frames, len(self.ids))
        return next((g for g in groups if index in self.channels[g]), -1)


def _channel(place: int, index: int, tension: bool) -> Signal:
    """Return one channel of a frame, at its place after the counter."""
    if tension:
        return Signal(f"tension_{place}", Quantity.TENSION, SHIFTS[place], CHANNEL_BITS, scale=TENSION_STEP_N,
                      offset=TENSION_ZERO_N, unit="N", channel=index)  # fmt: skip
    return Signal(f"angle_{place}", Quantity.ANGLE, SHIFTS[place], CHANNEL_BITS, scale=JOINT_STEP_RAD,
                  offset=-JOINT_ZERO * JOINT_STEP_RAD, unit="rad", channel=index)  # fmt: skip


@functools.lru_cache(maxsize=16)
def counters(decimation: int) -> bytes:
    """Return the counter byte of each SYNC of a period of about ``COUNTER_PERIOD`` ticks.

    Four bits that count up cannot tell a frame that is 16 or 32 ticks old from a fresh one. These do not count up: of
    two ticks less than ``DISTINCT`` apart the low four bits differ, and at any other distance they agree by chance. The
    remainder by ``decimation`` is that of the tick, since the node sends joint frames by it. From a decimation of 8 on
    the four bits have fewer than three values for a remainder, and the bits of near ticks may agree.
    """
    rows = [range(remainder, 256, decimation) for remainder in range(decimation)]
    by_nibble = [{byte & 0xF: byte for byte in row} for row in rows]
    chance, recent, made = 1, list[int](), bytearray()
    for k in range(COUNTER_PERIOD - COUNTER_PERIOD % decimation):
        chance = chance * 6364136223846793005 + 1442695040888963407 & 0xFFFF_FFFF_FFFF_FFFF  # Knuth's MMIX
        fit = sorted(by_nibble[k % decimation])
        for old in reversed(recent):  # the latest first
            if len(fit) > 2 and old in fit:
                fit.remove(old)
        nibble = fit[(chance >> 33) % len(fit)]
        made.append(by_nibble[k % decimation][nibble])
        recent = [*recent[2 - DISTINCT :], nibble]
    return bytes(made)


def _groups(channels: list[int]) -> list[tuple[int, ...]]:
    """Channels of each frame."""
    return [tuple(channels[first : first + CHANNELS]) for first in range(0, len(channels), CHANNELS)]


def _length(channels: int) -> int:
    """Payload of a frame [bytes]."""
    return math.ceil((COUNTER_BITS + CHANNEL_BITS * channels) / 8)
