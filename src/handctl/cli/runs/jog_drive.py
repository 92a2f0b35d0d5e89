"""``handctl jog --mode``: move one drive on a test bench within limits, in torque, position or velocity mode."""

import argparse
import math
import sys
from typing import Any

from handctl.cli.console.bench_drive import (
    DRIVE_STILL_ON_WARNING,
    WATCHDOG_MS,
    describe_drive,
    find_drive,
    open_drive_rig,
    parse_options,
    with_torque_range,
)
from handctl.cli.console.motion_confirmation import confirm_motion
from handctl.cli.console.options import print_json
from handctl.drives.contract import Drive, DrivePhase
from handctl.drives.discovery import DiscoveredNode
from handctl.drives.drive_modes import COMMAND_UNITS, DriveMode, MotionLimits
from handctl.drives.protocol_registry import make_mode_drive
from handctl.errors import ConfigError, PowerError
from handctl.hand.file.quantity_types import (
    MAX_POSITION_RANGE_RAD,
    MAX_SPEED_RANGE_RAD_S,
    MAX_TORQUE_N_M,
    MIN_TORQUE_LIMIT_N_M,
)
from handctl.hand.file.section_models import Motor
from handctl.runtime.buses.bus_opening import check_bus_spec
from handctl.runtime.diagnostics.conformance import release_drive
from handctl.runtime.diagnostics.drive_jog import JogGoal, JogResult, jog_drive
from handctl.runtime.mailbox import bus_lock
from handctl.session.exit_codes import ExitCode

MAX_JOG_S = 600.0
"""Longest duration of a motion [s]."""
ANGLE_UNIT = "rad"


def run(args: argparse.Namespace) -> int:
    """Move a drive on a test bench.

    Return 1 if the motion stopped early, and 71 if the drive does not confirm that it is disabled.
    """
    goal = _motion_goal(args)
    options = parse_options(args.option)
    args.bus = args.bus[0]
    _describe_motion(args, options, None, goal)
    limit = f"at most {goal.max_torque_N_m:g} N m"
    line = f"{args.protocol} {args.node} on {args.bus} is moved: {_goal_text(goal)}, {limit}"
    if args.dry_run:
        if args.json:
            print_json(
                {
                    "mode": goal.mode.value,
                    "setpoint": goal.target,
                    "torque_limit_N_m": goal.max_torque_N_m,
                }
            )
        else:
            print(f"would jog: {line}")
        return ExitCode.DONE
    confirm_motion(line, args.yes)
    print(f"{line}. Ctrl-C switches the drive off.", file=sys.stderr, flush=True)
    with bus_lock(args.bus):
        node = find_drive(args)
        drive = _describe_motion(args, options, node, goal)
        torque_drive = _describe_motion(
            args, _torque_options(options), node, goal._replace(mode=DriveMode.TORQUE)
        )
        result, is_off = _move_drive(args, goal, drive, with_torque_range(torque_drive, node))
    _print_result(args, goal, result, is_off)
    if not is_off:
        print(DRIVE_STILL_ON_WARNING, file=sys.stderr, flush=True)
        return ExitCode.REMOVE_POWER
    return ExitCode.FAILED if result.failure else ExitCode.DONE


def _motion_goal(args: argparse.Namespace) -> JogGoal:
    """Check every number of the command line before a bus is opened. Return the requested motion.

    Raises:
        ConfigError: an argument is missing or out of range.
    """
    if args.digit is not None:
        expected = "no digit, because --mode moves one drive: name it with --protocol and --node"
        raise ConfigError(repr(args.digit), "digit", expected)
    if len(args.bus) != 1:
        raise ConfigError(", ".join(args.bus), "--bus", "one bus")
    check_bus_spec(args.bus[0])
    required_options = {"--protocol": args.protocol, "--node": args.node, "--setpoint": args.setpoint,
              "--torque-limit-Nm": args.limit}  # fmt: skip
    missing_names = [name for name, value in required_options.items() if value is None]
    if missing_names:
        raise ConfigError("nothing", missing_names[0], "a value with --mode")
    _check_number(args.limit, "--torque-limit-Nm", MIN_TORQUE_LIMIT_N_M, MAX_TORQUE_N_M)
    _check_number(args.speed_limit, "--speed-limit", 1e-2, MAX_SPEED_RANGE_RAD_S)
    _check_number(args.acceleration_limit, "--acceleration-limit", 1e-2, 1e5)
    _check_number(args.travel, "--travel", 1e-2, MAX_POSITION_RANGE_RAD)
    _check_number(args.duration, "--for", 1e-2, MAX_JOG_S)
    mode = DriveMode(args.mode)
    largest = {"N m": args.limit, "rad/s": args.speed_limit, ANGLE_UNIT: args.travel}[
        COMMAND_UNITS[mode]
    ]
    _check_number(args.setpoint, "--setpoint", -largest, largest)
    limits = MotionLimits(args.speed_limit, args.acceleration_limit)
    return JogGoal(mode, args.setpoint, args.duration, limits, args.limit, args.travel)


def _check_number(value: float, name: str, minimum: float, maximum: float) -> None:
    """Check that the value of an argument is within a range. NaN is outside every range.

    Raises:
        ConfigError: the value is outside the range.
    """
    if not minimum <= value <= maximum:
        raise ConfigError(f"{value:g}", name, f"{minimum:g} to {maximum:g}")


def _describe_motion(
    args: argparse.Namespace, options: dict[str, Any], node: DiscoveredNode | None, goal: JogGoal
) -> Drive:
    """Return the drive, configured for the mode of the requested motion.

    Raises:
        ConfigError: the protocol has no such mode or option.
    """

    def make_jog_drive(motor: Motor) -> Drive:
        if motor.protocol in ("odrive", "cia402"):
            # Drives with this drive protocol count whole turns, and report no position range.
            motor = motor.model_copy(update={"position_range_rad": MAX_POSITION_RANGE_RAD})
        if goal.mode == DriveMode.FORCE_POSITION and node and "torque_max_N_m" in node.settings:
            motor = _with_current_limit(motor, node.settings["torque_max_N_m"], goal.max_torque_N_m)
        return make_mode_drive(motor, 0, goal.mode, goal.limits)

    return describe_drive(args, options, node, make_jog_drive)


def _with_current_limit(motor: Motor, full_scale: float, torque: float) -> Motor:
    """Return the description of a Damiao motor whose commands contain the given torque limit.

    A command to a Damiao motor contains the torque limit as a fraction of the full scale.

    Args:
        motor: description of the motor.
        full_scale: value of the motor's register TMAX [N m]. The value in the register does not
            change.
        torque: torque limit [N m].
    """
    options = {"current_fraction": min(1.0, torque / full_scale), **motor.options}
    changes = {"torque_max_N_m": full_scale, "torque_peak_N_m": full_scale, "options": options}
    return motor.model_copy(update=changes)


def _torque_options(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of a drive that apply in torque mode.

    The returned options do not contain the options of the position mode and the velocity mode.
    """
    return {
        key: value
        for key, value in options.items()
        if key not in ("current_fraction", "velocity_unit")
    }


def _goal_text(goal: JogGoal) -> str:
    """Describe the motion of a drive in words."""
    motion = (
        f"{goal.mode.value} {goal.target:+g} {COMMAND_UNITS[goal.mode]} for {goal.duration_s:g} s"
    )
    return (
        f"{motion}, at most {goal.limits.speed:g} rad/s and {goal.max_travel_rad:g} rad from here"
    )


def _move_drive(
    args: argparse.Namespace, goal: JogGoal, drive: Drive, torque_drive: Drive
) -> tuple[JogResult, bool]:
    """Move a drive, and then disable it.

    Return the result, and True if the drive has confirmed that it is disabled.

    If a fault or a limit stops the motion, the drive keeps its latched fault and its mode. After a
    complete motion, the drive is in torque mode.
    """
    result: JogResult | None = None
    with open_drive_rig(args, drive) as (rig, bus):
        try:
            if args.clear:
                rig.clear_faults()
            result = jog_drive(rig, goal)
        finally:
            if result is None:
                bus.send(drive.torque_cut_frames())
            rig.idle_command = lambda state: 0.0
            is_complete = (
                result is not None and not result.failure and rig.state.phase != DrivePhase.FAULT
            )
            watchdog_s = WATCHDOG_MS / 1e3
            is_off = (
                release_drive(rig, watchdog_s, torque_drive)
                if is_complete
                else rig.confirm_disabled(watchdog_s)
            )
            # Ctrl-C or a bug has ended the motion, and this early end is reported here
            if not is_off and result is None:
                raise PowerError(DRIVE_STILL_ON_WARNING)
    return result, is_off


def _print_result(args: argparse.Namespace, goal: JogGoal, result: JogResult, is_off: bool) -> None:
    """Print the result of a motion, from the values that the drive has reported."""
    if args.json:
        values = {
            "moved_rad": result.moved_rad, "fastest_rad_s": result.max_speed_rad_s,
            "strongest_N_m": result.max_torque_N_m, "final_rad_s": result.final_speed_rad_s,
        }  # fmt: skip
        finite_values = {
            key: value if math.isfinite(value) else None for key, value in values.items()
        }
        result_text_by_kind = {
            "drive": args.protocol,
            "node": args.node,
            "mode": goal.mode.value,
            "setpoint": goal.target,
        }
        print_json(
            {
                **result_text_by_kind,
                **finite_values,
                "confirmed_off": is_off,
                "failure": result.failure,
            }
        )
        return
    max_command_text = (
        "no torque reported"
        if math.isnan(result.max_torque_N_m)
        else f"{result.max_torque_N_m:.3g} N m"
    )
    print(
        f"moved {result.moved_rad:+.3f} rad, at most {result.max_speed_rad_s:.2f} rad/s, {max_command_text}"
    )
    if result.failure:
        print(f"stopped: {result.failure}", file=sys.stderr, flush=True)
    print("off, as reported by the drive" if is_off else "NOT confirmed off")
