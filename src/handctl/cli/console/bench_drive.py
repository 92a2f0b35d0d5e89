"""Commands that use a single drive on a bench, without a hand file.

This module reads the options, scans for the drive, describes the drive, and opens the bus of the
drive.
"""

import argparse
import dataclasses
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from pydantic import ValidationError

from handctl.cli.checks.scan import add_node_identities
from handctl.cli.console.verbosity import print_note
from handctl.drives.contract import Drive
from handctl.drives.discovery import SCAN_LISTEN_S, DiscoveredNode
from handctl.drives.frame import Frame
from handctl.drives.mit.drive import MitDrive
from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.drives.protocol_registry import PROTOCOL_ENTRIES, make_drive
from handctl.drives.robstride.mit_mode import FACTORY_HOST_ID
from handctl.errors import BusError, ConfigError, DriveError
from handctl.hand.file.error_text import toml_spelling
from handctl.hand.file.section_models import Motor
from handctl.hand.hand_loading import parse_toml
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.buses.contract import Bus
from handctl.runtime.clocks.real_clock import RealClock
from handctl.runtime.clocks.realtime_priority import request_priority, restore_priority
from handctl.runtime.diagnostics.bus_scan import BusScan, collect_frames, scan_bus
from handctl.runtime.diagnostics.drive_rig import PERIOD_NS, DriveRig

DRIVE_STILL_ON_WARNING = "the drive does not report that it is off: REMOVE ITS POWER"
"""Message about a drive that possibly still produces torque."""
WATCHDOG_MS = 100
"""Time without commands after which the watchdog stops the drive [ms].

The time of the watchdog is longer than the delays of a desktop computer without real-time priority.
"""
BENCH_OPTIONS: dict[str, dict[str, Any]] = {
    "odrive": {"torque_feedback": True},
    "cia402": {"sync": True},
    "robstride_mit": {"host_id": FACTORY_HOST_ID},
}
"""Options for a single drive on a bench, by protocol.

A CiA 402 drive gets SYNC messages from handctl, because no other host on the bench sends them. A
new RobStride motor has the factory setting of the host number.
"""
TEXT_VALUED_OPTIONS = ("firmware", "motor_type")
"""Options whose value is always text, even if it looks like a number, as in firmware=0.5."""
UNQUOTED_VALUE_PATTERN = re.compile(r"[A-Za-z0-9][\w.-]*")
"""Pattern of an option's value that needs no quotes."""
DEFAULT_DRIVE_OPTIONS = {"rated_torque_N_m": 1.0, "counts_per_turn": 65536}
"""Defaults of options whose values some CiA 402 drives do not report.

If the rated torque is wrong, handctl notices the mistake when it reads back the settings of the
drive, and refuses the drive.
"""


def parse_options(option_words: list[str]) -> dict[str, Any]:
    """Parse words of the form KEY=VALUE, and return the options of a drive.

    A value is written as in TOML, but quotes around a text are optional.

    Raises:
        ConfigError: a word is not TOML.
    """
    options: dict[str, Any] = {}
    for word in option_words:
        options |= _parse_option(word)
    return options


def _parse_option(word: str) -> dict[str, Any]:
    key, _, value = word.partition("=")
    quoted = f'{key}="{value}"'
    if key.strip() in TEXT_VALUED_OPTIONS and value[:1] not in ('"', "'"):
        word = quoted
    try:
        return parse_toml(word, "--option")
    except ConfigError as error:
        if (
            UNQUOTED_VALUE_PATTERN.fullmatch(value) and not value.isdecimal()
        ):  # TOML refuses a number that has too many digits
            return parse_toml(quoted, "--option")
        expected = "KEY=VALUE, as in gear_ratio=6.0 or motor_type=ak80-9"
        raise ConfigError(f"{word}: {error.what}", "--option", expected) from None


def _drive_in_torque_mode(motor: Motor) -> Drive:
    """Return the drive of a motor, configured for torque mode."""
    return make_drive(motor, 0)


def describe_drive(
    args: argparse.Namespace,
    options: dict[str, Any],
    node: DiscoveredNode | None,
    make_drive: Callable[[Motor], Drive] = _drive_in_torque_mode,
) -> Drive:
    """Return a drive that is constructed from the values that the real drive reports.

    If the command line gives a value that the drive also reports, the value of the command line is
    used.

    Args:
        args: arguments with ``protocol``, ``node`` and ``limit`` [N m].
        options: options of the drive, from the command line.
        node: the drive found by a scan, or None before the scan.
        make_drive: function that constructs the drive of a motor.

    Raises:
        ConfigError: the protocol does not have the option, or does not allow the node number.
    """
    reported_options: dict[str, Any] = dict(node.options) if node else {}
    if args.protocol == "cia402":
        reported_options = DEFAULT_DRIVE_OPTIONS | reported_options
    reported_options = _bench_options(args.protocol, reported_options | options) | reported_options
    _check_motor_type(args.protocol, reported_options | options)
    settings = {
        "position_range_rad": 12.5,
        "velocity_range_rad_s": 30.0,
        **(node.settings if node else {}),
    }
    motor = {
        "name": f"{args.protocol}_{args.node}", "protocol": args.protocol, "bus": "bench", "node_id": args.node,
        "spool_radius_m": 0.005, "inertia_kg_m2": 1e-4, "viscous_N_m_s_per_rad": 0.0, "coulomb_N_m": 0.0,
        "torque_constant_N_m_per_A": 0.1, "direction": 1, "zero_rad": 0.0, "watchdog_ms": WATCHDOG_MS,
        **settings, "torque_max_N_m": args.limit, "torque_peak_N_m": args.limit, "options": reported_options | options,
    }  # fmt: skip
    try:
        return make_drive(Motor.model_validate(motor))
    except ValidationError as error:
        error_detail = error.errors(include_url=False)[-1]
        key = str(error_detail["loc"][-1]) if error_detail["loc"] else args.protocol
        expected = (
            error_detail["msg"]
            .removeprefix("Value error, ")
            .removeprefix("Input should be ")
            .removeprefix("expected ")
        )
        raise ConfigError(
            toml_spelling(error_detail["input"]), "--node" if key == "node_id" else key, expected
        ) from None
    except ValueError as error:
        text = str(error).splitlines()[-1]
        raise ConfigError(text, toml_spelling(args.node), "a number of that protocol") from None


def _check_motor_type(protocol: str, options: dict[str, Any]) -> None:
    """Check the option ``motor_type`` of a drive that does not report its type.

    Raises:
        ConfigError: the option is missing or unknown.
    """
    types = PROTOCOL_TRAITS[protocol].motor_types
    motor_type = options.get("motor_type")
    if types and motor_type not in types:
        problem_text = "missing" if motor_type is None else toml_spelling(motor_type)
        raise ConfigError(problem_text, "--option motor_type=TYPE", f"one of {', '.join(types)}")


def _bench_options(protocol: str, options: dict[str, Any]) -> dict[str, Any]:
    """Return the options for a single drive on a test bench.

    ODrive firmware 0.5 does not report torque, and has no options for a drive on a bench.
    """
    return {} if options.get("firmware") == "0.5" else BENCH_OPTIONS.get(protocol, {})


def find_drive(args: argparse.Namespace) -> DiscoveredNode:
    """Scan the bus for the drive on the command line, and return the description of this drive.

    Raises:
        BusError: another host controls the bus.
        DriveError: the drive does not answer.
    """
    print_note(f"{args.bus}: searching for the drive")
    bus = open_bus(args.bus, 0, args.bitrate, args.data_bitrate)
    try:
        result = (
            scan_bus(bus)
            if PROTOCOL_ENTRIES[args.protocol].discovery
            else _listen_for_drive(args, bus)
        )
    finally:
        bus.close()
    if result.foreign_frames:
        raise BusError("another host controls this bus", args.bus, "no other host: stop it")
    for node in add_node_identities(result.found_nodes, args.bus, args.bitrate):
        if (node.protocol, node.node_id) == (args.protocol, args.node):
            if node.twins:
                raise DriveError(
                    f"two drives answer as {args.protocol} {args.node}",
                    args.bus,
                    "a different node number for each drive",
                )
            return node
    found_text = (
        ", ".join(f"{node.protocol} {node.node_id}" for node in result.found_nodes) or "nothing"
    )
    expected = "a drive with power and the given bit rate and node number"
    raise DriveError(f"no {args.protocol} {args.node}; found: {found_text}", args.bus, expected)


def _listen_for_drive(args: argparse.Namespace, bus: Bus) -> BusScan:
    """Listen on the bus of a drive that a scan cannot find, and describe the drive in the form of a scan result.

    A drive that a scan cannot find sends frames only as answers to commands. The function itself
    sends nothing. If a frame with the identifier of the drive arrives, another host must be sending
    commands to the drive. The first check of the conformance test shows whether the drive is
    present.
    """
    seen_frames: list[Frame] = []
    collect_frames(bus, SCAN_LISTEN_S, seen_frames)
    foreign_frames = tuple(frame for frame in seen_frames if frame.can_id == args.node)
    return BusScan(
        (DiscoveredNode(args.protocol, args.node),), foreign_frames, (), (), len(seen_frames)
    )


def with_torque_range(drive: Drive, node: DiscoveredNode) -> Drive:
    """Return a drive with the torque range that the scan has read from the real drive.

    In the MIT protocol, every torque value is scaled by the torque range.
    """
    if isinstance(drive, MitDrive) and "torque_max_N_m" in node.settings:
        ranges = drive.ranges._replace(torque=node.settings["torque_max_N_m"])
        return dataclasses.replace(drive, ranges=ranges)
    return drive


@contextmanager
def open_drive_rig(args: argparse.Namespace, drive: Drive) -> Iterator[tuple[DriveRig, Bus]]:
    """Open the bus of a drive.

    Yield the test rig of the drive, and the opened bus. If the system allows it, the test rig runs
    with real-time priority.

    Args:
        args: arguments with ``bus`` and the bit rates of the bus.
        drive: drive on the bus.
    """
    clock = RealClock(PERIOD_NS)
    bus = open_bus(args.bus, 0, args.bitrate, args.data_bitrate, clock.convert_to_run_time)
    clock.busy_wait = request_priority().is_realtime
    try:
        yield DriveRig(drive, bus, clock), bus
    finally:
        restore_priority()
        bus.close()
