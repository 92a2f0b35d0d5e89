"""Opening of a CAN bus by its specification: ``local:NAME``, ``socketcan:can0``, or ``INTERFACE:CHANNEL``."""

import sys
from collections.abc import Sequence

from handctl.errors import ConfigError
from handctl.runtime.buses.contract import Bus, TimeConversion

LOCAL_BUS_PREFIX = "local:"
"""Prefix in the specification of a bus that a simulator on this machine serves."""
SIMULATED_PREFIXES = (
    LOCAL_BUS_PREFIX,
    "virtual:",
    "udp_multicast:",
    "socketcan:vcan",
    "socketcan:vxcan",
)
"""Prefixes in the specifications of buses that cannot have real motors.

On a simulated bus, scaling of the time of a run is allowed, and motion needs no confirmation by the
operator.
"""


def real_buses(specs: Sequence[str]) -> list[str]:
    """Select the specifications of those buses to which real motors may be connected, and return them."""
    return [spec for spec in specs if not spec.startswith(SIMULATED_PREFIXES)]


def _identity_conversion(t_ns: int) -> int:
    """Return an unchanged CLOCK_MONOTONIC time.

    A bus converts the reception time of each frame with a function. A run passes a function that
    converts CLOCK_MONOTONIC to the time of the run. A program that opens a bus outside of a run
    uses CLOCK_MONOTONIC times, and passes no conversion function. For such a program, the bus uses
    ``_identity_conversion``.
    """
    return t_ns


def check_bus_spec(spec: str) -> None:
    """Raise an error if a bus specification is invalid.

    Programs call this function before they open a bus.

    Raises:
        ConfigError: the kind or the channel is missing, or the name of a local bus contains a slash
            or begins with a dot.
    """
    kind, _, channel = spec.partition(":")
    if not kind or not channel or "=" in kind:
        expected = "local:NAME, socketcan:can0 or another python-can INTERFACE:CHANNEL"
        raise ConfigError("is not a bus", repr(spec), expected)
    if kind == "local" and ("/" in channel or channel.startswith(".")):
        raise ConfigError("is not a bus name", repr(spec), "a plain name, as in local:demo")


def open_bus(
    spec: str,
    index: int,
    bitrate: int,
    data_bitrate: int | None = None,
    convert_time: TimeConversion = _identity_conversion,
) -> Bus:
    """Open a bus.

    Args:
        spec: ``local:NAME`` (simulator on this machine), ``socketcan:NAME`` (Linux), or
            ``INTERFACE:CHANNEL`` of python-can.
        index: index of the bus in the hand's list, copied into every frame.
        bitrate: nominal bit rate [bit/s].
        data_bitrate: bit rate of the data phase of CAN FD [bit/s], or None for a classical bus.
        convert_time: function that converts a CLOCK_MONOTONIC time to the time of the run [ns].

    Raises:
        ConfigError: ``spec`` is not a valid bus specification.
        BusError: the bus cannot be opened. The error message contains a command or an advice that
            corrects the problem.
    """
    check_bus_spec(spec)
    kind, _, channel = spec.partition(":")
    if kind == "local":
        from handctl.runtime.buses.local_bus import LocalBus

        return LocalBus(channel, index, convert_time)
    if kind == "socketcan" and sys.platform == "linux":
        from handctl.runtime.buses.socketcan import open_socketcan

        return open_socketcan(channel, index, bitrate, data_bitrate, convert_time)
    from handctl.runtime.buses.pythoncan import PythonCanBus

    return PythonCanBus(kind, channel, index, bitrate, data_bitrate, convert_time)
