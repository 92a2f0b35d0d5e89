"""Sensor node with load cells and joint encoders. handctl defines the frames of the node (``sensor_node.dbc``).

The host sends a SYNC frame with one byte, which is the counter. The sensor node answers SYNC with
frames of 2 to 8 bytes. The fields of an answer are little-endian, and packed from the lowest bit:

    bits    0..3       4..15       16..27      28..39      40..51      52..63
    field   counter    channel 0   channel 1   channel 2   channel 3   channel 4

    channel     count              range                 identifier
    tension     62.5 mN            -6 N to 249.9 N       base_id + 0, 1, ..
    angle       1/4096 turn        -180 to 179.9 deg     base_id + 0x10, 0x11, ..
    position    50 um              -102.4 to 102.35 mm   base_id + 0x10, 0x11, ..

The channel of a hinge joint contains an angle, and the channel of a prismatic joint contains a
position.

The sensor node measures all channels at SYNC. Every frame of an answer contains the low four bits
of the counter in SYNC, so that the host can distinguish an old frame from a fresh frame. The
counters of successive SYNC frames do not count up, see ``sync_counters``. The sensor node sends
angle frames after each SYNC whose counter is a multiple of ``joint_decimation``.
"""

import functools
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Protocol, Self

from handctl.drives.cia404.amplifier import LoadCellAmplifier
from handctl.drives.frame import Frame
from handctl.drives.signals import CyclicMessage, Signal, SignalQuantity

CHANNELS_PER_FRAME = 5
"""Number of channels in a frame of the sensor node."""
CHANNEL_BITS = 12
"""Number of bits of a channel in a frame."""
COUNTER_BITS = 4
"""Number of bits of the SYNC counter in an answer."""
CHANNEL_START_BITS = tuple(
    range(COUNTER_BITS, COUNTER_BITS + CHANNELS_PER_FRAME * CHANNEL_BITS, CHANNEL_BITS)
)
"""Number of the lowest bit of each channel in a frame."""
MAX_CHANNEL_COUNT = (1 << CHANNEL_BITS) - 1
"""Largest possible count of a channel."""
TENSION_STEP_N = 0.0625
"""Change of the tension per count [N]."""
TENSION_ZERO_N = -6.0
"""Tension at count 0 [N].

The tension at count 0 is negative, so that the reading of a slack tendon with its noise and bias is
in the range of the channel.
"""
TENSION_MAX_N = TENSION_ZERO_N + MAX_CHANNEL_COUNT * TENSION_STEP_N
"""Tension at the largest count [N].

A load cell whose channel has count 0 or the largest count is saturated.
"""
BROKEN_CELL_MARGIN_N = 2.0
"""Difference between the threshold for a broken load cell and the lower end of the measuring range [N]."""
# Smallest and largest reading of a load cell without tension that is accepted as a tare [N].
#
# With a tare below TARE_MIN_N, noise would reach the lower end of the measuring range, and a broken
# wire would look like a slack tendon. With a tare above TARE_MAX_N, the measuring range above the
# tare would end before ``tension_rail``.
TARE_MIN_N = TENSION_ZERO_N + BROKEN_CELL_MARGIN_N
TARE_MAX_N = 6.0
TENSION_RAIL_N = TENSION_MAX_N - TARE_MAX_N
"""Tared tension above which a load cell may be saturated, for any accepted tare [N]."""
# COUNTER_PERIOD is the number of ticks after which the SYNC counters repeat. In
# DISTINCT_COUNTER_TICKS consecutive ticks, all counters differ.
COUNTER_PERIOD = 4096
DISTINCT_COUNTER_TICKS = 8
JOINT_STEP_RAD = 2 * math.pi / 4096
"""Change of the joint angle per count [rad]."""
JOINT_STEP_M = 5e-5
"""Change of the position of a prismatic joint per count [m]."""
JOINT_ZERO_COUNT = 2048
"""Count of a joint channel at joint angle 0, and at position 0."""
NO_EARLIEST_ARRIVAL_NS = -(1 << 62)
"""Earliest arrival time of an answer [ns], for answers with a counter.

The counter in an answer alone decides if the answer is fresh.
"""
JOINT_FRAMES = 0x10
"""Identifier of the first angle frame minus the identifier of the first tension frame."""


class SensorDescription(Protocol):
    """Keys of the section ``sensor_node`` in the hand file, for a sensor node."""

    @property
    def sync_id(self) -> int:
        """Return the identifier of the SYNC frame."""
        ...

    @property
    def base_id(self) -> int:
        """Return the identifier of the first tension frame."""
        ...

    @property
    def tendons(self) -> tuple[str, ...]:
        """Return the names of the tendons that have a load cell."""
        ...

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the joints that have an encoder."""
        ...

    @property
    def joint_decimation(self) -> int:
        """Return the number of SYNC frames per answer with joint angles."""
        ...


@dataclass(frozen=True, slots=True)
class SensorNode:
    """Sensor node of a hand, with the interface ``contract.SensorInterface``. Objects are immutable.

    Attributes:
        bus: index of the bus of the node.
        sync_id: identifier of the SYNC frame.
        ids: identifier of each frame of the node. Frames with tensions come first.
        channels: indices of the tendons or joints in each frame of the node, as numbered in the
            hand.
        lengths: payload length of each frame of the node [bytes].
        tension_frames: number of frames with tensions.
        tendon_frame_indices: index of the frame with the load cell of each tendon of the hand, -1 for a tendon
            without a load cell.
        decimation: number of SYNC frames for each answer with joint angles.
        prismatic: indices of the prismatic joints of the hand.
        counters: counter bytes of the SYNC frames in successive ticks. The host repeats the
            sequence of counter bytes after its end.
    """

    bus: int
    sync_id: int
    ids: tuple[int, ...]
    channels: tuple[tuple[int, ...], ...]
    lengths: tuple[int, ...]
    tension_frames: int
    tendon_frame_indices: tuple[int, ...]
    decimation: int
    prismatic: frozenset[int] = frozenset()
    counters: bytes = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Compute the counter bytes of the SYNC frames from the decimation."""
        object.__setattr__(self, "counters", sync_counters(self.decimation))

    @classmethod
    def from_description(
        cls,
        node: SensorDescription,
        bus: int,
        tendons: tuple[str, ...],
        joints: tuple[str, ...],
        prismatic: Iterable[int] = (),
    ) -> Self:
        """Return the sensor node of a hand.

        Args:
            node: description of the node in the hand file.
            bus: index of the bus of the node.
            tendons: all tendon names of the hand, in order.
            joints: all joint names of the hand, in order.
            prismatic: indices of the prismatic joints of the hand.
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
            tendon_frame_indices=tuple(frame.get(index, -1) for index in range(len(tendons))),
            decimation=node.joint_decimation,
            prismatic=frozenset(prismatic),
        )

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifiers of answers from the node."""
        return frozenset(self.ids)

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers of frames from a host to the node."""
        return frozenset((self.sync_id,) if self.ids else ())

    @property
    def amplifiers(self) -> tuple[LoadCellAmplifier, ...]:
        """Return no amplifiers, because no amplifier of the node needs a set-up."""
        return ()

    @property
    def amplifier_frame_ranges(self) -> tuple[range, ...]:
        """Return no ranges of frames, because no amplifier of the node needs a set-up."""
        return ()

    @property
    def service_ids(self) -> frozenset[int]:
        """Return no identifiers of other frames, because the node sends only cyclic frames."""
        return frozenset()

    @property
    def cell_range(self) -> tuple[float, float]:
        """Return the tensions at the lowest and at the highest count of a channel [N].

        A load cell at the lowest or the highest count is saturated.
        """
        return TENSION_ZERO_N, TENSION_MAX_N

    @property
    def background_frames(self) -> tuple[tuple[int, float], ...]:
        """Return no background frames, because the node sends only answers to SYNC."""
        return ()

    @property
    def sync_message(self) -> CyclicMessage:
        """Return the signal table of the SYNC frame: a single byte with the counter."""
        return CyclicMessage(
            "sync", self.sync_id, 1, (Signal("counter", SignalQuantity.COUNTER, 0, 8),)
        )

    @property
    def has_counter(self) -> bool:
        """Return True, because every answer contains the counter of the SYNC that it answers."""
        return True

    def earliest_answer_time_ns(self, sync_ns: int) -> int:
        """Return ``NO_EARLIEST_ARRIVAL_NS``, because the counter in an answer identifies the SYNC."""
        return NO_EARLIEST_ARRIVAL_NS

    def answers(self, data: bytes, counter: int) -> bool:
        """Return True if the low four bits of the payload's first byte equal those of the SYNC counter."""
        return bool(data) and data[0] & 0xF == counter & 0xF

    @property
    def tension_rail(self) -> float:
        """Return the tared tension above which a load cell may be saturated [N].

        The threshold is valid for any accepted tare of the load cell.
        """
        return TENSION_RAIL_N

    @property
    def tension_low(self) -> float:
        """Return the tared tension below which a load cell or its wire counts as broken [N].

        The threshold is near the lower end of the load cell's range, so far below zero that noise
        cannot reach the threshold.
        """
        return TENSION_ZERO_N + BROKEN_CELL_MARGIN_N

    @property
    def frames_per_tick(self) -> tuple[tuple[int, float], ...]:
        """Return the frames that a tick exchanges with the node.

        Each kind of frame is given as a pair: payload length [bytes], and number of such frames per
        tick. The first pair belongs to SYNC. The node sends an angle frame once in ``decimation``
        ticks, so that the number of angle frames per tick can be below 1.
        """
        rates = [1.0] * self.tension_frames + [1.0 / self.decimation] * (
            len(self.ids) - self.tension_frames
        )
        return ((1, 1.0), *zip(self.lengths, rates, strict=True)) if self.ids else ()

    @property
    def messages(self) -> tuple[CyclicMessage, ...]:
        """Return the signal tables of the node's frames, in the order of ``ids``.

        ``Signal.channel`` is the index of the tendon or joint whose value the signal contains.
        """
        messages = []
        for g, (can_id, channels, length) in enumerate(
            zip(self.ids, self.channels, self.lengths, strict=True)
        ):
            tensions = g < self.tension_frames
            signals = [Signal("counter", SignalQuantity.COUNTER, 0, COUNTER_BITS)]
            signals += [
                _tension_signal(slot, index)
                if tensions
                else _joint_signal(slot, index, index in self.prismatic)
                for slot, index in enumerate(channels)
            ]
            name = f"tensions_{g}" if tensions else f"joints_{g - self.tension_frames}"
            messages.append(CyclicMessage(name, can_id, length, tuple(signals)))
        return tuple(messages)

    def counter(self, k: int) -> int:
        """Return the counter byte of the SYNC in tick k.

        Answers of the node contain the low four bits of the counter byte.
        """
        return self.counters[k % len(self.counters)]

    def sync(self, k: int) -> Frame:
        """Return the SYNC frame of tick k."""
        return Frame(self.sync_id, bytes((self.counter(k),)), bus=self.bus)

    def lost_frame_count(self, sync_count: int, accepted_count: int, stale_count: int) -> int:
        """Return the number of tension frames that the host has not received.

        Missing answers to the last SYNC are not counted, because these answers can still arrive.

        Args:
            sync_count: number of sent SYNC frames.
            accepted_count: number of accepted tension frames.
            stale_count: number of received tension frames that answered an older SYNC.
        """
        return max(0, (sync_count - 1) * self.tension_frames - accepted_count - stale_count)

    def group_of_tendon(self, tendon_index: int) -> int:
        """Return the index of the frame with a tendon's load-cell reading, or -1 if the tendon has no load cell."""
        return self.tendon_frame_indices[tendon_index]

    def group_of_joint(self, joint_index: int) -> int:
        """Return the index of the frame with a joint's encoder reading, or -1 if the joint has no encoder."""
        groups = range(self.tension_frames, len(self.ids))
        return next((g for g in groups if joint_index in self.channels[g]), -1)


def _tension_signal(slot: int, index: int) -> Signal:
    """Return the signal of a tendon in channel ``slot`` of a frame."""
    return Signal(f"tension_{slot}", SignalQuantity.TENSION, CHANNEL_START_BITS[slot], CHANNEL_BITS,
                      scale=TENSION_STEP_N, offset=TENSION_ZERO_N, unit="N", channel=index)  # fmt: skip


def _joint_signal(slot: int, index: int, is_prismatic: bool) -> Signal:
    """Return the signal of a joint in channel ``slot`` of a frame."""
    step, unit = (JOINT_STEP_M, "m") if is_prismatic else (JOINT_STEP_RAD, "rad")
    return Signal(f"angle_{slot}", SignalQuantity.ANGLE, CHANNEL_START_BITS[slot], CHANNEL_BITS,
                  scale=step, offset=-JOINT_ZERO_COUNT * step, unit=unit,
                  channel=index)  # fmt: skip


@functools.lru_cache(maxsize=16)
def sync_counters(decimation: int) -> bytes:
    """Return the counter bytes of the SYNC frames for about ``COUNTER_PERIOD`` ticks.

    A counter that counts up would repeat its low four bits after 16 ticks. An answer with an age of
    16 ticks would then seem fresh. The counters of handctl are therefore pseudo-random.

    The low four bits of two counters differ if the two ticks are less than
    ``DISTINCT_COUNTER_TICKS`` apart. At a larger distance, the low four bits are equal only by
    chance.

    The node sends angle frames if the counter is a multiple of ``decimation``. Therefore counter
    and tick have the same remainder modulo ``decimation``. If ``decimation`` is a multiple of 8,
    the remainder leaves at most two values for the low four bits. With such a ``decimation``, the
    low four bits can be equal for two ticks that are less than ``DISTINCT_COUNTER_TICKS`` apart.
    """
    counters_by_remainder = [range(remainder, 256, decimation) for remainder in range(decimation)]
    byte_by_nibble = [{byte & 0xF: byte for byte in row} for row in counters_by_remainder]
    random_state = 1
    recent_counters = list[int]()
    result = bytearray()
    for k in range(COUNTER_PERIOD - COUNTER_PERIOD % decimation):
        random_state = (
            random_state * 6364136223846793005 + 1442695040888963407 & 0xFFFF_FFFF_FFFF_FFFF
        )  # constants of Knuth's MMIX generator
        allowed_nibbles = sorted(byte_by_nibble[k % decimation])
        # The counter of the latest tick is the first excluded counter.
        for old_counter in reversed(recent_counters):
            if len(allowed_nibbles) > 2 and old_counter in allowed_nibbles:
                allowed_nibbles.remove(old_counter)
        # Only the high bits of a linear congruential generator are random.
        nibble = allowed_nibbles[(random_state >> 33) % len(allowed_nibbles)]
        result.append(byte_by_nibble[k % decimation][nibble])
        recent_counters = [*recent_counters[2 - DISTINCT_COUNTER_TICKS :], nibble]
    return bytes(result)


def _channel_groups(channels: list[int]) -> list[tuple[int, ...]]:
    """Return the channels in groups, one group for each frame."""
    return [
        tuple(channels[first_channel : first_channel + CHANNELS_PER_FRAME])
        for first_channel in range(0, len(channels), CHANNELS_PER_FRAME)
    ]


def _payload_length(channel_count: int) -> int:
    """Return the payload length of a frame with a number of channels [bytes]."""
    return math.ceil((COUNTER_BITS + CHANNEL_BITS * channel_count) / 8)
