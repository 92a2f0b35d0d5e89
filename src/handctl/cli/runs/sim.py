"""``handctl sim``: start a simulated hand, with the same effect as ``python -m firmware_sim``."""

import argparse
import os
import subprocess
import sys

from handctl.cli.console.options import (
    perturb_arguments,
    print_json,
    wire_arguments,
)
from handctl.cli.runs.protocol_hand_file import (
    path_of_protocol_hand_file,
    use_protocol_hand_file,
    write_protocol_hand,
)
from handctl.drives.motor_description import check_protocol_given
from handctl.hand.hand_loading import load_hand
from handctl.session.gains import gain_assignments
from handctl.session.task_loading import scene_for_hand


def run(args: argparse.Namespace) -> int:
    """Replace this process by the process of the simulator."""
    args.scene = scene_for_hand(args.scene, load_hand(args.hand))
    if args.dry_run:
        return _print_simulator_command(args)
    check_protocol_given(args.protocol, args.motor_type)
    if args.protocol:
        args.hand = str(write_protocol_hand(args))
    return os.execv(sys.executable, _simulator_command(args, args.hand))


def _simulator_command(args: argparse.Namespace, hand: str) -> list[str]:
    """Return the command that starts the simulator with a hand file."""
    command = [sys.executable, "-m", "firmware_sim", "--hand", hand, "--scene", args.scene]
    command += ["--seed", str(args.seed), "--time-scale", str(args.time_scale)]
    command += ["--strict-clock"] * args.strict_clock
    for bus in args.bus:
        command += ["--bus", bus]
    gain_assignments(args.perturb, "--perturb")
    command += [word for serial in args.serial for word in ("--serial", serial)]
    return command + wire_arguments(args) + perturb_arguments(args) + ["--json"] * args.json


def _print_simulator_command(args: argparse.Namespace) -> int:
    """Check the arguments, print the command that starts the simulator, and return the exit code."""
    from handctl.session.run_plan import bus_specs

    command = _simulator_command(
        args, str(path_of_protocol_hand_file(args)) if args.protocol else args.hand
    )
    with use_protocol_hand_file(args):
        bus_specs(load_hand(args.hand), args.bus)
        process_result = subprocess.run(
            [*_simulator_command(args, args.hand), "--dry-run"],
            stdin=subprocess.DEVNULL,
            check=False,
        )
    if process_result.returncode:
        return process_result.returncode
    if args.json:
        print_json({"command": ["python", *command[1:]]})
    else:
        print(" ".join(["python", *command[1:]]))
    return 0
