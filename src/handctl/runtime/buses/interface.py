"""Whether an interface runs at the bit rates of the hand file; see ``link`` for all else that is known of it."""

from handctl.runtime.buses.link import Link, NoTool, read_link


def wrong_rate(channel: str, bitrate: int, data_bitrate: int | None) -> str:
    """What is wrong with an interface's bit rates, in one line; empty if nothing is, or they cannot be known.

    Args:
        channel: name of the interface.
        bitrate, data_bitrate: what the hand file says [bit/s]; data None for a classical bus.
    """
    try:
        link = read_link(channel)
    except NoTool:
        return ""
    return compared(channel, link, bitrate, data_bitrate) if link else ""


def compared(channel: str, link: Link, bitrate: int, data_bitrate: int | None) -> str:
    """``wrong_rate`` with what was found; an interface without bit timing (vcan, slcan) runs at any."""
    if link.bitrate is None:
        return ""
    if link.bitrate != bitrate:
        return f"{channel} runs at {link.bitrate} bit/s, the hand file says {bitrate}"
    if data_bitrate is not None and link.data_bitrate != data_bitrate:
        runs = f"at {link.data_bitrate} bit/s" if link.data_bitrate else "without CAN FD"
        return f"{channel}'s data phase runs {runs}, the hand file says {data_bitrate} bit/s"
    return ""
