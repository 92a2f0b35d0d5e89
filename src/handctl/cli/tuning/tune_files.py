"""Input and output files of the commands ``handctl tune design``, ``search`` and ``verify``."""

import argparse
import shlex
from pathlib import Path
from typing import NamedTuple

from handctl.cli.console.options import check_count, perturb_arguments
from handctl.cli.console.plan import check_perturb
from handctl.core.gains.gains import Gains, GainsProvenance, gains_text
from handctl.core.identified_parameters import identified_hand
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import load_hand
from handctl.output_files import check_output_path, path_with_suffix, write_text_atomically
from handctl.session.calibration import identified_parameters_in_file
from handctl.tune.search.ensemble import factor_half_widths, sample_ensemble


def output_files(args: argparse.Namespace, hand: str, kind: str) -> tuple[Path, Path]:
    """Return the paths of the gains file and of the picture to write.

    Raises:
        ConfigError: a folder is missing, both paths are equal, or a path belongs to another file of
            this hand.
    """
    output_path: Path = args.output or Path(f"{hand}.{kind}.toml")
    hand_files = [
        Path(f"{hand}.{suffix}") for suffix in ("calibration.toml", "gains.toml", "study")
    ]
    read = (*hand_files, Path(args.hand), args.gains, args.fit, getattr(args, "study", None))
    check_output_path(output_path, "--output", *read)
    picture: Path = args.picture or path_with_suffix(output_path, ".png")
    check_output_path(picture, "--picture", *read)
    if picture.resolve() == output_path.resolve():
        raise ConfigError(
            "is the name of the picture, too",
            f"--output {output_path}",
            "another --output or --picture",
        )
    return output_path, picture


def ensemble_of_tuned_hand(
    args: argparse.Namespace, half_width_by_factor: dict[str, float], maximum: int
) -> tuple[dict[str, float], ...]:
    """Return the factors by which each simulated plant multiplies the parameters of the hand to tune.

    The plants form an ensemble around the best estimate of the hand. Without a calibration, the
    hand at the centre of the ensemble has the parameters of the hand file, multiplied by the
    factors of ``--perturb``. The identified values in a calibration already contain the effect of
    the factors of ``--perturb``. With a calibration, the factors are therefore not applied again.

    Raises:
        ConfigError: the number of plants is too small or too large, or ``--perturb`` is wrong.
    """
    perturbation_factors = check_perturb(args, is_simulated=True)
    plants = sample_ensemble(
        check_count(args.plants, "--plants", maximum), args.seed, half_width_by_factor
    )
    if args.fit:
        return plants
    return tuple(
        plant | {key: plant.get(key, 1.0) * factor for key, factor in perturbation_factors.items()}
        for plant in plants
    )


def verify_command(args: argparse.Namespace, gains_path: Path) -> str:
    """Return the command line that verifies new gains in simulation.

    The options of the returned command line select the same hand as the present command.
    """
    words = ["handctl", "tune", "verify", str(gains_path), "--lockstep", "--hand", str(args.hand)]
    words += ["--calibration", str(args.fit)] if args.fit else []
    return shlex.join(words + hand_arguments(args))


def hand_arguments(args: argparse.Namespace) -> list[str]:
    """Return the options that let a later command use the gains, control rate and simulated plant of this command."""
    words = ["--gains", str(args.gains)] if args.gains else []
    words += [word for gain in args.gain or () for word in ("--gain", gain)]
    words += ["--rate", f"{args.rate:g}"] if args.rate else []
    return words + perturb_arguments(args)


def write_gains(
    path: Path, gains: Gains, hand: Hand, note: str, fit: Path | None = None, study: str = ""
) -> None:
    """Write a gains file that states where the gains come from."""
    provenance = GainsProvenance(
        hand=hand.name, identity=hand.identity, note=note, fit=str(fit or ""), study=study
    )
    write_text_atomically(path, gains_text(gains, provenance))


class TunedHand(NamedTuple):
    """Hand to tune: with the parameters of the hand file, and with the identified parameters.

    Attributes:
        hand: hand with the parameters of the hand file. A gains file contains the name and the
            identity of this hand.
        identified_hand: hand with identified parameters in place of the parameters in the file.
            The identified hand is the model of the controller, as in a run with the same
            calibration. The identified hand is also the centre of the ensemble of simulated plants.
        half_width_by_factor: half width of the ensemble for each parameter, from the identification, see
            ``sample_ensemble``.
    """

    hand: Hand
    identified_hand: Hand
    half_width_by_factor: dict[str, float]


def load_tuned_hand(name: str, fit: Path | None) -> TunedHand:
    """Load the hand to tune and the identified parameters of this hand.

    Args:
        name: name of a packaged hand, or path of a hand file.
        fit: calibration file with identified parameters, or None.

    Raises:
        ConfigError: a file cannot be read, belongs to another hand, or contains no identified
            parameters.
    """
    hand = load_hand(name)
    if fit is None:
        return TunedHand(hand, hand, {})
    identified = identified_parameters_in_file(fit, hand)
    return TunedHand(hand, identified_hand(hand, identified), factor_half_widths(identified))
