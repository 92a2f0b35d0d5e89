"""Interface of the sensors of a hand.

Each protocol of load cells implements the interface. The controller, the log and the tools use the
interface.
"""

from typing import Protocol

from handctl.drives.cia404.amplifier import LoadCellAmplifier
from handctl.drives.frame import Frame
from handctl.drives.signals import CyclicMessage


class SensorInterface(Protocol):
    """Load cells and joint encoders of a hand, all on one bus. Implementations are immutable.

    Attributes:
        bus: index of the bus of the sensors.
        sync_id: identifier of the SYNC frame, at which the sensors measure.
        ids: identifier of each cyclic frame from the sensors. Frames with tensions come first.
        channels: indices of the tendons or joints in each cyclic frame, as numbered in the hand.
        lengths: payload length of each cyclic frame [bytes].
        tension_frames: number of cyclic frames with tensions.
        amplifiers: measuring amplifiers that the host sets up, in the order of ``amplifier_frame_ranges``.
            The tuple is empty if no amplifier needs a set-up.
    """

    @property
    def bus(self) -> int:
        """Return the index of the bus of the sensors."""
        ...

    @property
    def sync_id(self) -> int:
        """Return the identifier of the SYNC frame, which makes the sensors take a sample."""
        ...

    @property
    def ids(self) -> tuple[int, ...]:
        """Return the identifier of each cyclic frame from the sensors.

        Frames with tensions come first.
        """
        ...

    @property
    def channels(self) -> tuple[tuple[int, ...], ...]:
        """Return the indices of the tendons or joints in each cyclic frame."""
        ...

    @property
    def lengths(self) -> tuple[int, ...]:
        """Return the payload length of each cyclic frame [bytes]."""
        ...

    @property
    def tension_frames(self) -> int:
        """Return the number of cyclic frames with tensions."""
        ...

    @property
    def amplifiers(self) -> tuple[LoadCellAmplifier, ...]:
        """Return the measuring amplifiers that the host must set up."""
        ...

    @property
    def amplifier_frame_ranges(self) -> tuple[range, ...]:
        """Return, for each measuring amplifier, the range of the indices of its frames in ``ids``."""
        ...

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifiers of all frames from the sensors."""
        ...

    @property
    def service_ids(self) -> frozenset[int]:
        """Return the identifiers of received frames that the state machines of the amplifiers must process."""
        ...

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers of frames from a host to the sensors."""
        ...

    @property
    def cell_range(self) -> tuple[float, float]:
        """Return the lowest and the highest reading of a load cell, without a tare [N].

        A load cell with the lowest or the highest reading is saturated.
        """
        ...

    @property
    def tension_rail(self) -> float:
        """Return the tared tension above which a load cell may be saturated [N].

        The threshold is valid for any accepted tare of the load cell.
        """
        ...

    @property
    def tension_low(self) -> float:
        """Return the tared tension below which a load cell or its wire counts as broken [N]."""
        ...

    @property
    def frames_per_tick(self) -> tuple[tuple[int, float], ...]:
        """Return the frames that a tick exchanges with the sensors.

        Each kind of frame is given as a pair: payload length [bytes], and number of such frames per
        tick. The first pair belongs to SYNC.
        """
        ...

    @property
    def background_frames(self) -> tuple[tuple[int, float], ...]:
        """Return the sensor frames whose rate is not the control rate, as (payload bytes, frames per second)."""
        ...

    @property
    def messages(self) -> tuple[CyclicMessage, ...]:
        """Return the signal tables of the cyclic frames, in the order of ``ids``."""
        ...

    @property
    def sync_message(self) -> CyclicMessage:
        """Return the signal table of the SYNC frame."""
        ...

    @property
    def has_counter(self) -> bool:
        """Return True if the answer to a SYNC contains the counter of the SYNC."""
        ...

    def counter(self, k: int) -> int:
        """Return the counter byte of the SYNC in tick k, or 0 if the SYNC has no counter."""
        ...

    def sync(self, k: int) -> Frame:
        """Return the SYNC frame of tick k."""
        ...

    def earliest_answer_time_ns(self, sync_ns: int) -> int:
        """Return the earliest time [ns] at which an answer to a SYNC sent after ``sync_ns`` can arrive."""
        ...

    def answers(self, data: bytes, counter: int) -> bool:
        """Return True if a payload can be the answer to the SYNC with the given counter."""
        ...

    def lost_frame_count(self, sync_count: int, accepted_count: int, stale_count: int) -> int:
        """Return the number of lost tension frames, see ``SensorNode.lost_frame_count``."""
        ...

    def group_of_tendon(self, tendon_index: int) -> int:
        """Return the index of the frame with the load cell of a tendon, or -1 without a load cell."""
        ...

    def group_of_joint(self, joint_index: int) -> int:
        """Return the index of the frame with the encoder of a joint, or -1 without an encoder."""
        ...
