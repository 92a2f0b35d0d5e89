"""Bounds of the gains.

Each key of the gains has a range, a default and a meaning. The values of some keys are allowed to
change during a run.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple, cast

from annotated_types import Ge, Gt, Le

from handctl.core.gains.gains import Gains, TendonForces
from handctl.document import Document, validate_content
from handctl.errors import ConfigError
from handctl.hand.file.key_descriptions import key_description
from handctl.printing import similar_name

GAIN_SECTIONS = ("filter", "motion", "tension", "contact")
TENDON_SECTION = "tendon"
"""Section of forces for single tendons, with keys such as ``tendon.wrist_flex.motion_force_N``."""
LIVE_GAIN_SECTIONS = ("motion", "tension", "contact", TENDON_SECTION)
"""Sections of the gains whose values are allowed to change while the controller runs.

The section of the tension filter is not in the list, because the design of a filter takes longer
than a tick allows.
"""


@dataclass(frozen=True, slots=True)
class GainBounds:
    """A key of the gains, with the bounds of its value.

    Attributes:
        key: section and name, for example ``motion.force_N``.
        low: smallest allowed value of the key. If ``is_low_excluded`` is True, the value must be greater
            than ``low``.
        high: largest allowed value of the key.
        is_low_excluded: True if the value must be greater than ``low``.
        default: default value of the key.
        is_integer: True if the value must be an integer.
        is_changeable_live: True if the value is allowed to change while the controller runs.
        meaning: meaning of the key, in words. The text is empty if the name of the key is clear.
    """

    key: str
    low: float
    high: float
    is_low_excluded: bool
    default: float
    is_integer: bool
    is_changeable_live: bool
    meaning: str

    def __str__(self) -> str:
        """Return the bounds of the value in words."""
        lower = f"more than {self.low:g}" if self.is_low_excluded else f"at least {self.low:g}"
        return f"{'a whole number, ' if self.is_integer else ''}{lower}, at most {self.high:g}"


class TendonKey(NamedTuple):
    """Parts of a gain key that sets a force of a single tendon, such as ``tendon.wrist_flex.motion_force_N``.

    Attributes:
        tendon: name of the tendon.
        field: name of the force in ``TendonForces``.
        common_key: key of the same force for all tendons.
    """

    tendon: str
    field: str
    common_key: str


COMMON_KEY_BY_FORCE = {"motion_force_N": "motion.force_N", "tension_force_N": "tension.force_N"}
"""Key of the force for all tendons, for each field of ``TendonForces`` that can replace this force."""


def tendon_key(key: str) -> TendonKey | None:
    """Split a key of a force for a single tendon into its parts, and return None for any other key."""
    section, _, key_name = key.partition(".")
    tendon, _, field = key_name.rpartition(".")
    if section != TENDON_SECTION or not tendon or field not in COMMON_KEY_BY_FORCE:
        return None
    return TendonKey(tendon, field, COMMON_KEY_BY_FORCE[field])


@cache
def gain_bounds() -> Mapping[str, GainBounds]:
    """Return the bounds of all keys for the whole hand, in the order of the declarations in ``Gains``."""
    result = {}
    for section in GAIN_SECTIONS:
        model = cast(type[Document], Gains.model_fields[section].annotation)
        for name, field in model.model_fields.items():
            low, high, is_low_excluded = _range_of_field(field.metadata)
            key = f"{section}.{name}"
            is_integer = field.annotation is int
            meaning = key_description(model, name)
            result[key] = GainBounds(
                key,
                low,
                high,
                is_low_excluded,
                field.default,
                is_integer,
                section in LIVE_GAIN_SECTIONS,
                meaning,
            )
    return result


def _range_of_field(field_metadata: list[Any]) -> tuple[float, float, bool]:
    """Return the lower and the upper bound of a field, and True if the lower bound itself is not allowed."""
    low = float("-inf")
    high = float("inf")
    is_low_excluded = False
    for limit in field_metadata:
        if isinstance(limit, Gt):
            low = cast(float, limit.gt)
            is_low_excluded = True
        elif isinstance(limit, Ge):
            low = cast(float, limit.ge)
        elif isinstance(limit, Le):
            high = cast(float, limit.le)
    return low, high, is_low_excluded


def bounds_of_key(key: str) -> GainBounds | None:
    """Return the bounds of a key, or None for an unknown key.

    The key can set a value for the whole hand, or for a single tendon.
    """
    key_parts = tendon_key(key)
    if key_parts is None:
        return gain_bounds().get(key)
    meaning = key_description(TendonForces, key_parts.field)
    return replace(gain_bounds()[key_parts.common_key], key=key, meaning=meaning)


def values_by_key(gains: Gains) -> dict[str, float]:
    """Return the value of every key of the gains, including the keys for single tendons."""
    values = {
        key: getattr(getattr(gains, key.partition(".")[0]), key.partition(".")[2])
        for key in gain_bounds()
    }
    for tendon_gains in gains.tendon:
        forces = {field: getattr(tendon_gains, field) for field in COMMON_KEY_BY_FORCE}
        values |= {
            f"{TENDON_SECTION}.{tendon_gains.name}.{field}": force
            for field, force in forces.items()
            if force
        }
    return values


def changed_gain_values(old_gains: Gains, new_gains: Gains) -> dict[str, tuple[float, float]]:
    """Return the old and the new value of every key whose value differs.

    If the gains contain no force for a single tendon, the force for all tendons counts as the value
    of this tendon.
    """
    old_values = values_by_key(old_gains)
    new_values = values_by_key(new_gains)
    pairs = {
        key: (_gain_of_key(old_values, key), _gain_of_key(new_values, key))
        for key in {**old_values, **new_values}
    }
    return {key: pair for key, pair in pairs.items() if pair[0] != pair[1]}


def _gain_of_key(gain_values: Mapping[str, float], key: str) -> float:
    """Return the value of a key.

    If the gains contain no value for a single tendon, return the value for all tendons.
    """
    key_parts = tendon_key(key)
    return (
        gain_values[key_parts.common_key]
        if key_parts and key not in gain_values
        else gain_values[key]
    )


def gains_with_values(
    gains: Gains, gain_values: Mapping[str, float], source_name: str, is_live: bool = False
) -> Gains:
    """Return a copy of gains with some values replaced. All new values are checked first.

    Args:
        gains: gains to copy.
        gain_values: new values by key.
        source_name: name of the source of the values, for messages.
        is_live: True to accept only keys whose values are allowed to change during a run.

    Raises:
        ConfigError: a key is unknown, a value is out of bounds, or a key must not change during a
            run.
    """
    content = gains.model_dump(by_alias=True)
    for key, value in gain_values.items():
        bound = checked_gain_bounds(key, value, source_name)
        if is_live and not bound.is_changeable_live:
            expected = (
                f"a key of {', '.join(LIVE_GAIN_SECTIONS)}, or handctl gains apply and a new run"
            )
            raise ConfigError(
                "is designed before arming and cannot change in a run",
                f"{source_name}: {key}",
                expected,
            )
        if key_parts := tendon_key(key):
            _set_force_weight_of_tendon(content, key_parts, float(value))
            continue
        section, _, name = key.partition(".")
        content[section][name] = int(value) if bound.is_integer else float(value)
    return validate_content(content, Gains, source_name)


def _set_force_weight_of_tendon(
    gains_content: dict[str, Any], key_parts: TendonKey, force: float
) -> None:
    """Set a force of a single tendon in the content of the gains [N]."""
    entries = [dict(entry) for entry in gains_content[TENDON_SECTION]]
    entry = next(
        (tendon_entry for tendon_entry in entries if tendon_entry["name"] == key_parts.tendon), None
    )
    if entry is None:
        entries.append(entry := {"name": key_parts.tendon})
    entry[key_parts.field] = force
    gains_content[TENDON_SECTION] = entries


def check_tendon_names(gains: Gains, tendons: Sequence[str]) -> None:
    """Check that the hand has every tendon that is named in the gains.

    Args:
        gains: gains to check.
        tendons: names of the hand's tendons.

    Raises:
        ConfigError: the gains contain a tendon that the hand does not have.
    """
    for tendon_gains in gains.tendon:
        if tendon_gains.name not in tendons:
            similar_word = similar_name(tendon_gains.name, tendons, min_similarity=0.5)
            expected = f"{similar_word}?" if similar_word else f"one of {', '.join(tendons)}"
            raise ConfigError(
                f"no tendon {tendon_gains.name!r}", f"gains: {TENDON_SECTION}", expected
            )


def checked_gain_bounds(key: str, value: float, source_name: str) -> GainBounds:
    """Check a new value of a key, and return the bounds of the key.

    Raises:
        ConfigError: the key is unknown, or the value is out of bounds.
    """
    known_bounds = bounds_of_key(key)
    if known_bounds is None:
        similar_word = similar_name(key, gain_bounds(), min_similarity=0.5)
        expected = (
            f"{similar_word}?" if similar_word else "one of those that handctl gains show lists"
        )
        raise ConfigError("no such gain", f"{source_name}: {key}", expected)
    is_above_low = (
        known_bounds.low < value if known_bounds.is_low_excluded else known_bounds.low <= value
    )
    if not (is_above_low and value <= known_bounds.high) or (
        known_bounds.is_integer and value != int(value)
    ):
        raise ConfigError(f"{value:g}", f"{source_name}: {key}", str(known_bounds))
    return known_bounds
