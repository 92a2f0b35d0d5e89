"""Contract of the sensors of a hand: functions that controller, log and tools use of each protocol of load cells."""

from typing import Protocol

from handctl.drives.cia404.amplifier import Amplifier
from handctl.drives.frame import Frame
from handctl.drives.signals import Message


class Sensors(Protocol):
    """Load cells and joint encoders of a hand, all on one bus. Implementations are immutable.

    Attributes:
        bus: index of the bus.
        sync_id: identifier of SYNC.
        ids: identifier of each cyclic frame, tension frames first.
        channels: indices of the tendons or joints in each frame, in the hand's order.
        lengths: payload length of each frame [bytes].
        tension_frames: number of tension frames.
        amplifiers: amplifiers that need a set-up, in the order of ``group_ranges``. Empty without
            one.
    """

    @property
    def bus(self) -> int:
        """Return the index of the bus."""
        ...

    @property
    def sync_id(self) -> int:
        """Return the identifier of SYNC."""
        ...

    @property
    def ids(self) -> tuple[int, ...]:
        """Return the identifier of each cyclic frame, tension frames first."""
        ...

    @property
    def channels(self) -> tuple[tuple[int, ...], ...]:
        """Return the indices of the tendons or joints in each frame."""
        ...

    @property
    def lengths(self) -> tuple[int, ...]:
        """Return the payload length of each frame [bytes]."""
        ...

    @property
    def tension_frames(self) -> int:
        """Return the number of tension frames."""
        ...

    @property
    def amplifiers(self) -> tuple[Amplifier, ...]:
        """Return the amplifiers that need a set-up."""
        ...

    @property
    def group_ranges(self) -> tuple[range, ...]:
        """Return the indices of the frames of each amplifier."""
        ...

    @property
    def node_ids(self) -> frozenset[int]:
        """Return all identifiers of the sensors' frames."""
        ...

    @property
    def service_ids(self) -> frozenset[int]:
        """Return the identifiers of frames for the state machines of amplifiers."""
        ...

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers sent only by the host."""
        ...

    @property
    def cell_range(self) -> tuple[float, float]:
        """Return the readings before the tare at which a load cell is saturated, lower and upper [N]."""
        ...

    @property
    def tension_rail(self) -> float:
        """Return the tared tension above which a load cell may be saturated, for any accepted tare [N]."""
        ...

    @property
    def tension_low(self) -> float:
        """Return the tared tension below which a load cell or its wire counts as broken [N]."""
        ...

    @property
    def exchange(self) -> tuple[tuple[int, float], ...]:
        """Return the frames of a tick, SYNC first, as (payload bytes, frames per tick)."""
        ...

    @property
    def background(self) -> tuple[tuple[int, float], ...]:
        """Return the periodic frames as (payload bytes, frames per second)."""
        ...

    @property
    def messages(self) -> tuple[Message, ...]:
        """Return the signal tables of the frames, in the order of ``ids``."""
        ...

    @property
    def sync_message(self) -> Message:
        """Return the signal table of SYNC."""
        ...

    @property
    def has_counter(self) -> bool:
        """Return True if an answer contains the counter of its SYNC."""
        ...

    def counter(self, k: int) -> int:
        """Return the counter byte of the SYNC in tick k, 0 without a counter."""
        ...

    def sync(self, k: int) -> Frame:
        """Return the SYNC frame of tick k."""
        ...

    def earliest_answer_ns(self, sync_ns: int) -> int:
        """Return the earliest arrival of an answer to a SYNC sent after ``sync_ns`` [ns]."""
        ...

    def answers(self, data: bytes, counter: int) -> bool:
        """Return True if a payload can be the answer to the SYNC with this counter."""
        ...

    def lost(self, syncs: int, accepted: int, stale: int) -> int:
        """Return how many tension frames are lost."""
        ...

    def group_of_tendon(self, index: int) -> int:
        """Return the index of the frame with a tendon's load cell, -1 without a load cell."""
        ...

    def group_of_joint(self, index: int) -> int:
        """Return the index of the frame with a joint's encoder, -1 without an encoder."""
        ...
