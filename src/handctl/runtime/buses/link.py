"""The state of a Linux CAN interface, as ``ip -details -statistics -json link show`` tells it.

Source: iproute2, iplink_can.c.
"""

import json
import subprocess
from collections.abc import Mapping
from typing import Any, NamedTuple

MTU_FD = 72
TIMEOUT_S = 5.0


class Link(NamedTuple):
    """An interface.

    Attributes:
        up: whether it is. kind: ``can``, ``vcan``, ... queue: frames that wait at most (txqueuelen).
        fd: whether it carries CAN FD. bitrate, data_bitrate: [bit/s]; None where there is none, as on vcan.
        state: of the controller, ``ERROR-ACTIVE`` and so on; empty where there is none.
        sending, receiving: error counters of the controller.
        restart_ms: after bus-off; 0 if a person has to do it; None where there is none.
        counts: what has happened since the interface was made: bus_error, error_passive, bus_off, tx_dropped, ...
    """

    up: bool
    kind: str
    queue: int
    fd: bool
    bitrate: int | None
    data_bitrate: int | None
    state: str
    sending: int
    receiving: int
    restart_ms: int | None
    counts: Mapping[str, int]


class NoTool(Exception):  # noqa: N818 - tells that a program is missing
    """There is no ``ip`` here, or it does not answer in time."""


def read_link(name: str) -> Link | None:
    """State of an interface; None if there is no such interface.

    Raises:
        NoTool: iproute2 is not installed, or does not answer.
    """
    command = ["ip", "-details", "-statistics", "-json", "link", "show", "dev", name]
    try:
        told = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    except (FileNotFoundError, subprocess.TimeoutExpired):
        raise NoTool from None
    return parse_link(told.stdout) if told.returncode == 0 else None


def parse_link(text: str) -> Link | None:
    """The interface in the output of ``ip``; None if there is none in it."""
    try:
        (shown,) = json.loads(text)
    except ValueError:
        return None
    info: dict[str, Any] = shown.get("linkinfo", {})
    data: dict[str, Any] = info.get("info_data", {})
    counters = data.get("berr_counter", {})
    return Link(
        up="UP" in shown.get("flags", ()),
        kind=str(info.get("info_kind", "")),
        queue=int(shown.get("txqlen", 0)),
        fd=int(shown.get("mtu", 0)) >= MTU_FD,
        bitrate=data.get("bittiming", {}).get("bitrate"),
        data_bitrate=data.get("data_bittiming", {}).get("bitrate"),
        state=str(data.get("state", "")),
        sending=int(counters.get("tx", 0)),
        receiving=int(counters.get("rx", 0)),
        restart_ms=data.get("restart_ms") if data else None,
        counts={**info.get("info_xstats", {}), **_dropped(shown.get("stats64", {}))},
    )


def _dropped(stats: dict[str, Any]) -> dict[str, int]:
    """Frames lost on either side."""
    return {f"{side}_dropped": int(stats.get(side, {}).get("dropped", 0)) for side in ("rx", "tx")}
