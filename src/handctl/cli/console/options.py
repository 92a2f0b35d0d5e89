"""Options that mean the same in every verb."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from handctl.cli.parsing.completion import hand_names
from handctl.errors import ConfigError
from handctl.hand.file.quantities import FASTEST_BUS, SLOWEST_BUS
from handctl.printing import encodable, message
from handctl.session.defaults import DEFAULT_HAND
from handctl.session.exit_codes import Exit

PROTOCOLS = ("mit", "odrive", "cia402")
"""What simulated drives may speak."""
DRIVE_PROTOCOLS = (*PROTOCOLS, "cubemars")
"""What drives may speak; the names of ``drives.registry``, which takes longer to import than a help may take."""


class _Named(argparse.Action):
    """Stores a hand, and that somebody has named it."""

    def __call__(self, parser: Any, namespace: argparse.Namespace, values: Any, option: str | None = None) -> None:
        namespace.hand = values
        namespace.hand_named = True


def hand_option(parser: argparse.ArgumentParser) -> None:
    """--hand: a packaged hand or a file."""
    text = f"packaged hand or file (default: {DEFAULT_HAND}; needed on a real bus)"
    named = parser.add_argument("--hand", action=_Named, default=DEFAULT_HAND, metavar="NAME|FILE", help=text)
    named.completer = hand_names  # type: ignore[attr-defined]  # an attribute that argcomplete reads
    parser.set_defaults(hand_named=False)


def check_seed(seed: int) -> None:
    """Refuse a seed that no generator takes.

    Raises:
        ConfigError: below 0.
    """
    if seed < 0:
        raise ConfigError(f"{seed}", "--seed", "0 or more")


def checked_count(number: int, option: str, maximum: int) -> int:
    """A count from the command line.

    Raises:
        ConfigError: it is not between 1 and ``maximum``.
    """
    if not 1 <= number <= maximum:
        raise ConfigError(str(number), option, f"1 to {maximum}")
    return number


def protocol_option(parser: argparse.ArgumentParser, more: str = "") -> None:
    """--protocol: the same hand with other drives."""
    text = "drives of the simulated hand (default: as in its file)" + more
    parser.add_argument("--protocol", choices=PROTOCOLS, help=text)


def bus_option(parser: argparse.ArgumentParser, required: bool = True) -> None:
    """--bus: one specification, or NAME=SPEC repeated for a hand on several buses."""
    parser.add_argument(
        "--bus",
        action="append",
        required=required,
        metavar="[NAME=]SPEC",
        help="local:NAME, socketcan:can0 or any python-can interface:channel; repeat as NAME=SPEC for several buses",
    )


def bitrate_options(parser: argparse.ArgumentParser, nominal: str, data: str) -> None:
    """--bitrate and --data-bitrate, with what they are said to be of."""
    add = parser.add_argument
    add("--bitrate", type=_bit_rate, default=1_000_000, metavar="BIT/S", help=f"{nominal} (1000000)")
    add("--data-bitrate", type=_bit_rate, metavar="BIT/S", help=data)


def _bit_rate(word: str) -> int:
    """A bit rate that a hand file can have, too [bit/s]."""
    rate = int(word)
    if not SLOWEST_BUS <= rate <= FASTEST_BUS:
        raise argparse.ArgumentTypeError(f"{word}; expected {SLOWEST_BUS} to {FASTEST_BUS} bit/s")
    return rate


def json_option(parser: argparse.ArgumentParser) -> None:
    """--json: machine-readable output on stdout, nothing else there."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON on standard output")


def dry_run_option(parser: argparse.ArgumentParser) -> None:
    """--dry-run: check everything that can be checked without opening a bus."""
    parser.add_argument("--dry-run", action="store_true", help="check all files and the bus load, open no bus")


def run_options(parser: argparse.ArgumentParser, bus_required: bool = True) -> None:
    """Options of the verbs that run the controller."""
    hand_option(parser)
    bus_option(parser, bus_required)
    json_option(parser)
    dry_run_option(parser)
    clear_option(parser)
    gains_options(parser)
    parser.add_argument("--rate", type=float, metavar="HZ", help="control rate (default: by the bus load)")
    parser.add_argument("--calibration", type=Path, metavar="FILE", help="default: HAND.calibration.toml")
    parser.add_argument("--log", type=Path, metavar="FILE", help="log to write (default: logs/DATE-HAND.mcap)")
    yes_option(parser)
    time_scale_option(parser)


def clear_option(parser: argparse.ArgumentParser) -> None:
    """Declare --clear: clear latched faults of the drives before arming."""
    text = "clear latched faults of the drives before arming; find the cause first"
    parser.add_argument("--clear", action="store_true", help=text)


def jobs_option(parser: argparse.ArgumentParser, default: int | None, text: str) -> None:
    """Declare --jobs: processes at a time.

    Args:
        parser: of a verb.
        default: number of processes; None for one per core.
        text: what is done at a time.
    """
    default_text = "one per core" if default is None else str(default)
    parser.add_argument("--jobs", type=int, default=default, metavar="N", help=f"{text} (default: {default_text})")


def output_option(parser: argparse.ArgumentParser, text: str, metavar: str = "FILE") -> None:
    """Declare --output: file or folder of the result."""
    parser.add_argument("--output", type=Path, metavar=metavar, help=text)


def perturb_option(parser: argparse.ArgumentParser) -> None:
    """--perturb: how the simulated hand differs from its file."""
    text = "make the simulated hand unlike its file, e.g. stiffness=0.8 friction=1.3 (python -m firmware_sim --help)"
    parser.add_argument("--perturb", nargs="+", action="extend", default=[], metavar="KEY=FACTOR", help=text)


def perturb_words(args: argparse.Namespace) -> list[str]:
    """The option as the simulator takes it."""
    return ["--perturb", *args.perturb] if args.perturb else []


def yes_option(parser: argparse.ArgumentParser) -> None:
    """--yes: go on without the question."""
    parser.add_argument("--yes", action="store_true", help="on a real bus: move at once, do not ask")


def time_scale_option(parser: argparse.ArgumentParser, more: str = "") -> None:
    """--time-scale: how fast a simulated hand lives, the same on both sides of its bus."""
    text = "simulated time per wall time" + more
    parser.add_argument("--time-scale", type=float, default=1.0, metavar="X", help=text)


def gains_options(parser: argparse.ArgumentParser) -> None:
    """--gains and --gain."""
    parser.add_argument(
        "--gains", type=Path, metavar="FILE", help="gains file (default: HAND.gains.toml, else the packaged gains)"
    )
    parser.add_argument(
        "--gain", action="append", metavar="KEY=VALUE", help="one gain, over every gains file; may be repeated"
    )


def say(text: str, error: bool = False) -> None:
    """Print a line that has words of a file in it, so that none of them can command the terminal."""
    print(message(text), file=sys.stderr if error else sys.stdout)


def warn_if_lossy(path: Path, warning: str) -> Exit:
    """Say why a log is not whole, if it is not; the exit code of a verb that could do its work on what is there."""
    if warning:
        say(f"handctl: {path}: {warning}", error=True)
    return Exit.LOSSY_LOG if warning else Exit.DONE


def wire_option(parser: argparse.ArgumentParser) -> None:
    """--wire: simulated frames take the time of a real bus."""
    text = "the simulated bus has a bit rate, queues and errors; e.g. --wire queue=10 (python -m firmware_sim --help)"
    parser.add_argument("--wire", nargs="*", metavar="KEY=VALUE", help=text)


def wire_words(args: argparse.Namespace) -> list[str]:
    """The option as the simulator takes it."""
    return [] if args.wire is None else ["--wire", *args.wire]


def print_json(result: dict[str, Any]) -> None:
    """Print a result for programs; NaN becomes null."""
    text = json.dumps(_json_value(result), indent=2, allow_nan=False)
    sys.stdout.write(text.replace("\x7f", "\\u007f") + "\n")  # JSON leaves this control character as it is


def _json_value(value: Any) -> Any:
    if isinstance(value, dict):
        return {encodable(str(key)): _json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(item) for item in value]
    if isinstance(value, float) and not (value == value and abs(value) != float("inf")):
        return None
    return encodable(str(value)) if isinstance(value, Path | str) else value
