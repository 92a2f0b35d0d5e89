"""Files that the kinds of ``handctl tune`` read and write alike."""

import argparse
from pathlib import Path

from handctl.controller.calibration import load_calibration
from handctl.controller.gains import Gains, Provenance, gains_text
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.tune.ensemble import widths
from handctl.tune.gains_store import write_whole


def output_files(args: argparse.Namespace, hand: str, kind: str) -> tuple[Path, Path]:
    """Gains file and picture to write.

    Raises:
        ConfigError: their folder is not there.
    """
    out: Path = args.out or Path(f"{hand}.{kind}.toml")
    picture: Path = args.picture or out.with_suffix(".png")
    for path in (out, picture):
        if not path.parent.is_dir():
            raise ConfigError(str(path), "--out" if path is out else "--picture", "a file in a folder that exists")
    return out, picture


def checked_count(number: int, option: str, most: int) -> int:
    """A count from the command line.

    Raises:
        ConfigError: it is not between 1 and ``most``.
    """
    if not 1 <= number <= most:
        raise ConfigError(str(number), option, f"1 to {most}")
    return number


def write_gains(path: Path, gains: Gains, hand: Hand, note: str, fit: Path | None = None, study: str = "") -> None:
    """A gains file that says where it comes from."""
    told = Provenance(hand=hand.name, identity=hand.identity, note=note, fit=str(fit or ""), study=study)
    write_whole(path, gains_text(gains, told))


def spread_of(fit: Path | None, hand: Hand) -> dict[str, float]:
    """Half widths of the ensemble by an identification: how far from the hand file its intervals reach.

    Args:
        fit: calibration file with identified parameters, or None.
        hand: that it is of.

    Raises:
        ConfigError: the file cannot be read, is of another hand, or holds nothing identified.
    """
    if fit is None:
        return {}
    found = load_calibration(fit, hand).identified
    if not found:
        raise ConfigError("holds nothing identified", str(fit), "a calibration that handctl identify wrote")
    return widths(hand, found)
