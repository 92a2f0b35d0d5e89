"""``handctl bus doctor``: check the interface and the nodes of each bus, and print a remedy for each problem."""

import argparse
from collections.abc import Sequence
from typing import Any

from handctl.cli.checks.scan import undiscoverable_protocols_text
from handctl.cli.console.options import print_json
from handctl.cli.console.verbosity import is_quiet, print_note
from handctl.drives.discovery import DUPLICATE_NODE_WARNING, DiscoveredNode
from handctl.drives.protocol_registry import DISCOVERY_BY_PROTOCOL
from handctl.errors import BusError, ConfigError
from handctl.hand.description import Hand
from handctl.hand.file.section_models import Bus as BusSection
from handctl.hand.hand_loading import load_hand
from handctl.runtime.buses.adapter import UsbAdapter, read_adapter
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.buses.contract import Bus
from handctl.runtime.buses.interface_setup import interface_names
from handctl.runtime.buses.link_state import MissingTool, read_link
from handctl.runtime.diagnostics.bus_scan import BusScan, scan_bus
from handctl.runtime.diagnostics.link_findings import (
    WIRING_ADVICE,
    LinkFinding,
    adapter_findings,
    interface_findings,
    missing_interface_finding,
)
from handctl.runtime.diagnostics.round_trip import RoundTrip, measure_round_trips
from handctl.session.buses import parse_bus_arguments
from handctl.session.exit_codes import ExitCode

NO_USB_ADAPTER = UsbAdapter()
"""Stand-in for the USB adapter, for a CAN interface that has no USB adapter."""
BUSY_HINT = "check the load of the computer and the latency timer of the adapter; handctl doctor checks the priorities"
SLOW_ROUND_TRIP_S = 0.005
"""Largest acceptable median of a node's round-trip times [s].

The limit is one tick at a control rate of 200 Hz.
"""


def run(args: argparse.Namespace) -> int:
    """Check the buses that the command line names. Return 1 if a problem was found.

    Args:
        args: arguments of the command: bus, bitrate, data_bitrate, json and hand. The hand file
            gives the expected bit rates and motors. If no hand is given, any motors and bit rates
            are accepted.
    """
    hand = load_hand(args.hand) if args.hand else None
    if not args.bus:
        raise ConfigError("missing", "--bus", "the buses to look at, such as --bus socketcan:can0")
    results = [_examine_bus(spec, section, hand) for spec, section in _expected_buses(args, hand)]
    if args.json:
        print_json({"buses": results})
    is_good = all(finding["good"] for bus in results for finding in bus["findings"])
    if not args.json:
        _print_findings(results)
    return ExitCode.DONE if is_good else ExitCode.FAILED


def _expected_buses(
    args: argparse.Namespace, hand: Hand | None
) -> Sequence[tuple[str, BusSection]]:
    """Return each bus of the command line, with its expected name and its expected bit rates."""
    if hand is not None:
        from handctl.session.run_plan import bus_specs

        return tuple(zip(bus_specs(hand, args.bus), hand.bus, strict=True))
    rates = {"bitrate": args.bitrate, "data_bitrate": args.data_bitrate}
    return tuple(
        (spec, BusSection(name=name, **rates))
        for name, spec in parse_bus_arguments(args.bus).items()
    )


def _examine_bus(spec: str, expected: BusSection, hand: Hand | None) -> dict[str, Any]:
    """Return the findings about the interface of a bus.

    If the interface works, the result also contains findings about the nodes on the bus.
    """
    print_note(f"{spec}: looking")
    kind, _, channel = spec.partition(":")
    rows = _check_interface(channel, expected) if kind == "socketcan" else []
    round_trips: list[tuple[DiscoveredNode, RoundTrip]] = []
    if not any(finding.is_bus_unusable for finding in rows):
        node_findings, round_trips = _check_node_round_trips(spec, expected, hand)
        rows += node_findings
    return {
        "bus": spec,
        "name": expected.name,
        "findings": [
            {"what": row.observation, "good": row.is_good, "fix": "" if row.is_good else row.remedy}
            for row in rows
        ],
        "nodes": [
            {"protocol": node.protocol, "node_id": node.node_id, **_trip_fields(trip)}
            for node, trip in round_trips
        ],
    }


def _check_interface(channel: str, expected: BusSection) -> list[LinkFinding]:
    try:
        link = read_link(channel)
    except MissingTool:
        return [
            LinkFinding(
                "the state of the interface is unknown: the program 'ip' is not installed",
                False,
                "sudo apt-get install iproute2",
            )
        ]
    if link is None:
        return [missing_interface_finding(channel, expected.bitrate, expected.data_bitrate)]
    adapter = read_adapter(channel)
    other_names = [name for name in interface_names() if name != channel]
    other_channels = [name for name in other_names if (read_adapter(name) or NO_USB_ADAPTER).serial]
    rows = interface_findings(channel, link, expected.bitrate, expected.data_bitrate)
    return rows + adapter_findings(channel, adapter, link.kind, other_channels)


def _check_node_round_trips(
    spec: str, expected: BusSection, hand: Hand | None
) -> tuple[list[LinkFinding], list[tuple[DiscoveredNode, RoundTrip]]]:
    """Open a bus, scan for nodes, and measure the time from a request to its reply for each node.

    Return the findings and the measured times.
    """
    try:
        bus = open_bus(spec, 0, expected.bitrate, expected.data_bitrate)
    except BusError as error:
        return [LinkFinding(f"cannot be opened: {error}", False, error.right or WIRING_ADVICE)], []
    try:
        result = scan_bus(bus)
        round_trips = [] if result.foreign_frames else _measure_round_trips(bus, result)
    finally:
        bus.close()
    rows = [
        LinkFinding("can be opened", True),
        *_event_findings(result),
        *map(_answers_text, round_trips),
    ]
    rows += [
        LinkFinding(
            f"{node.protocol} {node.node_id}: two drives answer", False, DUPLICATE_NODE_WARNING
        )
        for node in _duplicate_nodes(result, round_trips)
    ]
    if result.foreign_frames:
        problem_text = "another host controls this bus: nodes were not queried"
        rows.append(LinkFinding(problem_text, False, "stop it, and run the command again"))
    elif hand is not None:
        rows += _missing_motors(hand, expected.name, result)
    elif not result.found_nodes:
        rows.append(
            LinkFinding(
                "no drive answers", False, f"{WIRING_ADVICE}; {undiscoverable_protocols_text()}"
            )
        )
    else:
        rows.append(LinkFinding(undiscoverable_protocols_text(), True))
    return rows, round_trips


def _duplicate_nodes(
    result: BusScan, node_round_trips: list[tuple[DiscoveredNode, RoundTrip]]
) -> list[DiscoveredNode]:
    """Return the nodes whose node number is used by two or more drives."""
    shared_nodes = [node for node, trip in node_round_trips if trip.is_node_number_shared]
    return [node for node in result.found_nodes if node.twins or node in shared_nodes]


def _measure_round_trips(bus: Bus, result: BusScan) -> list[tuple[DiscoveredNode, RoundTrip]]:
    return [
        (node, measure_round_trips(bus, node))
        for node in result.found_nodes
        if node.protocol in DISCOVERY_BY_PROTOCOL
    ]


def _event_findings(result: BusScan) -> list[LinkFinding]:
    """Return one finding for each kind of bus event that occurred during the scan."""
    return [
        LinkFinding(f"during the scan: {kind}, {number} times", False, WIRING_ADVICE)
        for kind, _, number in result.bus_events
    ]


def _answers_text(node_and_round_trip: tuple[DiscoveredNode, RoundTrip]) -> LinkFinding:
    node, trip = node_and_round_trip
    name = f"{node.protocol} {node.node_id}"
    if not trip.answers:
        return LinkFinding(
            f"{name} answered the scan, but no further request", False, WIRING_ADVICE
        )
    times = (
        f"{trip.shortest_s * 1e3:.2f} / {trip.median_s * 1e3:.2f} / {trip.longest_s * 1e3:.2f} ms"
    )
    problem_text = (
        f"{name} answers {trip.answers} of {trip.requests}, shortest / median / longest {times}"
    )
    is_good = trip.answers == trip.requests and trip.median_s < SLOW_ROUND_TRIP_S
    return LinkFinding(problem_text, is_good, BUSY_HINT)


def _missing_motors(hand: Hand, bus: str, result: BusScan) -> list[LinkFinding]:
    """Return one finding for each motor that should be on the bus, but that the scan has not found."""
    found_numbers = {(node.protocol, node.node_id) for node in result.found_nodes}
    motors = [
        motor
        for motor in hand.motor
        if motor.bus == bus and (motor.protocol, motor.node_id) not in found_numbers
    ]
    names = [
        (
            f"{motor.name} ({motor.protocol} {motor.node_id})",
            motor.protocol in DISCOVERY_BY_PROTOCOL,
        )
        for motor in motors
    ]
    return [
        LinkFinding(f"{name} does not answer", False, WIRING_ADVICE)
        if is_queried
        else LinkFinding(f"{name} was not searched for: it answers only to commands", True)
        for name, is_queried in names
    ]


def _trip_fields(trip: RoundTrip) -> dict[str, Any]:
    """Return the fields that describe a measured round-trip time [s] in the JSON output."""
    return {
        "answers": trip.answers,
        "asked": trip.requests,
        "shortest": trip.shortest_s,
        "median": trip.median_s,
        "longest": trip.longest_s,
        "twice": trip.duplicate_answer_count,
    }


def _print_findings(buses: list[dict[str, Any]]) -> None:
    for bus in buses:
        shown_findings = [
            finding_row
            for finding_row in bus["findings"]
            if not (finding_row["good"] and is_quiet())
        ]
        if shown_findings or not is_quiet():
            print(f"{bus['name']} ({bus['bus']}):")
        for finding in shown_findings:
            print(f"  {'ok ' if finding['good'] else '-- '} {finding['what']}")
            if not finding["good"]:
                print(f"        {finding['fix']}")
