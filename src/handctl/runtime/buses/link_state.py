"""State of a Linux CAN interface, from the output of ``ip -details -statistics -json link show``.

Source: iproute2, iplink_can.c.
"""

import json
import subprocess
from collections.abc import Mapping
from typing import Any, NamedTuple

from handctl.runtime.buses.canfd_structs import CANFD_FRAME_BYTES

IP_TOOL_TIMEOUT_S = 5.0
"""Longest wait for the program ``ip`` to answer [s]."""


class CanLinkState(NamedTuple):
    """State of a CAN interface.

    Attributes:
        is_up: True if the interface is up.
        kind: kind of the interface, for example ``can`` or ``vcan``.
        tx_queue_frames: length of the transmit queue (txqueuelen) [frames].
        is_fd: True if the interface can carry CAN FD frames.
        bitrate: nominal bit rate [bit/s], or None for an interface without bit timing, such as
            vcan.
        data_bitrate: bit rate of the data phase of CAN FD [bit/s], or None for an interface without
            a data phase.
        controller_state: state of the CAN controller, such as ``ERROR-ACTIVE``, or an empty text
            without a CAN controller.
        tx_error_counter: transmit error counter of the CAN controller.
        rx_error_counter: receive error counter of the CAN controller.
        restart_ms: delay after which the interface restarts from bus-off [ms]. The delay is 0 if a
            person must restart the interface, and None if there is no CAN controller.
        event_counts: number of events since the interface was created, by kind: bus_error, error_passive,
            bus_off, tx_dropped, ...
    """

    is_up: bool
    kind: str
    tx_queue_frames: int
    is_fd: bool
    bitrate: int | None
    data_bitrate: int | None
    controller_state: str
    tx_error_counter: int
    rx_error_counter: int
    restart_ms: int | None
    event_counts: Mapping[str, int]


class MissingTool(Exception):  # noqa: N818 - tells that a program is missing
    """Raised if the program ``ip`` is not installed or does not answer in time."""


def read_link(name: str) -> CanLinkState | None:
    """Return the state of an interface, or None if the interface does not exist.

    Raises:
        MissingTool: the program ``ip`` of iproute2 is not installed, or does not answer in time.
    """
    command = ["ip", "-details", "-statistics", "-json", "link", "show", "dev", name]
    try:
        output = subprocess.run(
            command, capture_output=True, text=True, timeout=IP_TOOL_TIMEOUT_S, check=False
        )
    except (FileNotFoundError, subprocess.TimeoutExpired):
        raise MissingTool from None
    return parse_link(output.stdout) if output.returncode == 0 else None


def parse_link(json_text: str) -> CanLinkState | None:
    """Return the state of the interface in the output of ``ip``, or None if the output lists no interface."""
    try:
        (link,) = json.loads(json_text)
    except ValueError:
        return None
    info: dict[str, Any] = link.get("linkinfo", {})
    data: dict[str, Any] = info.get("info_data", {})
    counters = data.get("berr_counter", {})
    return CanLinkState(
        is_up="UP" in link.get("flags", ()),
        kind=str(info.get("info_kind", "")),
        tx_queue_frames=int(link.get("txqlen", 0)),
        is_fd=int(link.get("mtu", 0)) >= CANFD_FRAME_BYTES,
        bitrate=data.get("bittiming", {}).get("bitrate"),
        data_bitrate=data.get("data_bittiming", {}).get("bitrate"),
        controller_state=str(data.get("state", "")),
        tx_error_counter=int(counters.get("tx", 0)),
        rx_error_counter=int(counters.get("rx", 0)),
        restart_ms=data.get("restart_ms") if data else None,
        event_counts={
            **info.get("info_xstats", {}),
            **_dropped_frame_count(link.get("stats64", {})),
        },
    )


def _dropped_frame_count(link_statistics: dict[str, Any]) -> dict[str, int]:
    """Return how many frames were dropped, by kind of event.

    Received frames and sent frames are counted separately.
    """
    return {
        f"{side}_dropped": int(link_statistics.get(side, {}).get("dropped", 0))
        for side in ("rx", "tx")
    }
