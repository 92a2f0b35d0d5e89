"""Declaration of the command-line arguments of the commands in the folder ``cli/runs``.

The code of a command is imported only when that command runs. Because the code of commands is
imported late, help texts appear fast.
"""

import argparse
from pathlib import Path

from handctl.cli.console.options import (
    add_bitrate_options,
    add_bus_option,
    add_dry_run_option,
    add_gains_options,
    add_hand_option,
    add_json_option,
    add_perturb_option,
    add_protocol_option,
    add_rate_option,
    add_run_options,
    add_time_scale_option,
    add_wire_option,
)
from handctl.cli.parsing.parser import RUN_COMMAND_EXAMPLE, SIMULATED_HAND, CommandExample
from handctl.drives.drive_modes import DriveMode
from handctl.drives.motor_description import PROTOCOL_TRAITS

COMMAND_EXAMPLES = {
    "demo": CommandExample("handctl demo --lockstep"),
    "run": CommandExample("handctl run --hand jamia --bus local:demo --task grasp.toml --dry-run"),
    "stop": CommandExample("handctl stop --bus local:demo", (SIMULATED_HAND, RUN_COMMAND_EXAMPLE)),
    "clear": CommandExample(
        "handctl clear --bus local:demo", (SIMULATED_HAND, RUN_COMMAND_EXAMPLE)
    ),
    "commission": CommandExample("handctl commission --hand jamia --bus local:demo --dry-run"),
    "jog": CommandExample("handctl jog index --tension 8 --hand jamia --bus local:demo --dry-run"),
    "sim": CommandExample("handctl sim --hand jamia --bus local:demo --scene cylinder --dry-run"),
}
"""Example command line that the help of each command prints."""
DRIVE_EXAMPLE = (
    "One drive on a bench, as in: handctl jog --mode velocity --setpoint 2 --protocol mit --node 1"
    " --torque-limit-Nm 0.5 --bus socketcan:can0"
)
"""Help text about the options of ``jog`` that move a single drive."""


def demo(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``demo``."""
    add_hand_option(parser)
    add_protocol_option(parser)
    add_json_option(parser)
    add_dry_run_option(parser)
    text = "task (default: grasp.toml, or for a hand of other digits a task that closes, holds and opens)"
    parser.add_argument("--task", type=Path, metavar="FILE", help=text)
    text = "object to grasp (default: a cylinder of a size that suits the hand)"
    parser.add_argument("--scene", metavar="NAME|FILE", help=text)
    parser.add_argument("--seed", type=int, default=0, help="random seed of the simulator's noise")
    add_wire_option(parser)
    add_gains_options(parser)
    add_rate_option(parser)
    text = "simulate in virtual time: faster than real time, with the same result each time"
    parser.add_argument("--lockstep", action="store_true", help=text)
    parser.add_argument(
        "--log", type=Path, metavar="FILE", help="log to write (default: logs/DATE-HAND.mcap)"
    )
    parser.add_argument("--view", action="store_true", help="show the run live in Rerun")
    add_time_scale_option(parser, 1.0, "1")
    _strict_clock_option(parser)
    add_perturb_option(parser)
    text = "use the identified values of this file; the simulated hand is commissioned nevertheless"
    parser.add_argument("--calibration", type=Path, metavar="FILE", help=text)
    parser.set_defaults(clear=False)


def run(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``run``."""
    add_run_options(parser)
    program_group = parser.add_mutually_exclusive_group()
    program_group.add_argument(
        "--trajectory", type=Path, metavar="FILE", help="trajectory file: angles over time"
    )
    program_group.add_argument(
        "--task",
        type=Path,
        metavar="FILE",
        help="task file; without one the hand waits for requests",
    )
    program_group.add_argument(
        "--dataset", type=Path, metavar="DIR", help="LeRobot dataset (3.0): follow its joint angles"
    )
    parser.add_argument(
        "--episode", type=int, metavar="N", help="episode of --dataset (default: 0)"
    )
    text = "limit the joint speed of --dataset: jumps become ramps (default: a jump is refused)"
    parser.add_argument("--speed", type=float, metavar="DEG_S", help=text)
    text = "file with the true state of the simulator (default: that of the simulator on the bus)"
    parser.add_argument("--truth", type=Path, metavar="FILE", help=text)
    parser.add_argument("--view", action="store_true", help="show the run live in Rerun")
    text = "stop when standard input ends, so that the hand stops if the program that started handctl dies"
    parser.add_argument("--until-eof", action="store_true", help=text)


def stop(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``stop``."""
    add_bus_option(parser)
    add_json_option(parser)
    parser.add_argument(
        "--cut", action="store_true", help="remove the torque at once, without a ramp"
    )


def clear(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``clear``."""
    add_bus_option(parser)
    add_json_option(parser)


def commission(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``commission``."""
    add_run_options(parser)


def jog(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``jog``."""
    add_run_options(parser)
    parser.add_argument(
        "digit", nargs="?", help="the digit to move, or with --angle a joint such as index_j1"
    )
    goal = parser.add_mutually_exclusive_group(required=True)
    goal.add_argument(
        "--tension", type=float, metavar="N", help="hold this tension in each tendon of the digit"
    )
    goal.add_argument("--angle", type=float, metavar="DEG", help="move to this joint angle")
    text = "move one drive on a bench instead of a digit, without a hand file: quantity that the drive controls"
    goal.add_argument("--mode", choices=[mode.value for mode in DriveMode], help=text)
    text = "duration of the motion (default: 2)"
    parser.add_argument("--for", dest="duration", type=float, default=2.0, metavar="S", help=text)
    _add_drive_options(parser.add_argument_group("with --mode", DRIVE_EXAMPLE))
    add_bitrate_options(
        parser, "with --mode: bit rate of the bus", "bit rate of CAN FD's data phase"
    )


def _add_drive_options(group: argparse._ArgumentGroup) -> None:
    """Declare the options of ``jog`` for one drive on a bench."""
    add_argument = group.add_argument
    add_argument("--protocol", choices=sorted(PROTOCOL_TRAITS), help="protocol of the drive")
    add_argument(
        "--node", type=lambda word: int(word, 0), metavar="N", help="number of the drive on the bus"
    )
    text = "torque [N m], velocity [rad/s], or position relative to the present position [rad]"
    add_argument("--setpoint", type=float, metavar="X", help=text)
    text = "largest commanded torque [N m]; it is also the limit that the drive gets"
    add_argument("--torque-limit-Nm", type=float, metavar="X", dest="limit", help=text)
    text = (
        "largest speed [rad/s]; also the limit of the drive if the drive has the mode (default: 5)"
    )
    add_argument("--speed-limit", type=float, default=5.0, metavar="X", help=text)
    text = "largest acceleration [rad/s2] of the ramps (default: 10)"
    add_argument("--acceleration-limit", type=float, default=10.0, metavar="X", help=text)
    text = "largest distance from the start [rad]; beyond it the drive is stopped (default: 20)"
    add_argument("--travel", type=float, default=20.0, metavar="X", help=text)
    text = "option of the drive, as in [motor.options] of a hand file; may be repeated"
    add_argument("--option", action="append", default=[], metavar="KEY=VALUE", help=text)


def sim(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``sim``."""
    add_hand_option(parser)
    add_protocol_option(parser, "; writes HAND-PROTOCOL.toml for --hand of the controller")
    add_bus_option(parser)
    add_json_option(parser)
    text = "check the arguments, print the command of the simulator, and exit"
    parser.add_argument("--dry-run", action="store_true", help=text)
    text = (
        "cylinder, sphere, box, none, or a scene file (default: a cylinder of a size that suits the hand; "
        "it blocks the digits)"
    )
    parser.add_argument("--scene", help=text)
    parser.add_argument("--seed", type=int, default=0, help="random seed of the simulator's noise")
    add_perturb_option(parser)
    text = "serial number of one simulated motor, or a base to which each drive adds its number on the bus"
    parser.add_argument(
        "--serial", action="append", default=[], metavar="[MOTOR=]NUMBER", help=text
    )
    add_wire_option(parser)
    add_time_scale_option(parser, 1.0, "1")
    _strict_clock_option(parser)


def _strict_clock_option(parser: argparse.ArgumentParser) -> None:
    """Declare --strict-clock."""
    text = "never pause the clock of a simulated hand: on a slow machine ticks and answers are late, as on a real bus"
    parser.add_argument("--strict-clock", action="store_true", help=text)
