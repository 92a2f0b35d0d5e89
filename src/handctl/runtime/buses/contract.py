"""The interface of a CAN bus, which every kind of bus implements."""

from collections.abc import Callable, Sequence
from typing import Protocol

from handctl.drives.frame import FDF, Frame
from handctl.drives.records import Frames
from handctl.runtime.buses.events import Event

Stamp = Callable[[int], int]
"""Function from a CLOCK_MONOTONIC time [ns] to the run's time [ns], linear with a positive slope."""


class Bus(Protocol):
    """CAN bus with calls that never block and never raise for events on the wire."""

    @property
    def name(self) -> str:
        """Specification of the bus, also the ``where`` of the bus's events."""
        ...

    def drain(self) -> Frames:
        """Return all received frames, oldest first, with bus index and reception time."""
        ...

    def send(self, frames: Sequence[Frame]) -> int:
        """Send a batch and return the number of accepted frames, counted from the first.

        The remaining frames are dropped, because a command must not be sent late.

        Args:
            frames: frames to send. ``Frames`` objects (as from the loop) are sent directly, other
                sequences are converted first.

        Raises:
            ValueError: a payload is longer than its kind of frame can carry.
        """
        ...

    def take_events(self) -> list[Event]:
        """Return the events since the last call, see ``events``."""
        ...

    def fileno(self) -> int:
        """Return a file descriptor that becomes readable when a frame arrives, or -1 if the bus has none."""
        ...

    def close(self) -> None:
        """Close the bus."""
        ...


def check_size(frame: Frame) -> None:
    """Raise an error for a payload too long for its kind of frame.

    Raises:
        ValueError: the payload is longer than 8 bytes, or longer than 64 with CAN FD.
    """
    size = len(frame.data)
    if size > 64 or (size > 8 and not frame.flags & FDF):
        raise ValueError(f"payload of {size} bytes in frame {frame.can_id:#x}, expected at most 8, with CAN FD 64")
