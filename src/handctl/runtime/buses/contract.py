"""Interface that every kind of CAN bus implements."""

from collections.abc import Callable, Sequence
from typing import Protocol

from handctl.drives.frame import FDF, Frame
from handctl.drives.frame_records import Frames
from handctl.runtime.buses.bus_events import BusEvent

TimeConversion = Callable[[int], int]
"""Function that converts a CLOCK_MONOTONIC time [ns] to the run's time [ns].

The function is linear, with a positive slope.
"""


class Bus(Protocol):
    """CAN bus whose methods never block. No event on the wire of the bus makes a method raise an error."""

    @property
    def name(self) -> str:
        """Return the specification of the bus, such as ``local:demo``.

        The field ``where`` of each event of the bus contains the specification.
        """
        ...

    def drain(self) -> Frames:
        """Return the frames that were received since the last call, the oldest first.

        Each frame contains the index of the bus and the time of reception.
        """
        ...

    def send(self, frames: Sequence[Frame]) -> int:
        """Send a batch of frames.

        Return the number of accepted frames, which are the first frames of the batch. Frames that
        the bus does not accept are dropped, because a command must not be sent too late.

        Args:
            frames: frames to send. A ``Frames`` object, as the control loop uses, is sent directly.
                Any other sequence of frames is converted to ``Frames`` before it is sent.

        Raises:
            ValueError: a payload is longer than a frame of its kind can carry.
        """
        ...

    def take_events(self) -> list[BusEvent]:
        """Return the events of the bus that have occurred since the last call.

        The module ``bus_events`` explains the events of a bus.
        """
        ...

    def fileno(self) -> int:
        """Return a file descriptor that becomes readable when a frame arrives.

        If the bus has no file descriptor, return -1.
        """
        ...

    def close(self) -> None:
        """Close the bus."""
        ...


def check_payload_size(frame: Frame) -> None:
    """Raise an error if the payload of a frame is too long for the kind of the frame.

    Raises:
        ValueError: the payload is longer than 8 bytes in a classical frame, or longer than 64 bytes
            in a CAN FD frame.
    """
    size = len(frame.data)
    if size > 64 or (size > 8 and not frame.flags & FDF):
        raise ValueError(
            f"payload of {size} bytes in frame {frame.can_id:#x}, expected at most 8, with CAN FD 64"
        )
