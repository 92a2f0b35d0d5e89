"""A bus as the loop sees it, and how to open one: ``local:NAME``, ``socketcan:can0``, ``INTERFACE:CHANNEL``."""

import sys
from collections.abc import Callable, Sequence
from typing import Protocol

from handctl.drives.frame import FDF, Frame
from handctl.errors import ConfigError
from handctl.runtime.bus_events import Event

Stamp = Callable[[int], int]
"""Time of the run [ns] from a CLOCK_MONOTONIC time [ns]."""


SIMULATED = ("local:", "virtual:", "udp_multicast:", "socketcan:vcan", "socketcan:vxcan")
"""Buses on which there are no real motors: time may run otherwise there, and nobody is asked before a hand moves."""


def real_buses(specs: Sequence[str]) -> list[str]:
    """Return the buses that may have real motors."""
    return [spec for spec in specs if not spec.startswith(SIMULATED)]


class Bus(Protocol):
    """One CAN bus that never blocks and never raises for what happens on the wire.

    Attributes:
        name: its specification, also the ``where`` of its events.
    """

    @property
    def name(self) -> str: ...

    def drain(self) -> list[Frame]:
        """All frames that are there, oldest first, with bus index and time of reception."""
        ...

    def send(self, frames: Sequence[Frame]) -> int:
        """Send a batch; how many frames were accepted, from the first on. The rest is dropped, never kept for later.

        Raises:
            ValueError: a payload longer than its kind of frame can carry.
        """
        ...

    def take_events(self) -> list[Event]:
        """What happened since the last call; see ``bus_events``."""
        ...

    def fileno(self) -> int:
        """File descriptor that turns readable with a frame; -1 if there is none."""
        ...

    def close(self) -> None:
        """Give the bus back."""
        ...


def _monotonic(t_ns: int) -> int:
    return t_ns


def check_spec(spec: str) -> None:
    """Refuse what no bus can be called, before anything is opened.

    Raises:
        ConfigError: no kind, no channel, or a local bus whose name is no plain one.
    """
    kind, _, channel = spec.partition(":")
    if not kind or not channel or "=" in kind:
        raise ConfigError("is no bus", repr(spec), "local:NAME, socketcan:can0 or another python-can INTERFACE:CHANNEL")
    if kind == "local" and ("/" in channel or channel.startswith(".")):
        raise ConfigError("is no name of a bus", repr(spec), "a plain name, as in local:demo")


def open_bus(spec: str, index: int, bitrate: int, data_bitrate: int | None = None, stamp: Stamp = _monotonic) -> Bus:
    """Open a bus.

    Args:
        spec: ``local:NAME`` (simulator on this machine), ``socketcan:NAME`` (Linux), or any other python-can
            ``INTERFACE:CHANNEL``.
        index: of the bus in the hand's list; every frame carries it.
        bitrate: nominal [bit/s].
        data_bitrate: of CAN FD's data phase [bit/s]; None for a classical bus.
        stamp: makes the run's time of a CLOCK_MONOTONIC time.

    Raises:
        ConfigError: that is no specification.
        BusError: it cannot be opened; the line says what to type.
    """
    check_spec(spec)
    kind, _, channel = spec.partition(":")
    if kind == "local":
        from handctl.runtime.local import LocalBus

        return LocalBus(channel, index, stamp)
    if kind == "socketcan" and sys.platform == "linux":
        from handctl.runtime.socketcan import open_socketcan

        return open_socketcan(channel, index, bitrate, data_bitrate, stamp)
    from handctl.runtime.pythoncan import PythonCanBus

    return PythonCanBus(kind, channel, index, bitrate, data_bitrate, stamp)


def check_size(frame: Frame) -> None:
    """Refuse a payload that its kind of frame cannot carry.

    Raises:
        ValueError: longer than 8 bytes, or with CAN FD than 64.
    """
    size = len(frame.data)
    if size > 64 or (size > 8 and not frame.flags & FDF):
        raise ValueError(f"payload of {size} bytes in frame {frame.can_id:#x}, expected at most 8, with CAN FD 64")
