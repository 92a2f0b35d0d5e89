"""Options that have the same meaning in every command, and functions that print the results of commands."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from handctl.cli.console.standard_streams import has_printed_json
from handctl.cli.parsing.completion import hand_names
from handctl.drives.motor_description import PROTOCOL_TRAITS, motor_types_text
from handctl.errors import ConfigError
from handctl.hand.file.quantity_types import MAX_BITRATE_BIT_S, MIN_BITRATE_BIT_S
from handctl.printing import escape_surrogates, one_line_message
from handctl.session.default_hand import DEFAULT_HAND
from handctl.session.exit_codes import ExitCode


class _StoreHandAction(argparse.Action):
    """Argparse action for the option ``--hand``. The action also stores that the operator has named a hand."""

    def __call__(
        self, parser: Any, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        namespace.hand = values
        namespace.is_hand_named = True


def add_hand_option(parser: argparse.ArgumentParser) -> None:
    """Declare --hand: name of a packaged hand, or path of a hand file."""
    text = f"packaged hand or file (default: {DEFAULT_HAND}; needed on a real bus)"
    hand_argument = parser.add_argument(
        "--hand", action=_StoreHandAction, default=DEFAULT_HAND, metavar="NAME|FILE", help=text
    )
    hand_argument.completer = hand_names  # type: ignore[attr-defined]  # an attribute that argcomplete reads
    parser.set_defaults(is_hand_named=False)


def check_seed(seed: int) -> None:
    """Raise an error if random number generators do not accept a seed.

    Raises:
        ConfigError: the seed is negative.
    """
    if seed < 0:
        raise ConfigError(f"{seed}", "--seed", "0 or more")


def check_count(count: int, option: str, maximum: int) -> int:
    """Check a count from the command line, and return the count.

    Raises:
        ConfigError: the count is not between 1 and ``maximum``.
    """
    if not 1 <= count <= maximum:
        raise ConfigError(str(count), option, f"1 to {maximum}")
    return count


def add_protocol_option(parser: argparse.ArgumentParser, extra_help: str = "") -> None:
    """Declare --protocol and --motor-type.

    With ``--protocol``, the given protocol replaces the protocol in the hand file for all drives.
    """
    text = "drives of the simulated hand (default: as in its file)" + extra_help
    parser.add_argument("--protocol", choices=tuple(PROTOCOL_TRAITS), help=text)
    add_motor_type_option(parser)


def add_motor_type_option(parser: argparse.ArgumentParser) -> None:
    """Declare --motor-type, for the protocols whose drives do not report the type of their motor."""
    text = f"with --protocol: type of all motors ({motor_types_text()})"
    parser.add_argument("--motor-type", metavar="TYPE", help=text)


def add_bus_option(parser: argparse.ArgumentParser, required: bool = True) -> None:
    """Declare --bus.

    For a hand with several buses, the user gives one ``--bus NAME=SPEC`` for each bus.
    """
    parser.add_argument(
        "--bus",
        action="append",
        required=required,
        metavar="[NAME=]SPEC",
        help="local:NAME, socketcan:can0 or any python-can interface:channel; for several buses, repeat as NAME=SPEC",
    )


def add_bitrate_options(
    parser: argparse.ArgumentParser, bitrate_help: str, data_bitrate_help: str
) -> None:
    """Declare --bitrate and --data-bitrate, with their help texts."""
    add_argument = parser.add_argument
    add_argument(
        "--bitrate",
        type=_bit_rate_from_text,
        default=1_000_000,
        metavar="BIT/S",
        help=f"{bitrate_help} (1000000)",
    )
    add_argument(
        "--data-bitrate", type=_bit_rate_from_text, metavar="BIT/S", help=data_bitrate_help
    )


def _bit_rate_from_text(rate_text: str) -> int:
    """Return a bit rate from the command line [bit/s].

    The bit rate must be a value that a hand file could contain.
    """
    rate = int(rate_text)
    if not MIN_BITRATE_BIT_S <= rate <= MAX_BITRATE_BIT_S:
        raise argparse.ArgumentTypeError(
            f"{rate_text}; expected {MIN_BITRATE_BIT_S} to {MAX_BITRATE_BIT_S} bit/s"
        )
    return rate


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Declare --json.

    With ``--json``, standard output contains the result as JSON and no other text.
    """
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON on standard output"
    )


def add_dry_run_option(parser: argparse.ArgumentParser) -> None:
    """Declare --dry-run. With ``--dry-run``, a command checks all its inputs, but opens no bus."""
    parser.add_argument(
        "--dry-run", action="store_true", help="check all files and the bus load, open no bus"
    )


def add_run_options(parser: argparse.ArgumentParser, is_bus_required: bool = True) -> None:
    """Declare the options of all commands that run a controller."""
    add_hand_option(parser)
    add_bus_option(parser, is_bus_required)
    add_json_option(parser)
    add_dry_run_option(parser)
    add_clear_option(parser)
    add_gains_options(parser)
    add_rate_option(parser)
    text = "calibration file (default: HAND.calibration.toml)"
    parser.add_argument("--calibration", type=Path, metavar="FILE", help=text)
    parser.add_argument(
        "--log", type=Path, metavar="FILE", help="log to write (default: logs/DATE-HAND.mcap)"
    )
    add_yes_option(parser)
    add_time_scale_option(parser)


def add_rate_option(parser: argparse.ArgumentParser) -> None:
    """Declare --rate, the control rate of a run."""
    parser.add_argument(
        "--rate",
        type=float,
        metavar="HZ",
        help="control rate (default: computed from the bus load)",
    )


def add_clear_option(parser: argparse.ArgumentParser) -> None:
    """Declare --clear, which clears the latched faults of the drives before arming."""
    text = "clear latched faults of the drives before arming; find the cause first"
    parser.add_argument("--clear", action="store_true", help=text)


def add_jobs_option(parser: argparse.ArgumentParser, default: int | None, text: str) -> None:
    """Declare --jobs: number of parallel processes.

    Args:
        parser: parser of a command.
        default: default number of processes. None stands for one process per processor core.
        text: help text without the default.
    """
    default_text = "one per core" if default is None else str(default)
    parser.add_argument(
        "--jobs", type=int, default=default, metavar="N", help=f"{text} (default: {default_text})"
    )


def add_output_option(
    parser: argparse.ArgumentParser, text: str, metavar: str = "FILE", *, required: bool = False
) -> None:
    """Declare --output, the file or folder to which the command writes its result."""
    parser.add_argument("--output", type=Path, metavar=metavar, help=text, required=required)


def add_perturb_option(parser: argparse.ArgumentParser) -> None:
    """Declare --perturb.

    With ``--perturb``, values of the hand file are multiplied by factors, and the simulated hand
    uses the products.
    """
    text = "change parameters of the simulated hand, e.g. stiffness=0.8 friction=1.3 (python -m firmware_sim --help)"
    parser.add_argument(
        "--perturb", nargs="+", action="extend", default=[], metavar="KEY=FACTOR", help=text
    )


def perturb_arguments(args: argparse.Namespace) -> list[str]:
    """Return the command-line words that pass the factors of --perturb to the simulator."""
    return ["--perturb", *args.perturb] if args.perturb else []


def add_yes_option(parser: argparse.ArgumentParser) -> None:
    """Declare --yes, which lets a hand move without a question to the operator."""
    text = "do not ask for permission before the hand moves on a real bus"
    parser.add_argument("--yes", action="store_true", help=text)


def add_time_scale_option(
    parser: argparse.ArgumentParser,
    default: float | None = None,
    default_text: str = "that of the simulator on the bus, otherwise 1",
) -> None:
    """Declare --time-scale, the ratio of simulated time to real time.

    Args:
        parser: parser of a command.
        default: value of the time scale if the option is not given.
        default_text: description of the default value for the help text.
    """
    text = f"simulated time per wall time (default: {default_text})"
    parser.add_argument("--time-scale", type=float, default=default, metavar="X", help=text)


def add_gains_options(parser: argparse.ArgumentParser) -> None:
    """Declare --gains and --gain."""
    parser.add_argument(
        "--gains",
        type=Path,
        metavar="FILE",
        help="gains file (default: HAND.gains.toml, else the default gains of the hand)",
    )
    parser.add_argument(
        "--gain",
        action="append",
        metavar="KEY=VALUE",
        help="value of one gain, which replaces the value of the gains file; may be repeated",
    )


def print_escaped(text: str, error: bool = False) -> None:
    """Print a line that contains text from a file, and escape the control characters in the line."""
    print(one_line_message(text), file=sys.stderr if error else sys.stdout)


def warn_if_lossy(path: Path, warning: str) -> ExitCode:
    """Warn if a log is incomplete.

    Return the exit code of a command that could read only a part of a log.
    """
    if warning:
        print_escaped(f"handctl: {path}: {warning}", error=True)
    return ExitCode.LOSSY_LOG if warning else ExitCode.DONE


def add_wire_option(parser: argparse.ArgumentParser) -> None:
    """Declare --wire.

    With ``--wire``, each simulated frame takes as long as a frame on a real bus.
    """
    text = "the simulated bus has a bit rate, queues and errors; e.g. --wire queue=10 (python -m firmware_sim --help)"
    parser.add_argument("--wire", nargs="*", metavar="KEY=VALUE", help=text)


def wire_arguments(args: argparse.Namespace) -> list[str]:
    """Return the command-line words that pass the values of --wire to the simulator."""
    return [] if args.wire is None else ["--wire", *args.wire]


def print_json(result: dict[str, Any]) -> None:
    """Print the result of a command as JSON. A NaN in the result becomes null."""
    has_printed_json.set(True)
    text = json.dumps(_json_value(result), indent=2, allow_nan=False)
    sys.stdout.write(
        text.replace("\x7f", "\\u007f") + "\n"
    )  # the conversion to JSON leaves the control character DEL unescaped


def print_json_line(result: dict[str, Any]) -> None:
    """Print a result as one line of JSON, without buffering.

    Commands that report results before the end of the command use this function. A NaN becomes
    null.
    """
    has_printed_json.set(True)
    text = json.dumps(_json_value(result), allow_nan=False)
    sys.stdout.write(text.replace("\x7f", "\\u007f") + "\n")
    sys.stdout.flush()


def _json_value(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            escape_surrogates(str(key)): _json_value(member_value)
            for key, member_value in value.items()
        }
    if isinstance(value, list | tuple):
        return [_json_value(element) for element in value]
    if isinstance(value, float) and not (value == value and abs(value) != float("inf")):
        return None
    return escape_surrogates(str(value)) if isinstance(value, Path | str) else value
