"""Where each gain of a run comes from: packaged, the hand's gains file, and the command line, the later wins."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from handctl.controller.gain_bounds import flat, with_values
from handctl.controller.gains import Gains, load_gains
from handctl.errors import ConfigError

PACKAGED, COMMAND_LINE = "packaged", "command line"


@dataclass(frozen=True, slots=True)
class LayeredGains:
    """Gains with their origins.

    Attributes:
        gains: what a run uses.
        file: that they were read from; None: the packaged ones.
        origins: of every key: "packaged", the file, or "command line".
    """

    gains: Gains
    file: Path | None
    origins: dict[str, str]


def gains_options(parser: argparse.ArgumentParser) -> None:
    """--gains and --gain."""
    parser.add_argument(
        "--gains", type=Path, metavar="FILE", help="gains file (default: HAND.gains.toml, else the packaged gains)"
    )
    parser.add_argument(
        "--gain", action="append", metavar="KEY=VALUE", help="one gain, over every gains file; may be repeated"
    )


def layered_gains(args: argparse.Namespace, hand: str) -> LayeredGains:
    """The gains that a run with these arguments uses.

    Args:
        args: with ``gains`` and ``gain``.
        hand: its name.

    Raises:
        ConfigError: a file or a value that cannot be used.
    """
    default = Path(f"{hand}.gains.toml")
    file: Path | None = args.gains or (default if default.exists() else None)
    base = load_gains(file)
    values = assignments(getattr(args, "gain", None) or (), "--gain")
    gains = with_values(base, values, "--gain") if values else base
    origins = {key: _origin(base, key, file) for key in flat(base)} | dict.fromkeys(values, COMMAND_LINE)
    return LayeredGains(gains, file, origins)


def _origin(gains: Gains, key: str, file: Path | None) -> str:
    """Where a key comes from, before the command line."""
    section, _, name = key.partition(".")
    said = section in gains.model_fields_set and name in getattr(gains, section).model_fields_set
    return str(file) if file and said else PACKAGED


def assignments(words: Sequence[str], where: str) -> dict[str, float]:
    """KEY=VALUE, as numbers by key.

    Raises:
        ConfigError: a word that is no assignment of a number.
    """
    found = {}
    for word in words:
        key, equals, text = word.partition("=")
        try:
            found[key] = float(text)
        except ValueError:
            equals = ""
        if not equals or not key or found[key] != found[key]:
            raise ConfigError(repr(word), where, "KEY=NUMBER, e.g. motion.force_N=25")
    return found


def check_perturb(args: argparse.Namespace) -> None:
    """Refuse what would not be obeyed, or be read only after a dry run has found all well.

    Raises:
        ConfigError: no KEY=NUMBER, or of a hand that is not simulated here.
    """
    if assignments(args.perturb, "--perturb") and not args.lockstep:
        raise ConfigError("only with --lockstep", "--perturb", "a simulator with it: python -m firmware_sim --perturb")
