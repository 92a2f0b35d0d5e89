"""Declaration of the command-line arguments of the commands in the folder ``cli/checks``.

The code of a command is imported only when that command runs. Because the code of commands is
imported late, help texts appear fast.
"""

import argparse
from pathlib import Path

from handctl.cli.console.options import (
    add_bitrate_options,
    add_bus_option,
    add_gains_options,
    add_hand_option,
    add_json_option,
    add_motor_type_option,
    add_output_option,
    add_time_scale_option,
)
from handctl.cli.parsing.completion import hand_names
from handctl.cli.parsing.parser import SIMULATED_HAND, CommandExample, VerbParser, add_sub_verb
from handctl.drives.motor_description import PROTOCOL_TRAITS, motor_types_text

COMMAND_EXAMPLES = {
    "config": CommandExample("handctl config show --hand jamia"),
    "config show": CommandExample("handctl config show --hand jamia"),
    "config check": CommandExample(
        "handctl config check --hand jamia --task grasp.toml --scene cylinder:35"
    ),
    "config list": CommandExample("handctl config list"),
    "config schema": CommandExample("handctl config schema | tee hand.schema.json"),
    "config init": CommandExample(
        "handctl config init --yes --fingers 1 --opposed 1 --output mine.toml"
    ),
    "config convert": CommandExample(
        "handctl config show --hand jamia > old.toml; handctl config convert old.toml --output new.toml"
    ),
    "config export": CommandExample("handctl config export --hand jamia --dbc"),
    "bus": CommandExample("handctl bus plan --hand jamia11 --rate 200"),
    "bus plan": CommandExample("handctl bus plan --hand jamia11 --rate 200"),
    "bus up": CommandExample("handctl bus up --hand jamia --bus socketcan:vcan0"),
    "bus doctor": CommandExample(
        "handctl bus doctor --hand jamia --bus local:demo", (SIMULATED_HAND,)
    ),
    "bus watch": CommandExample(
        "handctl bus watch --hand jamia --bus local:demo --for 2", (SIMULATED_HAND,)
    ),
    "scan": CommandExample("handctl scan --bus socketcan:can0 --dry-run"),
    "conformance": CommandExample(
        "handctl conformance --protocol odrive --node 3 --bus socketcan:can0 --torque-limit-Nm 0.1 --dry-run"
    ),
    "doctor": CommandExample("handctl doctor"),
}
"""Example command line that the help of each command and subcommand prints."""


def config(parser: VerbParser) -> None:
    """Declare the arguments of ``config``."""
    subparsers = parser.add_subparsers(
        dest="what", required=True, metavar="init|show|check|list|schema|convert|export"
    )

    def add_config_verb(name: str, text: str) -> VerbParser:
        subparser = add_sub_verb(subparsers, name, text, COMMAND_EXAMPLES[f"config {name}"])
        add_json_option(subparser)
        if name not in ("init", "list", "schema", "convert"):
            add_hand_option(subparser)
        return subparser

    _add_init_options(
        add_config_verb(
            "init", "write a new hand file from a few answers, or from a robot description"
        )
    )
    show_parser = add_config_verb("show", "show a hand, and the source of each value")
    text = "draw digits, tendons, spools, sensors and buses instead: as text, or as a picture with --output"
    show_parser.add_argument("--graph", action="store_true", help=text)
    add_output_option(show_parser, "picture of --graph: a new .svg, .png or .pdf")
    _add_file_arguments(show_parser)
    check_parser = add_config_verb("check", "check a hand with its files")
    _add_file_arguments(check_parser)
    text = "scene to check with the simulated hand, as in demo: cylinder:40, or a scene file"
    check_parser.add_argument("--scene", metavar="NAME|FILE", help=text)
    add_config_verb("list", "list the packaged hands and tasks")
    schema_parser = add_config_verb(
        "schema", "print the JSON Schema of hand files, for completion in an editor"
    )
    add_output_option(schema_parser, "a new file (default: standard output)")
    convert_parser = add_config_verb(
        "convert", "write a hand file of schema 1 as schema 2: repeated values once, comments kept"
    )
    convert_parser.add_argument("old", type=Path, metavar="OLD", help="hand file of schema 1")
    add_output_option(convert_parser, "a new file", required=True)
    export_parser = add_config_verb(
        "export", "write the buses or the links of a hand for other tools"
    )
    format_group = export_parser.add_mutually_exclusive_group()
    format_group.add_argument(
        "--dbc", action="store_true", help="the frames of each bus, as a CAN database"
    )
    format_group.add_argument(
        "--urdf", action="store_true", help="links and joints, for ROS and pinocchio"
    )
    format_group.add_argument(
        "--mjcf", action="store_true", help="links, joints, springs and tendons, for MuJoCo"
    )
    add_output_option(export_parser, "a new file (default: HAND.dbc, HAND.urdf, HAND.xml)")


def _add_init_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``config init``.

    Each option answers one of the questions about the new hand.
    """
    add_output_option(parser, "a new hand file", required=True)
    source = parser.add_mutually_exclusive_group()
    text = "take links, joints and inertia from {}; questions ask for the tendons, or the file marks them as 'TODO'"
    source.add_argument(
        "--urdf", type=Path, metavar="FILE", help=text.format("a robot description")
    )
    source.add_argument(
        "--mjcf",
        type=Path,
        metavar="FILE",
        help=text.format("a model of MuJoCo, and its moment arms"),
    )
    add_argument = parser.add_argument
    add_argument(
        "--yes",
        action="store_true",
        help="do not ask: options that are not given have their default, or 'TODO'",
    )
    add_argument("--name", help="name of the hand (default: mine)")
    add_argument("--fingers", type=int, metavar="N", help="digits on one side (default: 2)")
    add_argument(
        "--opposed",
        type=int,
        metavar="N",
        help="digits, such as a thumb, that close against the fingers (default: 1; "
        "the smallest hand that grasps: --fingers 1 --opposed 1)",
    )
    add_argument(
        "--links",
        type=_parse_lengths,
        dest="links_mm",
        metavar="MM,MM",
        help="length of each link (default: 40,30)",
    )
    add_argument(
        "--width",
        type=float,
        dest="width_mm",
        metavar="MM",
        help="width of the links (default: 12)",
    )
    text = "distance between the two sides (default: computed from the links)"
    add_argument("--palm", type=float, dest="palm_mm", metavar="MM", help=text)
    add_argument(
        "--tendons",
        choices=("one", "each"),
        help="one tendon per digit, or one for each joint (default: one)",
    )
    text = "moment arm at the joints (default: computed from the links)"
    add_argument("--pulley", type=float, dest="pulley_mm", metavar="MM", help=text)
    add_argument(
        "--spool",
        type=float,
        dest="spool_mm",
        metavar="MM",
        help="radius of the spools (default: 8)",
    )
    add_argument(
        "--tension",
        type=float,
        dest="tension_N",
        metavar="N",
        help="largest commanded tension (default: 80)",
    )
    add_argument(
        "--strength",
        type=float,
        dest="strength_N",
        metavar="N",
        help="breaking force of the tendons (default: 600)",
    )
    text = "protocol of the drives (default: mit)"
    add_argument("--protocol", choices=tuple(PROTOCOL_TRAITS), help=text)
    add_motor_type_option(parser)
    import_default_text = "with --urdf or --mjcf 'TODO'"
    add_argument(
        "--cells",
        choices=("all", "none"),
        help=f"tendons that have a load cell (default: all, {import_default_text})",
    )
    add_argument(
        "--encoders",
        choices=("all", "none"),
        help=f"joints that have an encoder (default: none, {import_default_text})",
    )
    text = "joints that have a return spring; without springs, a further tendon opens each digit"
    add_argument(
        "--springs", choices=("all", "none"), help=f"{text} (default: all, {import_default_text})"
    )
    add_argument(
        "--first-node",
        type=int,
        metavar="N",
        help="with --urdf or --mjcf: node number of the first drive of a bus (default: 'TODO')",
    )


def _parse_lengths(text: str) -> tuple[float, ...]:
    """Parse a text such as ``40,30``, and return the lengths [mm]."""
    return tuple(float(length_text) for length_text in text.split(","))


def _add_file_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that name the files of a hand."""
    parser.add_argument(
        "--task", type=Path, metavar="FILE", help="task file to check with the hand"
    )
    add_gains_options(parser)
    text = "calibration file to check (default: HAND.calibration.toml)"
    parser.add_argument("--calibration", type=Path, metavar="FILE", help=text)


def bus(parser: VerbParser) -> None:
    """Declare the arguments of ``bus``.

    The subcommand ``watch`` polls the drives, but never enables a drive.
    """
    subparsers = parser.add_subparsers(dest="what", required=True, metavar="plan|doctor|up|watch")
    text = "compute the worst-case load of each bus of a hand, stuff bits included"
    plan_parser = add_sub_verb(subparsers, "plan", text, COMMAND_EXAMPLES["bus plan"])
    text = "check buses from the interface to the drives, and name the command that repairs each finding"
    bus_doctor_parser = add_sub_verb(subparsers, "doctor", text, COMMAND_EXAMPLES["bus doctor"])
    text = "print the commands that set up the interfaces of a hand, or run them (--yes, as root)"
    bus_up_parser = add_sub_verb(subparsers, "up", text, COMMAND_EXAMPLES["bus up"])
    text = "show angle, velocity, temperature and tension of every drive and load cell live, without torque"
    watch_parser = add_sub_verb(subparsers, "watch", text, COMMAND_EXAMPLES["bus watch"])
    defaults = (
        (plan_parser, "jamia"),
        (bus_doctor_parser, "none"),
        (bus_up_parser, "none"),
        (watch_parser, "jamia on a simulated bus"),
    )
    for subcommand, default in defaults:
        bus_argument = subcommand.add_argument(
            "--hand", metavar="NAME|FILE", help=f"packaged hand or file (default: {default})"
        )
        bus_argument.completer = hand_names  # type: ignore[attr-defined]  # an attribute that argcomplete reads
        add_bus_option(subcommand, required=False)
        add_json_option(subcommand)
    text = "control rate (default: the highest at which no bus is overloaded)"
    plan_parser.add_argument("--rate", type=float, metavar="HZ", help=text)
    plan_parser.add_argument(
        "--table", action="store_true", help="compare the protocols, without a hand"
    )
    for subcommand in (bus_doctor_parser, bus_up_parser):
        add_bitrate_options(
            subcommand,
            "without a hand: bit rate of the bus",
            "without a hand: bit rate of CAN FD's data phase",
        )
    bus_up_parser.add_argument(
        "--yes", action="store_true", help="run the commands now; needs root"
    )
    text = "end after this time (default: Ctrl-C)"
    watch_parser.add_argument("--for", dest="duration", type=float, metavar="S", help=text)
    add_time_scale_option(watch_parser)


def scan(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``scan``."""
    add_bus_option(parser)
    add_json_option(parser)
    parser.add_argument(
        "--dry-run", action="store_true", help="print every frame that may be sent, open no bus"
    )
    text = "send requests even if another host seems to control the bus"
    parser.add_argument("--force", action="store_true", help=text)
    add_bitrate_options(
        parser, "bit rate of the buses", "bit rate of CAN FD's data phase, for the printed fragment"
    )


def conformance(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``conformance``."""
    add_argument = parser.add_argument
    add_argument(
        "--protocol", required=True, choices=sorted(PROTOCOL_TRAITS), help="protocol of the drive"
    )
    add_argument(
        "--node",
        required=True,
        type=lambda word: int(word, 0),
        metavar="N",
        help="number of the drive on the bus",
    )
    add_argument(
        "--bus",
        required=True,
        metavar="SPEC",
        help="local:NAME, socketcan:can0 or any python-can interface:channel",
    )
    add_argument("--torque-limit-Nm", required=True, type=float, metavar="X", dest="limit",
        help="largest commanded torque at the drive's shaft; it is also the limit that the drive gets")  # fmt: skip
    add_argument(
        "--yes",
        action="store_true",
        help="confirm that the shaft may turn: hands and cables are away from it",
    )
    text = (
        "option of the drive, as in [motor.options] of a hand file; may be repeated; "
        f"required: motor_type=TYPE ({motor_types_text()})"
    )
    add_argument("--option", action="append", default=[], metavar="KEY=VALUE", help=text)
    add_bitrate_options(parser, "bit rate of the bus", "bit rate of CAN FD's data phase")
    add_json_option(parser)
    parser.add_argument(
        "--dry-run", action="store_true", help="print what would be checked, open no bus"
    )


def doctor(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``doctor``."""
    add_json_option(parser)
