"""Load cells on CiA 404 measuring amplifiers.

The amplifiers and the host exchange the following frames in a tick. The identifier of a TPDO is the
sum of a base identifier and the node number n. The hyphen in the last column of the table means
that SYNC has no payload.

    frame    identifier                 to          bytes and fields
    SYNC     0x080                      amplifiers  -
    TPDO1    0x180 + n                  host        0..3 channel 1 | 4..7 channel 2
    TPDO2-4  0x280, 0x380, 0x480 + n    host        two further channels each

A channel of a TPDO contains the process value in newton, little-endian. The type of the process
value is INTEGER32 (object 0x9130, with decimal digits) or REAL32 (object 0x6130). A TPDO has no
counter, so only its arrival time shows which SYNC the TPDO answers. A TPDO is stale if it arrives
too early to be an answer to the latest SYNC. A TPDO counts as fresh if it is not stale. Source:
docs/facts/cia404.md.
"""

from dataclasses import dataclass
from typing import Protocol

from handctl.drives.canopen import codec
from handctl.drives.cia404.amplifier import LoadCellAmplifier
from handctl.drives.cia404.settings import (
    CHANNEL_BYTES,
    CHANNELS_PER_TPDO,
    HEARTBEAT_MS,
    PROCESS_VALUES,
    TPDO_BASES,
    required_steps,
)
from handctl.drives.frame import Frame
from handctl.drives.signals import CyclicMessage, Signal, SignalCoding, SignalQuantity

MAX_TARE_N = 6.0
"""Largest accepted tare of a load cell [N]."""
TENSION_LOW_N = -4.0
"""Tared tension below which a load cell or its wire counts as broken [N].

The sensor node of handctl uses the same threshold for a broken load cell.
"""
MIN_ANSWER_DELAY_NS = 100_000
"""Shortest time from the start of a tick to the end of an answer to its SYNC [ns].

SYNC (47 bits) and a TPDO of 4 bytes (79 bits) take 126 us at 1 Mbit/s. The constant is shorter than
126 us, as a margin for errors of the time stamp.
"""


class AmplifierDescription(Protocol):
    """Keys of the section ``sensor_node`` in the hand file, for load cells on CiA 404 amplifiers."""

    @property
    def sync_id(self) -> int:
        """Return the identifier of the SYNC frame to the amplifiers."""
        ...

    @property
    def tendons(self) -> tuple[str, ...]:
        """Return the names of the tendons that have a load cell."""
        ...

    @property
    def node_ids(self) -> tuple[int, ...]:
        """Return the node numbers of the amplifiers."""
        ...

    @property
    def amplifier_channels(self) -> tuple[int, ...]:
        """Return the number of channels with a load cell on each amplifier."""
        ...

    @property
    def range_N(self) -> float | None:  # noqa: N802 - the key of the file
        """Return the rated load of the load cells [N]."""
        ...

    @property
    def process_value(self) -> str:
        """Return the format of the process value in frames, ``int32`` or ``real32``."""
        ...

    @property
    def decimal_digits(self) -> int:
        """Return the number of decimal digits of an ``int32`` process value."""
        ...


@dataclass(frozen=True, slots=True)
class Cia404LoadCells:
    """Load cells on CiA 404 amplifiers, with the interface ``sensors.contract.SensorInterface``. Objects are immutable.

    Attributes:
        bus: index of the bus of the amplifiers.
        sync_id: identifier of the SYNC frame.
        amplifiers: measuring amplifiers for the host to set up.
        amplifier_frame_ranges: indices in ``ids`` of the frames from each amplifier.
        ids: identifier of each frame with tensions.
        channels: indices of the tendons in each frame with tensions, as numbered in the hand.
        tendon_frame_indices: index of the frame with the load cell of each tendon of the hand, -1 for a tendon
            without a load cell.
        range_n: rated load of the load cells [N].
        scale: change of the tension per count of the process value [N], 1 for ``real32``.
        coding: number format (integer or float) of each channel in a frame.
    """

    bus: int
    sync_id: int
    amplifiers: tuple[LoadCellAmplifier, ...]
    amplifier_frame_ranges: tuple[range, ...]
    ids: tuple[int, ...]
    channels: tuple[tuple[int, ...], ...]
    tendon_frame_indices: tuple[int, ...]
    range_n: float
    scale: float
    coding: SignalCoding

    @staticmethod
    def from_description(
        node: AmplifierDescription, bus: int, tendons: tuple[str, ...]
    ) -> "Cia404LoadCells":
        """Return the load cells of a hand.

        Args:
            node: description of the amplifiers in the hand file.
            bus: index of the bus of the amplifiers.
            tendons: all tendon names of the hand, in order.
        """
        assert node.range_N is not None  # checked with the hand file
        _, coding = PROCESS_VALUES[node.process_value]
        amplifiers, ranges, ids, channels = (
            list[LoadCellAmplifier](),
            list[range](),
            list[int](),
            list[tuple[int, ...]](),
        )
        cells = [tendons.index(name) for name in node.tendons]
        for node_id, count in zip(node.node_ids, node.amplifier_channels, strict=True):
            own_cells, cells = cells[:count], cells[count:]
            frames = [
                tuple(own_cells[i : i + CHANNELS_PER_TPDO])
                for i in range(0, count, CHANNELS_PER_TPDO)
            ]
            tpdo_ids = tuple(base + node_id for base in TPDO_BASES[: len(frames)])
            steps = required_steps(node_id, count, node.process_value, node.decimal_digits)
            amplifiers.append(LoadCellAmplifier(bus, node_id, tpdo_ids, steps))
            ranges.append(range(len(ids), len(ids) + len(frames)))
            ids += tpdo_ids
            channels += frames
        frame = {index: group for group, indices in enumerate(channels) for index in indices}
        return Cia404LoadCells(
            bus=bus,
            sync_id=node.sync_id,
            amplifiers=tuple(amplifiers),
            amplifier_frame_ranges=tuple(ranges),
            ids=tuple(ids),
            channels=tuple(channels),
            tendon_frame_indices=tuple(frame.get(index, -1) for index in range(len(tendons))),
            range_n=node.range_N,
            scale=1.0 if coding == SignalCoding.FLOAT else 10.0**-node.decimal_digits,
            coding=coding,
        )

    @property
    def lengths(self) -> tuple[int, ...]:
        """Return the payload length of each frame with tensions [bytes]."""
        return tuple(CHANNEL_BYTES * len(indices) for indices in self.channels)

    @property
    def tension_frames(self) -> int:
        """Return the number of cyclic frames from the amplifiers, because every cyclic frame contains tensions."""
        return len(self.ids)

    @property
    def service_ids(self) -> frozenset[int]:
        """Return the identifiers of the amplifiers' SDO replies, emergencies and heartbeats."""
        return frozenset(
            can_id for amplifier in self.amplifiers for can_id in amplifier.service_ids
        )

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifiers of all frames from the amplifiers."""
        return frozenset(self.ids) | self.service_ids

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers of frames that only a host sends: NMT, SYNC, and SDO requests."""
        requests = {codec.SDO_REQUEST + amplifier.node_id for amplifier in self.amplifiers}
        return frozenset(requests | {codec.NMT, self.sync_id} if self.amplifiers else ())

    @property
    def cell_range(self) -> tuple[float, float]:
        """Return the limits of the range: the negative and the positive rated load of the load cells [N].

        If a load cell is overloaded, the amplifier of the load cell sends NaN or -2^31 counts. NaN
        and -2^31 counts are outside the range of the load cells.
        """
        return -self.range_n, self.range_n

    @property
    def tension_rail(self) -> float:
        """Return the tared tension above which a load cell may be saturated [N].

        The threshold is the rated load minus the largest accepted tare.
        """
        return self.range_n - MAX_TARE_N

    @property
    def tension_low(self) -> float:
        """Return the tared tension below which a load cell or its wire counts as broken [N]."""
        return TENSION_LOW_N

    @property
    def frames_per_tick(self) -> tuple[tuple[int, float], ...]:
        """Return the frames of a tick, SYNC and then every TPDO, as (payload bytes, frames per tick)."""
        return ((0, 1.0), *((length, 1.0) for length in self.lengths)) if self.ids else ()

    @property
    def background_frames(self) -> tuple[tuple[int, float], ...]:
        """Return the heartbeats of the amplifiers as (payload bytes, frames per second)."""
        return ((1, 1e3 / HEARTBEAT_MS),) * len(self.amplifiers)

    @property
    def messages(self) -> tuple[CyclicMessage, ...]:
        """Return the signal tables of the frames with tensions.

        ``Signal.channel`` is the index of the tendon whose tension the signal contains.
        """
        messages = []
        for amplifier, groups in zip(self.amplifiers, self.amplifier_frame_ranges, strict=True):
            for tpdo, group in enumerate(groups):
                signals = [
                    Signal(f"tension_{slot}", SignalQuantity.TENSION, 32 * slot, 32, False, self.coding, self.scale,
                           0.0, "N", index)
                    for slot, index in enumerate(self.channels[group])
                ]  # fmt: skip
                name = f"amplifier_{amplifier.node_id:02x}_tpdo{tpdo + 1}"
                messages.append(
                    CyclicMessage(name, self.ids[group], self.lengths[group], tuple(signals))
                )
        return tuple(messages)

    @property
    def sync_message(self) -> CyclicMessage:
        """Return the signal table of SYNC, which has no counter.

        An amplifier without object 0x1019 expects no counter in SYNC.
        """
        return CyclicMessage("sync", self.sync_id, 0)

    @property
    def has_counter(self) -> bool:
        """Return False, because a frame from an amplifier does not contain the counter of the SYNC."""
        return False

    def counter(self, k: int) -> int:
        """Return the counter byte 0, because the SYNC to an amplifier has no counter."""
        return 0

    def sync(self, k: int) -> Frame:
        """Return the SYNC frame of tick k."""
        return Frame(self.sync_id, b"", bus=self.bus)

    def earliest_answer_time_ns(self, sync_ns: int) -> int:
        """Return the earliest time [ns] at which an answer to a SYNC sent after ``sync_ns`` can arrive."""
        return sync_ns + MIN_ANSWER_DELAY_NS

    def answers(self, data: bytes, counter: int) -> bool:
        """Return True for every payload, because no payload of a TPDO shows which SYNC the TPDO answers."""
        return True

    def lost_frame_count(self, sync_count: int, accepted_count: int, stale_count: int) -> int:
        """Return the number of lost frames with tensions.

        Missing answers to the last SYNC are not counted, because these answers can still arrive.
        """
        return max(0, (sync_count - 1) * len(self.ids) - accepted_count - stale_count)

    def group_of_tendon(self, tendon_index: int) -> int:
        """Return the index of the frame with the load cell of a tendon, or -1 without a load cell."""
        return self.tendon_frame_indices[tendon_index]

    def group_of_joint(self, joint_index: int) -> int:
        """Return the frame index -1, because the amplifiers have no joint encoders."""
        return -1
