"""Shell commands that set up a CAN interface for a hand, and checks of the bit rates of an interface.

The module ``link_state`` reads the state of a CAN interface.
"""

import shlex
import socket

from handctl.runtime.buses.canfd_structs import CANFD_FRAME_BYTES
from handctl.runtime.buses.link_state import CanLinkState, MissingTool, read_link

CommandWords = tuple[str, ...]
"""A shell command as a list of words."""
TX_QUEUE_FRAMES = 128
"""Length of the transmit queue that the set-up commands give to an interface [frames].

The Linux default of 10 frames is too short for the frames that a large hand sends in one tick.
"""
BUS_OFF_RESTART_MS = 100
"""Delay after which an interface restarts from the state bus-off [ms]."""


def interface_names() -> tuple[str, ...]:
    """Return the names of the network interfaces of this machine."""
    return tuple(name for _, name in socket.if_nameindex())


def interface_setup_commands(
    channel: str, bitrate: int, data_bitrate: int | None, interface_exists: bool
) -> tuple[CommandWords, ...]:
    """Return the shell commands that set up an interface for a hand.

    Only root can run the returned commands.

    Args:
        channel: name of the interface. If the name begins with ``vcan``, the interface is virtual.
        bitrate: bit rate in the hand file [bit/s].
        data_bitrate: bit rate of the data phase in the hand file [bit/s], or None for a classical
            bus.
        interface_exists: True if the interface exists. If a virtual interface does not exist, the
            returned commands add this interface.
    """
    link = ("ip", "link", "set", channel)
    queue = (*link, "txqueuelen", str(TX_QUEUE_FRAMES))
    up: CommandWords = (*link, "up")
    if channel.startswith("vcan"):
        add: CommandWords = ("ip", "link", "add", channel, "type", "vcan")
        first_command = (*link, "down") if interface_exists else add
        mtu_commands = ((*link, "mtu", str(CANFD_FRAME_BYTES)),) if data_bitrate else ()
        return (first_command, *mtu_commands, queue, up)
    timing_command: CommandWords = (*link, "type", "can", "bitrate", str(bitrate))
    if data_bitrate:
        timing_command = (*timing_command, "dbitrate", str(data_bitrate), "fd", "on")
    return ((*link, "down"), (*timing_command, "restart-ms", str(BUS_OFF_RESTART_MS)), queue, up)


def interface_setup_text(
    channel: str, bitrate: int, data_bitrate: int | None, interface_exists: bool
) -> str:
    """Return the commands of ``interface_setup_commands`` in one line, with ``sudo`` before each command.

    A user who is not root can run the returned line with the rights of ``sudo``.
    """
    commands = interface_setup_commands(channel, bitrate, data_bitrate, interface_exists)
    return " && ".join(f"sudo {shlex.join(command)}" for command in commands)


def wrong_bit_rate_text(channel: str, bitrate: int, data_bitrate: int | None) -> str:
    """Return a message if an interface has a wrong bit rate.

    If all bit rates of the interface are right or unknown, the message is empty.

    Args:
        channel: name of the interface.
        bitrate: bit rate in the hand file [bit/s].
        data_bitrate: bit rate of the data phase in the hand file [bit/s], or None for a classical
            bus.
    """
    try:
        link = read_link(channel)
    except MissingTool:
        return ""
    return bit_rate_mismatch_text(channel, link, bitrate, data_bitrate) if link else ""


def bit_rate_mismatch_text(
    channel: str, link: CanLinkState, bitrate: int, data_bitrate: int | None
) -> str:
    """Return a message if a bit rate in ``link`` is wrong.

    If the bit rates in ``link`` are right or unknown, the message is empty.
    """
    if link.bitrate is None:
        return ""
    if link.bitrate != bitrate:
        return f"{channel} has a bit rate of {link.bitrate} bit/s, the hand file asks for {bitrate} bit/s"
    if data_bitrate is not None and link.data_bitrate != data_bitrate:
        if not link.data_bitrate:
            return f"{channel} runs without CAN FD, but the hand file asks for a data bit rate of {data_bitrate} bit/s"
        rates = f"a data bit rate of {link.data_bitrate} bit/s, the hand file asks for {data_bitrate} bit/s"
        return f"{channel} has {rates}"
    return ""
