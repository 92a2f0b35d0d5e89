"""Gains of a run, and the source of each value.

If there is a gains file, its gains replace the packaged gains of the hand. The command line
overrides single values of the gains file or of the packaged gains.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from handctl.core.gains.gain_bounds import gains_with_values, tendon_key, values_by_key
from handctl.core.gains.gains import (
    Gains,
    GainsFile,
    GainsProvenance,
    load_gains_file,
    packaged_gains,
)
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.session.notices import NoticeCallback, ignore_notice

PACKAGED_GAINS_SOURCE = "packaged"
COMMAND_LINE_SOURCE = "command line"
MOTION_FORCE_KEY = "motion.force_N"
MARGIN_SOURCE = "computed for the gain margin"
"""Source of a gain that the default gains of a hand contain instead of the packaged value."""
DefaultGainsFunction = Callable[[Hand], Gains]
"""Function that returns the gains of a hand without a gains file."""


@dataclass(frozen=True, slots=True)
class GainsWithSources:
    """Gains of a run, and the source from which each value was taken.

    Attributes:
        gains: gains that the run uses.
        file: path of the gains file, or None if the packaged gains are used.
        provenance: record of how the gains were found, as the gains file contains it.
        origins: source of each gain, by the key of the gain: "packaged", "computed for the gain
            margin", the file, or "command line".
    """

    gains: Gains
    file: Path | None
    provenance: GainsProvenance
    origins: dict[str, str]


def gains_with_sources(
    hand: Hand,
    gains_file: Path | None,
    assignment_words: Sequence[str],
    show_notice: NoticeCallback = ignore_notice,
    default_gains: DefaultGainsFunction | None = None,
) -> GainsWithSources:
    """Return the gains that a run uses, and the source of each gain.

    Args:
        hand: description of the hand.
        gains_file: path of the gains file. If ``gains_file`` is None, the file ``HAND.gains.toml``
            is used where it exists.
        assignment_words: words KEY=VALUE from the command line. The values from the command line
            override the values of every file.
        show_notice: function that shows a notice to the operator.
        default_gains: function that returns the gains if there is no gains file. The default is
            ``packaged_gains``.

    Raises:
        ConfigError: a file or a value cannot be used, or the gains are for another hand.
    """
    default = Path(f"{hand.name}.gains.toml")
    gains_file = gains_file or (default if default.exists() else None)
    loaded_gains = read_gains_for_hand(hand, gains_file, show_notice) if gains_file else None
    packaged = packaged_gains(hand.name)
    base = loaded_gains.gains if loaded_gains else packaged
    values = gain_assignments(assignment_words, "--gain")
    # The defaults differ from the packaged gains only in the forces of the motion loops. A force from
    # the command line applies to all tendons.
    if loaded_gains is None and default_gains is not None and MOTION_FORCE_KEY not in values:
        base = default_gains(hand)
    gains = gains_with_values(base, values, "--gain") if values else base
    packaged_values = values_by_key(packaged)
    origins = {
        key: MARGIN_SOURCE
        if gains_file is None and value != packaged_values.get(key)
        else _source_of_gain(base, key, gains_file)
        for key, value in values_by_key(base).items()
    } | dict.fromkeys(values, COMMAND_LINE_SOURCE)
    return GainsWithSources(
        gains, gains_file, loaded_gains.provenance if loaded_gains else GainsProvenance(), origins
    )


def read_gains_for_hand(
    hand: Hand, path: Path, show_notice: NoticeCallback = ignore_notice
) -> GainsFile:
    """Read a gains file, and check that the gains belong to the given hand.

    Gains for an earlier version of the hand file are accepted with a notice to the operator.

    Raises:
        ConfigError: the file cannot be used, or is for another hand.
    """
    file = load_gains_file(path)
    provenance = file.provenance
    if provenance.hand not in ("", hand.name):
        raise ConfigError(f"is for hand {provenance.hand!r}", str(path), f"gains for {hand.name!r}")
    if provenance.identity not in ("", hand.identity):
        identity_text = (
            f"{hand.name} as {provenance.identity[:12]}, which is now {hand.identity[:12]}"
        )
        show_notice(
            f"handctl: {path} was made for {identity_text}: handctl tune design shows its margins"
        )
    return file


def _source_of_gain(gains: Gains, key: str, gains_file: Path | None) -> str:
    """Return the source of a gain that the command line does not set: the gains file, or the packaged gains."""
    section, _, name = key.partition(".")
    is_key_in_file = tendon_key(key) is not None or (
        section in gains.model_fields_set and name in getattr(gains, section).model_fields_set
    )
    return str(gains_file) if gains_file and is_key_in_file else PACKAGED_GAINS_SOURCE


def gain_assignments(assignment_words: Sequence[str], location: str) -> dict[str, float]:
    """Parse words of the form KEY=VALUE, and return the numbers by key.

    Raises:
        ConfigError: a word does not assign a number, or a key is assigned twice.
    """
    values: dict[str, float] = {}
    for word in assignment_words:
        key, equals_sign, text = word.partition("=")
        if key in values:
            raise ConfigError(f"{key} is given twice", location, "one value for each")
        try:
            values[key] = float(text)
        except ValueError:
            equals_sign = ""
        if not equals_sign or not key or values[key] != values[key]:
            example = "stiffness=0.8" if location == "--perturb" else "motion.force_N=25"
            raise ConfigError(repr(word), location, f"KEY=NUMBER, e.g. {example}")
    return values
