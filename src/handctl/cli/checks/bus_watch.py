"""``handctl bus watch``: show the readings of all drives and load cells of a hand, without enabling a drive."""

import argparse
import math
import signal
import sys
import time
from contextlib import ExitStack
from typing import Any

from handctl.cli.console.options import print_json_line
from handctl.cli.console.rich_console import rich_console
from handctl.cli.console.verbosity import print_note
from handctl.controller.run_setup import make_drives, make_sensors
from handctl.drives.contract import Drive, DriveState
from handctl.errors import BusError, ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import load_hand
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.clocks.real_clock import RealClock
from handctl.runtime.diagnostics.bus_watch import STALE_AFTER_S, BusWatch, is_saturated
from handctl.runtime.mailbox import bus_lock, is_running
from handctl.session.buses import refuse_default_hand
from handctl.session.default_hand import DEFAULT_HAND
from handctl.session.exit_codes import ExitCode
from handctl.session.run_plan import bus_specs, chosen_time_scale, default_control_rate
from handctl.signal_handlers import TerminationFlag, installed_handler

MAX_POLL_RATE_HZ = 100.0
"""Largest rate at which ``handctl bus watch`` polls the drives [Hz].

A high bus load can lower the poll rate further.
"""
REFRESH_PERIOD_S = 0.1
"""Time between two lines of JSON, or between two tables in a terminal [s]."""
TABLE_PRINT_PERIOD_S = 1.0
"""Time between two tables that go to a pipe or file [s]."""
MAX_WATCH_DURATION_S = 86400.0


def run(args: argparse.Namespace) -> int:
    """Show the readings for a given time, or until the operator presses Ctrl-C.

    Return 1 if a drive stopped replying before the end of the command.
    """
    specs, hand, time_scale = _checked_arguments(args)
    drives = make_drives(hand)
    clock = RealClock(round(1e9 / min(MAX_POLL_RATE_HZ, default_control_rate(hand))), time_scale)
    for spec in specs:
        if is_running(spec):
            expected = (
                "no running controller: its own display and handctl run --view show the readings"
            )
            raise BusError("a controller runs here", f"bus {spec}", expected)
    with ExitStack() as stack:
        for spec in specs:
            stack.enter_context(bus_lock(spec))
        opened_buses = []
        for index, (spec, section) in enumerate(zip(specs, hand.bus, strict=True)):
            bus = open_bus(
                spec, index, section.bitrate, section.data_bitrate, clock.convert_to_run_time
            )
            stack.callback(bus.close)
            opened_buses.append(bus)
        bus_watch = BusWatch(drives, make_sensors(hand), opened_buses, clock, clock.period_ns)
        print_note(
            f"handctl: {hand.name} on {', '.join(specs)}: no drive is enabled. Ctrl-C ends the command."
        )
        if other_host_ids := bus_watch.find_other_host():
            problem = f"another host controls this bus (received: {other_host_ids})"
            raise BusError(problem, f"bus {', '.join(specs)}", "no other host")
        termination_flag = TerminationFlag()
        stack.enter_context(installed_handler(termination_flag, signal.SIGINT, signal.SIGTERM))
        stack.callback(bus_watch.send_release)
        clock.start()
        _show_readings(args, hand, bus_watch, termination_flag)
    if silent_motors := bus_watch.silent_motors():
        print(f"handctl: without a reply at the end: {', '.join(silent_motors)}", file=sys.stderr)
    return ExitCode.FAILED if silent_motors else ExitCode.DONE


def _checked_arguments(args: argparse.Namespace) -> tuple[tuple[str, ...], Hand, float]:
    """Return the buses, the hand and the time scale that the command line gives.

    Raises:
        ConfigError: an argument is missing or out of range, or a real bus is given without a hand.
    """
    if not args.bus:
        raise ConfigError("missing", "--bus", "the bus of the hand, such as --bus socketcan:can0")
    if args.duration is not None and not 0.0 < args.duration <= MAX_WATCH_DURATION_S:
        raise ConfigError(
            f"{args.duration:g}", "--for", f"more than 0, at most {MAX_WATCH_DURATION_S:g}"
        )
    if args.hand is None:
        refuse_default_hand([text.rpartition("=")[2] for text in args.bus], "--hand")
    hand = load_hand(args.hand or DEFAULT_HAND)
    specs = bus_specs(hand, args.bus)
    return specs, hand, chosen_time_scale(args.time_scale, specs)


def _show_readings(
    args: argparse.Namespace, hand: Hand, bus_watch: BusWatch, termination: TerminationFlag
) -> None:
    """Send a poll to every drive in every tick.

    Show the readings of the drives at intervals and at the end of the command.
    """
    start_time_s = time.monotonic()
    end = start_time_s + (math.inf if args.duration is None else args.duration)
    redraws_in_place = sys.stdout.isatty() and not args.json
    print_period_s = REFRESH_PERIOD_S if args.json or redraws_in_place else TABLE_PRINT_PERIOD_S
    next_print_time = start_time_s + print_period_s
    with ExitStack() as stack:
        live_display = None
        if redraws_in_place:
            from rich.live import Live

            live_display = stack.enter_context(Live(console=rich_console(), auto_refresh=False))
        while not termination.requested and (now := time.monotonic()) < end:
            bus_watch.run_tick()
            if now < next_print_time:
                continue
            next_print_time = max(next_print_time + print_period_s, now)
            readings = bus_readings(hand, bus_watch)
            if live_display is not None:
                live_display.update(_readings_table(readings), refresh=True)
            elif args.json:
                print_json_line(readings)
            else:
                rich_console(min_width=100).print(_readings_table(readings))
                sys.stdout.flush()


def bus_readings(hand: Hand, bus_watch: BusWatch) -> dict[str, Any]:
    """Return the present readings of all drives and load cells of a hand.

    A reading that is older than ``STALE_AFTER_S`` becomes NaN.
    """
    now = bus_watch.clock.now_ns()
    rows = zip(
        hand.tendon_names, bus_watch.drives, bus_watch.states, bus_watch.ages_s(now), strict=True
    )
    tensions = {
        hand.tendon_names[index]: reading.value_at(now)
        for index, reading in bus_watch.tensions.items()
    }
    return {
        "t_s": now * 1e-9,
        "drives": [
            _drive_fields(hand, tendon, drive, state, age) for tendon, drive, state, age in rows
        ],
        "load_cells": [
            {
                "tendon": name,
                "tension_N": value,
                "saturated": is_saturated(value, bus_watch.sensors.cell_range),
            }
            for name, value in tensions.items()
        ],
        "joint_encoders": [
            {"joint": hand.joints[index], **_joint_reading(hand, index, reading.value_at(now))}
            for index, reading in bus_watch.angles.items()
        ],
    }


def _joint_reading(hand: Hand, joint_index: int, value: float) -> dict[str, float]:
    """Return the reading of a joint encoder and the unit of the reading.

    The position of a prismatic joint is in m.
    """
    return {("position_m" if hand.is_prismatic[joint_index] else "angle_rad"): value}


def _drive_fields(
    hand: Hand, tendon: str, drive: Drive, state: DriveState, age_s: float
) -> dict[str, Any]:
    """Return the readings of a drive. The position and the velocity are those of the spool.

    Position and velocity are positive for a motion that winds up the tendon.
    """
    motor = hand.motor_of_tendon(tendon)
    values = (state.position, state.velocity, state.torque, state.temperature)
    shown_values = values if age_s <= STALE_AFTER_S else (math.nan,) * len(values)
    names = ("angle_rad", "velocity_rad_s", "torque_N_m", "temperature_degC")
    return {
        "motor": drive.name, "tendon": tendon, "protocol": motor.protocol, "node_id": motor.node_id,
        "phase": state.phase.name.lower(), **dict(zip(names, shown_values, strict=True)), "age_s": age_s,
        "error": state.error_text,
    }  # fmt: skip


def _readings_table(reading_fields: dict[str, Any]) -> Any:
    """Return the readings of a hand as a table with one row for each drive."""
    from rich.table import Table

    cells = {row["tendon"]: row for row in reading_fields["load_cells"]}
    table = Table(box=None, pad_edge=False)
    column_titles = (
        "motor",
        "node",
        "phase",
        "angle [deg]",
        "velocity [deg/s]",
        "torque [N m]",
        "temp. [C]",
        "load cell [N]",
    )
    for title in column_titles:
        table.add_column(title, justify="left" if title in ("motor", "phase") else "right")
    for row in reading_fields["drives"]:
        cell = cells.get(row["tendon"], {"tension_N": math.nan, "saturated": False})
        table.add_row(
            row["motor"], str(row["node_id"]), row["error"] or row["phase"],
            _number_text(math.degrees(row["angle_rad"]), 1), _number_text(math.degrees(row["velocity_rad_s"]), 1),
            _number_text(row["torque_N_m"], 3), _number_text(row["temperature_degC"], 0),
            _number_text(cell["tension_N"], 2) + (" end of range" if cell["saturated"] else ""),
        )  # fmt: skip
    for row in reading_fields["joint_encoders"]:
        value_text = (
            f"{_number_text(1e3 * row['position_m'], 2)} mm"
            if "position_m" in row
            else _number_text(math.degrees(row["angle_rad"]), 1)
        )
        table.add_row(row["joint"], "", "joint encoder", value_text)
    return table


def _number_text(value: float, digits: int) -> str:
    """Return a reading as text, or ``-`` if there is no reading."""
    return "-" if math.isnan(value) else f"{value + 0.0:.{digits}f}"
