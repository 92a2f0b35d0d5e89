"""Load cells on CiA 404 measuring amplifiers: the frames of every tick.

All identifiers are the base plus the node number n.

    frame    identifier                 to          bytes and fields
    SYNC     0x080                      amplifiers  -
    TPDO1    0x180 + n                  host        0..3 channel 1 | 4..7 channel 2
    TPDO2-4  0x280, 0x380, 0x480 + n    host        two further channels each

A channel is the process value as INTEGER32 (object 0x9130, with decimal digits) or REAL32 (object
0x6130), in newton, little-endian. A frame has no counter. A frame that arrives earlier than any
answer to the latest SYNC can arrive is stale. A later frame counts as fresh. Source:
docs/facts/cia404.md.
"""

from dataclasses import dataclass
from typing import Protocol

from handctl.drives.cia402 import codec
from handctl.drives.cia404.amplifier import Amplifier
from handctl.drives.cia404.settings import (
    CHANNEL_BYTES,
    CHANNELS_PER_TPDO,
    HEARTBEAT_MS,
    PROCESS_VALUES,
    TPDO_BASES,
    required_steps,
)
from handctl.drives.frame import Frame
from handctl.drives.signals import Coding, Message, Quantity, Signal

TARE_MARGIN_N = 6.0
"""Largest accepted tare of a load cell [N]."""
TENSION_LOW_N = -4.0
"""Tared tension below which a load cell or its wire counts as broken [N], as with the sensor node of handctl."""
SHORTEST_ANSWER_NS = 100_000
"""Shortest time from the start of a tick to the end of an answer to its SYNC [ns].

SYNC (47 bits) and a TPDO of 4 bytes (79 bits) take 126 us at 1 Mbit/s. The difference is a margin
for the time stamp.
"""


class AmplifierDescription(Protocol):
    """Keys of the section ``sensor_node`` in the hand file that this module uses."""

    @property
    def sync_id(self) -> int:
        """Return the identifier of SYNC."""
        ...

    @property
    def tendons(self) -> tuple[str, ...]:
        """Return the names of tendons with a load cell."""
        ...

    @property
    def node_ids(self) -> tuple[int, ...]:
        """Return the node numbers of the amplifiers."""
        ...

    @property
    def amplifier_channels(self) -> tuple[int, ...]:
        """Return the number of channels in use of each amplifier."""
        ...

    @property
    def range_N(self) -> float | None:  # noqa: N802 - the key of the file
        """Return the rated load of the load cells [N]."""
        ...

    @property
    def process_value(self) -> str:
        """Return ``int32`` or ``real32``."""
        ...

    @property
    def decimal_digits(self) -> int:
        """Return the decimal digits of an ``int32`` value."""
        ...


@dataclass(frozen=True, slots=True)
class Cia404LoadCells:
    """Load cells on CiA 404 amplifiers. Implements ``sensors.contract.Sensors``. Immutable.

    Attributes:
        bus: index of the bus.
        sync_id: identifier of SYNC.
        amplifiers: the amplifiers.
        group_ranges: indices of the frames of each amplifier.
        ids: identifier of each frame.
        channels: indices of the tendons in each frame, in the hand's order.
        frame_of: frame of each tendon of the hand, -1 without a load cell.
        range_n: rated load of the load cells [N].
        scale: tension of one count [N], 1 for a float.
        coding: coding of a channel.
    """

    bus: int
    sync_id: int
    amplifiers: tuple[Amplifier, ...]
    group_ranges: tuple[range, ...]
    ids: tuple[int, ...]
    channels: tuple[tuple[int, ...], ...]
    frame_of: tuple[int, ...]
    range_n: float
    scale: float
    coding: Coding

    @staticmethod
    def of(node: AmplifierDescription, bus: int, tendons: tuple[str, ...]) -> "Cia404LoadCells":
        """Return the load cells of a hand.

        Args:
            node: description of the amplifiers.
            bus: index of the bus.
            tendons: all tendon names of the hand, in order.
        """
        assert node.range_N is not None  # the checks of the hand file guarantee a value
        _, coding = PROCESS_VALUES[node.process_value]
        amplifiers, ranges, ids, channels = list[Amplifier](), list[range](), list[int](), list[tuple[int, ...]]()
        cells = [tendons.index(name) for name in node.tendons]
        for node_id, count in zip(node.node_ids, node.amplifier_channels, strict=True):
            own, cells = cells[:count], cells[count:]
            frames = [tuple(own[i : i + CHANNELS_PER_TPDO]) for i in range(0, count, CHANNELS_PER_TPDO)]
            tpdo_ids = tuple(base + node_id for base in TPDO_BASES[: len(frames)])
            steps = required_steps(node_id, count, node.process_value, node.decimal_digits)
            amplifiers.append(Amplifier(bus, node_id, tpdo_ids, steps))
            ranges.append(range(len(ids), len(ids) + len(frames)))
            ids += tpdo_ids
            channels += frames
        frame = {index: group for group, indices in enumerate(channels) for index in indices}
        return Cia404LoadCells(
            bus=bus,
            sync_id=node.sync_id,
            amplifiers=tuple(amplifiers),
            group_ranges=tuple(ranges),
            ids=tuple(ids),
            channels=tuple(channels),
            frame_of=tuple(frame.get(index, -1) for index in range(len(tendons))),
            range_n=node.range_N,
            scale=1.0 if coding == Coding.FLOAT else 10.0**-node.decimal_digits,
            coding=coding,
        )

    @property
    def lengths(self) -> tuple[int, ...]:
        """Return the payload length of each frame [bytes]."""
        return tuple(CHANNEL_BYTES * len(indices) for indices in self.channels)

    @property
    def tension_frames(self) -> int:
        """Return the number of frames, because all have tensions."""
        return len(self.ids)

    @property
    def service_ids(self) -> frozenset[int]:
        """Return the identifiers of SDO replies, emergencies and heartbeats."""
        return frozenset(can_id for one in self.amplifiers for can_id in one.service_ids)

    @property
    def node_ids(self) -> frozenset[int]:
        """Return all identifiers of the amplifiers' frames."""
        return frozenset(self.ids) | self.service_ids

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers sent only by the host: NMT, SYNC, and SDO requests."""
        requests = {codec.SDO_REQUEST + one.node_id for one in self.amplifiers}
        return frozenset(requests | {codec.NMT, self.sync_id} if self.amplifiers else ())

    @property
    def cell_range(self) -> tuple[float, float]:
        """Return the rated load of both signs [N].

        The codes for an overload are beyond this range: NaN, or -2^31 counts.
        """
        return -self.range_n, self.range_n

    @property
    def tension_rail(self) -> float:
        """Return the tared tension above which a load cell may be saturated, for any accepted tare [N]."""
        return self.range_n - TARE_MARGIN_N

    @property
    def tension_low(self) -> float:
        """Return the tared tension below which a load cell or its wire counts as broken [N]."""
        return TENSION_LOW_N

    @property
    def exchange(self) -> tuple[tuple[int, float], ...]:
        """Return the frames of a tick as (payload bytes, frames per tick): SYNC, and every TPDO."""
        return ((0, 1.0), *((length, 1.0) for length in self.lengths)) if self.ids else ()

    @property
    def background(self) -> tuple[tuple[int, float], ...]:
        """Return the heartbeats as (payload bytes, frames per second)."""
        return ((1, 1e3 / HEARTBEAT_MS),) * len(self.amplifiers)

    @property
    def messages(self) -> tuple[Message, ...]:
        """Return the signal tables of the frames. The channel of a signal is the index of its tendon."""
        messages = []
        for amplifier, groups in zip(self.amplifiers, self.group_ranges, strict=True):
            for tpdo, group in enumerate(groups):
                signals = [
                    Signal(f"tension_{slot}", Quantity.TENSION, 32 * slot, 32, False, self.coding, self.scale, 0.0, "N",
                           index)
                    for slot, index in enumerate(self.channels[group])
                ]  # fmt: skip
                name = f"amplifier_{amplifier.node_id:02x}_tpdo{tpdo + 1}"
                messages.append(Message(name, self.ids[group], self.lengths[group], tuple(signals)))
        return tuple(messages)

    @property
    def sync_message(self) -> Message:
        """Return the empty SYNC. A node without object 0x1019 expects no counter."""
        return Message("sync", self.sync_id, 0)

    @property
    def has_counter(self) -> bool:
        """Return False, because a process value does not identify its SYNC."""
        return False

    def counter(self, k: int) -> int:
        """Return 0, because SYNC has no counter."""
        return 0

    def sync(self, k: int) -> Frame:
        """Return the SYNC frame of tick k."""
        return Frame(self.sync_id, b"", bus=self.bus)

    def earliest_answer_ns(self, sync_ns: int) -> int:
        """Return the earliest arrival of an answer to a SYNC sent after ``sync_ns`` [ns]."""
        return sync_ns + SHORTEST_ANSWER_NS

    def answers(self, data: bytes, counter: int) -> bool:
        """Return True, because no payload identifies its SYNC."""
        return True

    def lost(self, syncs: int, accepted: int, stale: int) -> int:
        """Return how many frames are lost, except those of the last SYNC, which may still arrive."""
        return max(0, (syncs - 1) * len(self.ids) - accepted - stale)

    def group_of_tendon(self, index: int) -> int:
        """Return the index of the frame with a tendon's load cell, -1 without a load cell."""
        return self.frame_of[index]

    def group_of_joint(self, index: int) -> int:
        """Return -1, because the amplifiers have no joint encoders."""
        return -1
