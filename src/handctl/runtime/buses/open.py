"""How a bus is named and opened: ``local:NAME``, ``socketcan:can0``, ``INTERFACE:CHANNEL``."""

import sys
from collections.abc import Sequence

from handctl.errors import ConfigError
from handctl.runtime.buses.contract import Bus, Stamp

SIMULATED = ("local:", "virtual:", "udp_multicast:", "socketcan:vcan", "socketcan:vxcan")
"""Buses on which there are no real motors: time may run otherwise there, and nobody is asked before a hand moves."""


def real_buses(specs: Sequence[str]) -> list[str]:
    """Return the buses that may have real motors."""
    return [spec for spec in specs if not spec.startswith(SIMULATED)]


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
        from handctl.runtime.buses.local import LocalBus

        return LocalBus(channel, index, stamp)
    if kind == "socketcan" and sys.platform == "linux":
        from handctl.runtime.buses.socketcan import open_socketcan

        return open_socketcan(channel, index, bitrate, data_bitrate, stamp)
    from handctl.runtime.buses.pythoncan import PythonCanBus

    return PythonCanBus(kind, channel, index, bitrate, data_bitrate, stamp)
