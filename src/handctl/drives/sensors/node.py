"""Sensor node: load cells and joint encoders, in frames defined by handctl (``sensor_node.dbc``).

SYNC, from the host, 1 byte: counter 8. Frames of the node, 2 to 8 bytes, little-endian, packed from
the lowest bit:

    bits    0..3       4..15       16..27      28..39      40..51      52..63
    field   counter    channel 0   channel 1   channel 2   channel 3   channel 4

    channel     count              range                 identifier
    tension     62.5 mN            -6 N to 249.9 N       base_id + 0, 1, ..
    angle       1/4096 turn        -180 to 179.9 deg     base_id + 0x10, 0x11, ..

The node samples at SYNC. Every frame of its answer contains the low four bits of the counter byte,
so that a stale frame does not count as fresh. Successive counters do not repeat with period
16, see ``sync_counters``. Angle frames follow every SYNC whose counter is a multiple of
``joint_decimation``.
"""

import functools
import math
from dataclasses import dataclass, field
from typing import Protocol, Self

from handctl.drives.cia404.amplifier import Amplifier
from handctl.drives.frame import Frame
from handctl.drives.signals import Message, Quantity, Signal

CHANNELS = 5
"""Number of channels in a frame."""
CHANNEL_BITS = 12
"""Number of bits of a channel."""
COUNTER_BITS = 4
"""Number of bits of the counter in an answer."""
CHANNEL_SHIFTS = tuple(range(COUNTER_BITS, COUNTER_BITS + CHANNELS * CHANNEL_BITS, CHANNEL_BITS))
"""Lowest bit of each channel."""
MAX_CHANNEL_COUNT = (1 << CHANNEL_BITS) - 1
"""Largest count of a channel."""
TENSION_STEP_N = 0.0625
"""Tension of one count [N]."""
TENSION_ZERO_N = -6.0
"""Tension of count 0 [N].

The value is negative, so that noise and bias of a slack tendon are in the range.
"""
TENSION_MAX_N = TENSION_ZERO_N + MAX_CHANNEL_COUNT * TENSION_STEP_N
"""Tension at the largest count [N]. At count 0 and at the largest count the load cell is saturated."""
LOW_MARGIN_N = 2.0
"""Distance from the lower end of the range to the threshold for a broken load cell [N]."""
# Smallest and largest valid reading of a load cell without tension [N].
#
# At a smaller reading, noise would reach the end of the range, and a broken wire would look like a slack
# tendon. At a larger reading, the range above the tare would end before ``tension_rail``.
TARE_MIN_N = TENSION_ZERO_N + LOW_MARGIN_N
TARE_MAX_N = 6.0
TENSION_RAIL_N = TENSION_MAX_N - TARE_MAX_N
"""Tared tension above which a load cell may be saturated, for any accepted tare [N]."""
# Ticks after which the SYNC counters repeat, and ticks in a row with distinct answers.
COUNTER_PERIOD = 4096
DISTINCT_COUNTERS = 8
JOINT_STEP_RAD = 2 * math.pi / 4096
"""Angle of one count [rad]."""
JOINT_ZERO = 2048
"""Count of angle 0."""
ANY_TIME = -(1 << 62)
"""Earliest arrival of an answer if its counter decides whether it is fresh [ns]."""
JOINT_FRAMES = 0x10
"""Offset from the first tension identifier to the first angle identifier."""


class SensorDescription(Protocol):
    """Keys of the section ``sensor_node`` in the hand file that this module uses."""

    @property
    def sync_id(self) -> int:
        """Return the identifier of SYNC."""
        ...

    @property
    def base_id(self) -> int:
        """Return the identifier of the first tension frame."""
        ...

    @property
    def tendons(self) -> tuple[str, ...]:
        """Return the names of tendons with a load cell."""
        ...

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of joints with an encoder."""
        ...

    @property
    def joint_decimation(self) -> int:
        """Return the number of SYNCs per angle frame."""
        ...


@dataclass(frozen=True, slots=True)
class SensorNode:
    """Sensor node as the host uses it. Immutable.

    Attributes:
        bus: index of the bus.
        sync_id: identifier of SYNC.
        ids: identifier of each frame, tension frames first.
        channels: indices of the tendons or joints in each frame, in the hand's order.
        lengths: payload length of each frame [bytes].
        tension_frames: number of tension frames.
        frame_of: tension frame of each tendon of the hand, -1 without a load cell.
        decimation: number of SYNCs per angle frame.
        counters: counter byte of SYNC in successive ticks, repeated from the start at the end.
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
        """Compute the counter bytes from the decimation."""
        object.__setattr__(self, "counters", sync_counters(self.decimation))

    @classmethod
    def of(cls, node: SensorDescription, bus: int, tendons: tuple[str, ...], joints: tuple[str, ...]) -> Self:
        """Return the sensor node of a hand.

        Args:
            node: description of the node.
            bus: index of the bus.
            tendons: all tendon names of the hand, in order.
            joints: all joint names of the hand, in order.
        """
        tension = _channel_groups([tendons.index(name) for name in node.tendons])
        angle = _channel_groups([joints.index(name) for name in node.joints])
        frame = {index: g for g, group in enumerate(tension) for index in group}
        ids = [node.base_id + g for g in range(len(tension))]
        ids += [node.base_id + JOINT_FRAMES + g for g in range(len(angle))]
        return cls(
            bus=bus,
            sync_id=node.sync_id,
            ids=tuple(ids),
            channels=(*tension, *angle),
            lengths=tuple(_payload_length(len(group)) for group in tension + angle),
            tension_frames=len(tension),
            frame_of=tuple(frame.get(index, -1) for index in range(len(tendons))),
            decimation=node.joint_decimation,
        )

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifiers of the node's answers."""
        return frozenset(self.ids)

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers sent only by the host."""
        return frozenset((self.sync_id,) if self.ids else ())

    @property
    def amplifiers(self) -> tuple[Amplifier, ...]:
        """Return an empty tuple, because the node needs no set-up."""
        return ()

    @property
    def group_ranges(self) -> tuple[range, ...]:
        """Return an empty tuple, because the node has no amplifiers."""
        return ()

    @property
    def service_ids(self) -> frozenset[int]:
        """Return an empty set, because the node has only cyclic frames."""
        return frozenset()

    @property
    def cell_range(self) -> tuple[float, float]:
        """Return the tensions of the lowest and the highest count, at which a load cell is saturated [N]."""
        return TENSION_ZERO_N, TENSION_MAX_N

    @property
    def background(self) -> tuple[tuple[int, float], ...]:
        """Return an empty tuple, because the node sends nothing but answers."""
        return ()

    @property
    def sync_message(self) -> Message:
        """Return the signal table of SYNC: one byte with the counter."""
        return Message("sync", self.sync_id, 1, (Signal("counter", Quantity.COUNTER, 0, 8),))

    @property
    def has_counter(self) -> bool:
        """Return True, because every frame has the counter of its SYNC."""
        return True

    def earliest_answer_ns(self, sync_ns: int) -> int:
        """Return ``ANY_TIME``, because the counter of an answer identifies its SYNC."""
        return ANY_TIME

    def answers(self, data: bytes, counter: int) -> bool:
        """Return True if the low four bits of the first byte repeat the counter of the SYNC."""
        return bool(data) and data[0] & 0xF == counter & 0xF

    @property
    def tension_rail(self) -> float:
        """Return the tared tension above which a load cell may be saturated, for any accepted tare [N]."""
        return TENSION_RAIL_N

    @property
    def tension_low(self) -> float:
        """Return the tared tension below which a load cell or its wire counts as broken [N].

        The threshold is near the lower end of the range of the load cell, so far below zero that
        noise cannot reach it.
        """
        return TENSION_ZERO_N + LOW_MARGIN_N

    @property
    def exchange(self) -> tuple[tuple[int, float], ...]:
        """Return the frames of a tick as (payload bytes, frames per tick).

        The number of an angle frame is the fraction of ticks in which the node sends it.
        """
        rates = [1.0] * self.tension_frames + [1.0 / self.decimation] * (len(self.ids) - self.tension_frames)
        return ((1, 1.0), *zip(self.lengths, rates, strict=True)) if self.ids else ()

    @property
    def messages(self) -> tuple[Message, ...]:
        """Return the signal tables of the frames, in the order of ``ids``.

        The channel of a signal is the index of its tendon or joint.
        """
        messages = []
        for g, (can_id, channels, length) in enumerate(zip(self.ids, self.channels, self.lengths, strict=True)):
            tensions = g < self.tension_frames
            signals = [Signal("counter", Quantity.COUNTER, 0, COUNTER_BITS)]
            signals += [_channel_signal(slot, index, tensions) for slot, index in enumerate(channels)]
            name = f"tensions_{g}" if tensions else f"joints_{g - self.tension_frames}"
            messages.append(Message(name, can_id, length, tuple(signals)))
        return tuple(messages)

    def counter(self, k: int) -> int:
        """Return the counter byte of the SYNC in tick k. Answers contain its low four bits."""
        return self.counters[k % len(self.counters)]

    def sync(self, k: int) -> Frame:
        """Return the SYNC frame of tick k."""
        return Frame(self.sync_id, bytes((self.counter(k),)), bus=self.bus)

    def lost(self, syncs: int, accepted: int, stale: int) -> int:
        """Return how many tension frames are lost.

        Frames of the last SYNC are excluded, since they may still arrive.

        Args:
            syncs: number of SYNCs sent.
            accepted: number of accepted tension frames.
            stale: number of frames that answered an older SYNC.
        """
        return max(0, (syncs - 1) * self.tension_frames - accepted - stale)

    def group_of_tendon(self, index: int) -> int:
        """Return the index of the frame with a tendon's load cell, -1 without a load cell."""
        return self.frame_of[index]

    def group_of_joint(self, index: int) -> int:
        """Return the index of the frame with a joint's encoder, -1 without an encoder."""
        groups = range(self.tension_frames, len(self.ids))
        return next((g for g in groups if index in self.channels[g]), -1)


def _channel_signal(slot: int, index: int, tension: bool) -> Signal:
    """Return the signal of one channel of a frame, at its position after the counter."""
    if tension:
        return Signal(f"tension_{slot}", Quantity.TENSION, CHANNEL_SHIFTS[slot], CHANNEL_BITS, scale=TENSION_STEP_N,
                      offset=TENSION_ZERO_N, unit="N", channel=index)  # fmt: skip
    return Signal(f"angle_{slot}", Quantity.ANGLE, CHANNEL_SHIFTS[slot], CHANNEL_BITS, scale=JOINT_STEP_RAD,
                  offset=-JOINT_ZERO * JOINT_STEP_RAD, unit="rad", channel=index)  # fmt: skip


@functools.lru_cache(maxsize=16)
def sync_counters(decimation: int) -> bytes:
    """Return the counter bytes of SYNC for a period of about ``COUNTER_PERIOD`` ticks.

    A counter of four bits that counts up has the same value 16 or 32 ticks later, so a frame of
    that age would seem fresh. These counters are pseudo-random instead. The low four bits of two
    ticks less than ``DISTINCT_COUNTERS`` apart differ. At larger distances they are equal only by
    chance. The counter modulo ``decimation`` equals the tick modulo ``decimation``, because the
    node sends angle frames by this remainder. With a decimation of 8 or more, fewer than three
    values of the four bits have the same remainder, so the bits of near ticks may be equal.
    """
    rows = [range(remainder, 256, decimation) for remainder in range(decimation)]
    by_nibble = [{byte & 0xF: byte for byte in row} for row in rows]
    chance = 1
    recent = list[int]()
    result = bytearray()
    for k in range(COUNTER_PERIOD - COUNTER_PERIOD % decimation):
        chance = chance * 6364136223846793005 + 1442695040888963407 & 0xFFFF_FFFF_FFFF_FFFF  # Knuth's MMIX
        fit = sorted(by_nibble[k % decimation])
        for old in reversed(recent):  # the latest first
            if len(fit) > 2 and old in fit:
                fit.remove(old)
        # The high bits of a linear congruential generator are the random ones.
        nibble = fit[(chance >> 33) % len(fit)]
        result.append(by_nibble[k % decimation][nibble])
        recent = [*recent[2 - DISTINCT_COUNTERS :], nibble]
    return bytes(result)


def _channel_groups(channels: list[int]) -> list[tuple[int, ...]]:
    """Return the channels grouped by frame."""
    return [tuple(channels[first : first + CHANNELS]) for first in range(0, len(channels), CHANNELS)]


def _payload_length(channels: int) -> int:
    """Return the payload length of a frame [bytes]."""
    return math.ceil((COUNTER_BITS + CHANNEL_BITS * channels) / 8)
