"""Findings about a CAN interface. If a finding is a problem, the finding contains a command or advice."""

from collections.abc import Sequence
from typing import NamedTuple

from handctl.runtime.buses.adapter import UsbAdapter
from handctl.runtime.buses.interface_setup import (
    BUS_OFF_RESTART_MS,
    TX_QUEUE_FRAMES,
    interface_setup_text,
)
from handctl.runtime.buses.link_state import CanLinkState
from handctl.runtime.buses.socketcan import MIN_QUEUE_FRAMES

# Rules for udev. With a udev rule, the setting is made again after each restart of the machine.
# Source: man 7 udev.
UDEV_QUEUE_RULE = 'SUBSYSTEM=="net", ACTION=="add", KERNEL=="{0}", ATTR{{tx_queue_len}}="{1}"'
UDEV_NAME_RULE = 'SUBSYSTEM=="net", ACTION=="add", ATTRS{{serial}}=="THE ADAPTER\'S", NAME="{0}"'
UDEV_SERIAL_RULE = 'SUBSYSTEM=="net", ACTION=="add", ATTRS{{serial}}=="{1}", NAME="{0}"'
UDEV_FILE = "/etc/udev/rules.d/90-can.rules"
WIRING_ADVICE = (
    "check that the drives have power, both ends have 120 ohm, and all have the same bit rate"
)
ERROR_COUNTER_TEXTS = {
    "bus_error": "bus errors", "error_warning": "times error warning", "error_passive": "times error passive",
    "bus_off": "times bus-off", "arbitration_lost": "arbitrations lost", "restarts": "restarts",
    "rx_dropped": "received frames dropped", "tx_dropped": "dropped transmit frames",
}  # fmt: skip
"""Text for each reported counter of ``CanLinkState.event_counts``."""
MAX_RATE_AT_FULL_SPEED_HZ = 333
"""Highest control rate of a hand behind a USB full-speed adapter [Hz].

Source: docs/how-to/adapters.md.
"""
IGNORED_ERROR_COUNTERS = {"arbitration_lost"}
"""Names of counters that also increase on a healthy bus."""


class LinkFinding(NamedTuple):
    """One finding about an interface.

    Attributes:
        observation: text that describes the observation.
        is_good: True if the finding is not a problem.
        remedy: command or advice that corrects the problem.
        is_bus_unusable: True if the bus cannot be used.
    """

    observation: str
    is_good: bool
    remedy: str = ""
    is_bus_unusable: bool = False


def missing_interface_finding(name: str, bitrate: int, data_bitrate: int | None) -> LinkFinding:
    """Return a finding which reports that an interface does not exist."""
    if name.startswith("vcan"):
        return LinkFinding(
            f"{name} does not exist",
            False,
            interface_setup_text(name, bitrate, data_bitrate, interface_exists=False),
            is_bus_unusable=True,
        )
    remedy = (
        f"plug the adapter in and check: sudo dmesg | tail; to give it this name, in {UDEV_FILE}: "
    )
    return LinkFinding(
        f"{name} does not exist", False, remedy + UDEV_NAME_RULE.format(name), is_bus_unusable=True
    )


def interface_findings(
    name: str, link: CanLinkState, bitrate: int, data_bitrate: int | None
) -> list[LinkFinding]:
    """Return the findings about an interface.

    Args:
        name: name of the interface.
        link: state of the interface.
        bitrate: bit rate in the hand file [bit/s].
        data_bitrate: bit rate of the data phase in the hand file [bit/s], or None for a classical
            bus.
    """
    set_up_command = interface_setup_text(name, bitrate, data_bitrate, interface_exists=True)
    result = [
        LinkFinding(
            f"{name} is {'up' if link.is_up else 'down'}",
            link.is_up,
            set_up_command,
            is_bus_unusable=not link.is_up,
        )
    ]
    if link.bitrate is not None or link.kind == "can":
        result.append(_rate_finding("bit rate", link.bitrate, bitrate, set_up_command))
    if data_bitrate is not None:
        result.append(
            LinkFinding(
                "carries CAN FD" if link.is_fd else "does not carry CAN FD",
                link.is_fd,
                set_up_command,
            )
        )
        if link.kind == "can":
            result.append(
                _rate_finding(
                    "bit rate of the data phase", link.data_bitrate, data_bitrate, set_up_command
                )
            )
    udev_rule = UDEV_QUEUE_RULE.format(name, TX_QUEUE_FRAMES)
    queue = f"sudo ip link set {name} txqueuelen {TX_QUEUE_FRAMES}; for good, in {UDEV_FILE}: {udev_rule}"
    result.append(
        LinkFinding(
            f"transmit queue of {link.tx_queue_frames} frames",
            link.tx_queue_frames >= MIN_QUEUE_FRAMES,
            queue,
        )
    )
    return [*result, *_controller_findings(name, link), *_counter_findings(link)]


def adapter_findings(
    name: str, adapter: UsbAdapter | None, link_kind: str, other_interfaces: Sequence[str]
) -> list[LinkFinding]:
    """Return the findings about the adapter of an interface.

    Args:
        name: name of the interface.
        adapter: CAN adapter of the interface, or None for a virtual interface.
        link_kind: kind of the interface, such as ``slcan``.
        other_interfaces: names of the other CAN interfaces with a USB adapter.
    """
    if link_kind == "slcan":
        problem_text = "a serial line (slcan): no error counters, no bit rate to compare"
        return [
            LinkFinding(problem_text, False, "flash candleLight firmware for the driver gs_usb")
        ]
    if adapter is None:
        return []
    usb_text = f", USB {adapter.usb_speed_mbit_s:g} Mbit/s" if adapter.usb_speed_mbit_s else ""
    problem_text = f"adapter of driver {adapter.driver or 'unknown'}{usb_text}"
    if adapter.is_full_speed:
        problem_text += (
            f": one exchange each millisecond, at most {MAX_RATE_AT_FULL_SPEED_HZ} Hz for a hand"
        )
    findings = [LinkFinding(problem_text, True)]
    if adapter.driver == "mcp251x":
        problem_text = "MCP2515 has two receive buffers and loses frames of a bus at 1 Mbit/s"
        findings.append(
            LinkFinding(
                problem_text, False, "use a hat with MCP2518FD (driver mcp251xfd), or 250 kbit/s"
            )
        )
    if adapter.serial and other_interfaces:
        udev_rule = UDEV_SERIAL_RULE.format(name, adapter.serial)
        findings.append(
            LinkFinding(
                f"its name depends on the order of plugging in. To keep it, in {UDEV_FILE}: {udev_rule}",
                True,
            )
        )
    return findings


def _rate_finding(
    rate_name: str, present_bit_rate: int | None, required_bit_rate: int, repair_command: str
) -> LinkFinding:
    """Compare a bit rate of an interface with the required bit rate [bit/s], and return the finding."""
    return LinkFinding(
        f"{rate_name} {present_bit_rate or 'not set'}, the hand needs {required_bit_rate}",
        present_bit_rate == required_bit_rate,
        repair_command,
    )


def _controller_findings(name: str, link: CanLinkState) -> list[LinkFinding]:
    """Return the findings about the CAN controller: state, error counters, and restart after bus-off."""
    if not link.controller_state:
        return []
    restart_text = (
        f"sudo ip link set {name} type can restart; " if link.controller_state == "BUS-OFF" else ""
    )
    errors = f"{link.tx_error_counter} sending, {link.rx_error_counter} receiving"
    counters = f"{link.controller_state}, error counters {errors}"
    is_good = (
        link.controller_state == "ERROR-ACTIVE"
        and link.tx_error_counter + link.rx_error_counter == 0
    )
    result = [LinkFinding(counters, is_good or not link.is_up, restart_text + WIRING_ADVICE)]
    if link.restart_ms is not None:
        command = f"sudo ip link set {name} down; sudo ip link set {name} up type can restart-ms {BUS_OFF_RESTART_MS}"
        result.append(
            LinkFinding(
                f"restarts {link.restart_ms} ms after bus-off", link.restart_ms > 0, command
            )
        )
    return result


def _counter_findings(link: CanLinkState) -> list[LinkFinding]:
    """Return the findings about the event counters of an interface."""
    counter_texts = [
        f"{number} {ERROR_COUNTER_TEXTS[key]}"
        for key, number in link.event_counts.items()
        if number and key in ERROR_COUNTER_TEXTS
    ]
    has_errors = any(
        number
        for key, number in link.event_counts.items()
        if key in ERROR_COUNTER_TEXTS and key not in IGNORED_ERROR_COUNTERS
    )
    remedy = f"since it was created; {WIRING_ADVICE}; repeat this check after a run"
    return [
        LinkFinding("counted: " + (", ".join(counter_texts) or "no errors"), not has_errors, remedy)
    ]
