"""``handctl scan``: find the nodes on a bus without moving a motor, and print hand-file sections for them."""

import argparse
import dataclasses
from functools import partial
from typing import Any

from handctl.cli.checks.hand_file_snippet import hand_file_snippet
from handctl.cli.console.options import print_json
from handctl.cli.console.verbosity import print_note
from handctl.drives.cia402 import codec as cia402_codec
from handctl.drives.discovery import DiscoveredNode
from handctl.drives.frame import REMOTE_FLAG, Frame
from handctl.drives.protocol_registry import PROTOCOLS_WITHOUT_DISCOVERY
from handctl.hand.file.section_models import CIA404_PROTOCOL
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.diagnostics.bus_scan import BusScan, requests_without_answers, scan_bus
from handctl.session.buses import parse_bus_arguments
from handctl.session.exit_codes import ExitCode

MAX_FOREIGN_FRAMES = 8
"""Largest number of frames from another host that the output shows."""
MILLI_FACTOR = 1e-3


def run(args: argparse.Namespace) -> int:
    """Scan each bus on the command line for nodes. If no node was found, return 1."""
    buses = parse_bus_arguments(args.bus)
    if args.dry_run:
        return _print_scan_requests(args.json)
    scans: dict[str, BusScan] = {}
    for name, spec in buses.items():
        opened_bus = open_bus(spec, 0, args.bitrate)
        try:
            scans[name] = scan_bus(opened_bus, args.force, partial(_print_bus_note, spec))
        finally:
            opened_bus.close()
        if not scans[name].foreign_frames:
            scans[name] = scans[name]._replace(
                found_nodes=add_node_identities(scans[name].found_nodes, spec, args.bitrate)
            )
    snippet = hand_file_snippet(
        {name: result.found_nodes for name, result in scans.items()},
        args.bitrate,
        args.data_bitrate,
    )
    if args.json:
        bus_fields = [_scan_fields(name, buses[name], result) for name, result in scans.items()]
        print_json(
            {
                "buses": bus_fields,
                "fragment": snippet,
                "not_looked_for": list(PROTOCOLS_WITHOUT_DISCOVERY),
            }
        )
    else:
        _print_scans(buses, scans, snippet)
    return (
        ExitCode.DONE if any(result.found_nodes for result in scans.values()) else ExitCode.FAILED
    )


def _print_bus_note(spec: str, text: str) -> None:
    """Print the name of a bus and a note about the bus."""
    print_note(f"{spec}: {text}")


def add_node_identities(
    nodes: tuple[DiscoveredNode, ...], spec: str, bitrate: int
) -> tuple[DiscoveredNode, ...]:
    """Return the nodes that a scan has found, with additional data about CANopen nodes.

    For each CANopen node, the result also contains the identity that the node reports over SDO.
    """
    canopen_ids = [drive.node_id for drive in nodes if drive.protocol == "cia402"]
    if not canopen_ids:
        return nodes
    from handctl.runtime.diagnostics.canopen_identity import identify_nodes

    print_note(f"{spec}: reading the identity of CANopen nodes {', '.join(map(str, canopen_ids))}")
    identities = identify_nodes(spec, bitrate, canopen_ids)
    return tuple(
        _add_node_identity(drive, identities[drive.node_id].numbers, identities[drive.node_id].texts)
        if drive.protocol == "cia402" else drive
        for drive in nodes
    )  # fmt: skip


def _add_node_identity(
    drive: DiscoveredNode, identity_numbers: dict[str, int], identity_texts: dict[str, str]
) -> DiscoveredNode:
    power = (
        cia402_codec.power_state(identity_numbers["status"]) if "status" in identity_numbers else ""
    )
    notes = list(drive.notes)
    if not identity_numbers.get("modes", 0) >> 9 & 1:
        notes.append("does not offer cyclic synchronous torque (0x6502 bit 9)")
    options: dict[str, bool | int | float | str] = {}
    origins: dict[str, str] = {}
    if rated_torque := identity_numbers.get("rated_torque"):
        options["rated_torque_N_m"] = rated_torque * MILLI_FACTOR
        origins["rated_torque_N_m"] = (
            f"from {rated_torque} in 0x6076, if that is in mN m; EPOS4: uN m"
        )
        notes.append(
            f"rated torque {rated_torque} taken as mN m; EPOS4 counts in uN m: rated_torque_unit"
        )
    if counts := identity_numbers.get("counts"):
        options["counts_per_turn"] = counts
    identity = (
        [f"vendor {identity_numbers['vendor']:#x}, product {identity_numbers['product']:#x}"]
        if "product" in identity_numbers
        else []
    )
    return dataclasses.replace(
        drive,
        firmware=identity_texts.get("software")
        or (
            f"revision {identity_numbers['revision']:#x}" if "revision" in identity_numbers else ""
        ),
        serial=f"{identity_numbers['serial']:#x}" if "serial" in identity_numbers else "",
        state=", ".join(filter(None, (drive.state, power))),
        error=cia402_codec.error_text(identity_numbers["error"])
        if identity_numbers.get("error")
        else "",
        options=options,
        origins=origins,
        notes=tuple(filter(None, (identity_texts.get("name", ""), *identity, *notes))),
    )


def _scan_fields(name: str, spec: str, result: BusScan) -> dict[str, Any]:
    return {
        "name": name,
        "bus": spec,
        "frames_heard": result.frame_count,
        "another_host": [_frame_text(frame) for frame in result.foreign_frames],
        "not_asked": sorted({_frame_text(frame) for frame in result.omitted_requests}),
        "events": [list(event) for event in result.bus_events],
        "nodes": [dataclasses.asdict(drive) for drive in result.found_nodes],
    }


def _frame_text(frame: Frame) -> str:
    """Return a CAN frame as text in the notation of candump."""
    return f"{frame.can_id & 0x1FFFFFFF:03X}#" + (
        "R" if frame.can_id & REMOTE_FLAG else frame.data.hex().upper()
    )


def _print_scans(buses: dict[str, str], scan_of_bus: dict[str, BusScan], snippet: str) -> None:
    for name, result in scan_of_bus.items():
        print(
            f"{name} ({buses[name]}): {len(result.found_nodes)} nodes, {result.frame_count} frames received"
        )
        if result.foreign_frames:
            texts = dict.fromkeys(_frame_text(frame) for frame in result.foreign_frames)
            frames_text = ", ".join(list(texts)[:MAX_FOREIGN_FRAMES])
            print(
                f"  another host controls this bus ({frames_text}): no request was sent; stop it or use --force"
            )
        if result.omitted_requests:
            kinds = sorted({f"{frame.can_id:#05x}" for frame in result.omitted_requests})
            print(
                f"  no request with identifier {', '.join(kinds)}: a drive on this bus would take it as a command;"
            )
            print("  to find nodes that answer to it, switch that drive off and scan again")
        for drive in result.found_nodes:
            _print_drive(drive)
    print(undiscoverable_protocols_text())
    if any(result.found_nodes for result in scan_of_bus.values()):
        print(f"\n{snippet}", end="")


def undiscoverable_protocols_text() -> str:
    """Return a line that lists the protocols whose drives a scan cannot find."""
    return f"not searched for: {', '.join(PROTOCOLS_WITHOUT_DISCOVERY)}, whose drives answer only to commands"


def _print_drive(drive: DiscoveredNode) -> None:
    fields = (
        ("firmware", drive.firmware),
        ("serial", drive.serial),
        ("", drive.state),
        ("ERROR", drive.error),
    )
    line_text = "  ".join(f"{key} {text}".strip() for key, text in fields if text)
    number = (
        f"{drive.node_id:#x}"
        if drive.protocol in ("sensor", CIA404_PROTOCOL)
        else str(drive.node_id)
    )
    print(f"  {drive.protocol:<8}{number:>5}  {line_text}")
    for line in drive.notes:
        print(f"                {line}")


def _print_scan_requests(as_json: bool) -> int:
    questions = [_frame_text(frame) for frame in requests_without_answers()]
    if as_json:
        print_json({"questions": questions})
        return ExitCode.DONE
    print(
        "scan listens first, and sends requests only if there is no other host; it may send these frames:"
    )
    print("\n".join(questions))
    return ExitCode.DONE
