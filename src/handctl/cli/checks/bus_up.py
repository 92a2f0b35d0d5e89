"""``handctl bus up``: print or run the system commands that set up the CAN interfaces of a hand."""

import argparse
import os
import shlex
import subprocess

from handctl.cli.console.options import print_json
from handctl.errors import BusError, ConfigError
from handctl.hand.file.section_models import Bus as BusSection
from handctl.hand.hand_loading import load_hand
from handctl.runtime.buses.interface_setup import (
    CommandWords,
    interface_names,
    interface_setup_commands,
)
from handctl.session.buses import parse_bus_arguments
from handctl.session.exit_codes import ExitCode

COMMAND_TIMEOUT_S = 10.0
"""Longest time that one of the system commands is allowed to take [s]."""


def run(args: argparse.Namespace) -> int:
    """Print the system commands that set up each CAN interface.

    With ``--yes``, run the system commands as root instead of printing them.
    """
    if not args.bus:
        raise ConfigError("missing", "--bus", "the interfaces, such as --bus socketcan:can0")
    commands = [
        command for spec, section in _bus_rates(args) for command in _commands_of_bus(spec, section)
    ]
    if args.yes:
        _check_root_user(commands)
        for command in commands:
            _run_command(command)
    lines = [("" if args.yes else "sudo ") + shlex.join(command) for command in commands]
    if args.json:
        print_json({"commands": [list(command) for command in commands], "done": args.yes})
    else:
        print("\n".join(lines))
    return ExitCode.DONE


def _bus_rates(args: argparse.Namespace) -> tuple[tuple[str, BusSection], ...]:
    """Return each bus with its bit rates, which come from the hand file or from the options."""
    if args.hand:
        from handctl.session.run_plan import bus_specs

        hand = load_hand(args.hand)
        return tuple(zip(bus_specs(hand, args.bus), hand.bus, strict=True))
    rates = {"bitrate": args.bitrate, "data_bitrate": args.data_bitrate}
    bus_specs_by_name = parse_bus_arguments(args.bus)
    return tuple((spec, BusSection(name=name, **rates)) for name, spec in bus_specs_by_name.items())


def _commands_of_bus(spec: str, section: BusSection) -> tuple[CommandWords, ...]:
    """Return the system commands that set up the CAN interface of one bus.

    Raises:
        BusError: the bus is not a SocketCAN interface, or it is a hardware interface that does not
            exist.
    """
    kind, _, channel = spec.partition(":")
    if kind != "socketcan":
        expected_text = "socketcan:NAME; others are set up when opened"
        raise BusError("has no interface to set up", spec, expected_text)
    exists = channel in interface_names()
    if not exists and not channel.startswith("vcan"):
        raise BusError(
            "no such interface",
            spec,
            f"an adapter that is plugged in; handctl bus doctor --bus {spec}",
        )
    return interface_setup_commands(channel, section.bitrate, section.data_bitrate, exists)


def _check_root_user(commands: list[CommandWords]) -> None:
    """Raise an error if --yes is given but the user is not allowed to set up an interface.

    Raises:
        BusError: the user is not root.
    """
    if os.geteuid():
        text = "; ".join(shlex.join(command) for command in commands)
        raise BusError(
            "only root can set up an interface",
            "--yes",
            f"sudo handctl bus up ..., or: {text}",
        )


def _run_command(command: CommandWords) -> None:
    """Run one system command that sets up an interface.

    Raises:
        BusError: the command fails.
    """
    text = shlex.join(command)
    try:
        process_result = subprocess.run(
            command, capture_output=True, text=True, timeout=COMMAND_TIMEOUT_S
        )
    except (FileNotFoundError, subprocess.TimeoutExpired) as error:
        raise BusError(f"does not run: {error}", text, "sudo apt-get install iproute2") from None
    if process_result.returncode:
        reason = " ".join((process_result.stderr or process_result.stdout).split())
        expected_text = "an interface of the kernel, and its driver's bit rates"
        raise BusError(f"failed: {reason}", text, expected_text)
