"""What the loop asks of a CAN bus, and what every kind of bus is held to."""

from collections.abc import Callable, Sequence
from typing import Protocol

from handctl.drives.frame import FDF, Frame
from handctl.drives.records import Frames
from handctl.runtime.buses.events import Event

Stamp = Callable[[int], int]
"""Time of the run [ns] from a CLOCK_MONOTONIC time [ns], which it grows with at a constant rate."""


class Bus(Protocol):
    """One CAN bus that never blocks and never raises for what happens on the wire.

    Attributes:
        name: its specification, also the ``where`` of its events.
    """

    @property
    def name(self) -> str: ...

    def drain(self) -> Frames:
        """All frames that are there, oldest first, with bus index and time of reception."""
        ...

    def send(self, frames: Sequence[Frame]) -> int:
        """Send a batch; how many frames were accepted, from the first on. The rest is dropped, never kept for later.

        Args:
            frames: sent as they are if they are ``Frames``, as the loop's are. Frames of a tool are made records first.

        Raises:
            ValueError: a payload longer than its kind of frame can carry.
        """
        ...

    def take_events(self) -> list[Event]:
        """What happened since the last call; see ``events``."""
        ...

    def fileno(self) -> int:
        """File descriptor that turns readable with a frame; -1 if there is none."""
        ...

    def close(self) -> None:
        """Give the bus back."""
        ...


def check_size(frame: Frame) -> None:
    """Refuse a payload that its kind of frame cannot carry.

    Raises:
        ValueError: longer than 8 bytes, or with CAN FD than 64.
    """
    size = len(frame.data)
    if size > 64 or (size > 8 and not frame.flags & FDF):
        raise ValueError(f"payload of {size} bytes in frame {frame.can_id:#x}, expected at most 8, with CAN FD 64")
