"""Comparison of the bit rates of an interface with the hand file. ``link`` reads the state of an interface."""

from handctl.runtime.buses.link import Link, MissingTool, read_link


def wrong_rate(channel: str, bitrate: int, data_bitrate: int | None) -> str:
    """Describe a wrong bit rate of an interface in one line. Empty if the rates are right or unknown.

    Args:
        channel: name of the interface.
        bitrate: of the hand file [bit/s].
        data_bitrate: of the hand file [bit/s]. None for a classical bus.
    """
    try:
        link = read_link(channel)
    except MissingTool:
        return ""
    return rate_difference(channel, link, bitrate, data_bitrate) if link else ""


def rate_difference(channel: str, link: Link, bitrate: int, data_bitrate: int | None) -> str:
    """Describe a wrong bit rate of ``link`` in one line. An interface without bit timing (vcan, slcan) has none."""
    if link.bitrate is None:
        return ""
    if link.bitrate != bitrate:
        return f"{channel} runs at {link.bitrate} bit/s, the hand file says {bitrate}"
    if data_bitrate is not None and link.data_bitrate != data_bitrate:
        runs = f"at {link.data_bitrate} bit/s" if link.data_bitrate else "without CAN FD"
        return f"{channel}'s data phase runs {runs}, the hand file says {data_bitrate} bit/s"
    return ""
