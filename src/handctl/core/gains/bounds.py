"""Bounds of the gains as data: range, default and meaning of each key, and whether it may change during a run."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, cast

from annotated_types import Ge, Gt, Le

from handctl.core.gains.gains import Gains
from handctl.document import Document, validate_content
from handctl.errors import ConfigError
from handctl.printing import similar_name

SECTIONS = ("filter", "motion", "tension", "contact")
LIVE_SECTIONS = ("motion", "tension", "contact")
"""Sections accepted by a running controller. The design of the filter's gains takes too long within ticks."""


@dataclass(frozen=True, slots=True)
class Bound:
    """A key of the gains.

    Attributes:
        key: section and name, for example ``motion.force_N``.
        low: smallest value, excluded if ``open_low``.
        high: largest value.
        open_low: True if the value must be greater than ``low``.
        default: of the packaged hands.
        whole: True for integers.
        live: True if a running controller accepts changes.
        why: meaning of the key, empty if the name is enough.
    """

    key: str
    low: float
    high: float
    open_low: bool
    default: float
    whole: bool
    live: bool
    why: str

    def __str__(self) -> str:
        """Return the bounds in words."""
        lower = f"more than {self.low:g}" if self.open_low else f"at least {self.low:g}"
        return f"{'a whole number, ' if self.whole else ''}{lower}, at most {self.high:g}"


@cache
def bounds() -> Mapping[str, Bound]:
    """Return the bounds of all keys, in the order of the gains model, from which the numbers come."""
    result = {}
    for section in SECTIONS:
        model = cast(type[Document], Gains.model_fields[section].annotation)
        for name, field in model.model_fields.items():
            low, high, open_low = _range_of_field(field.metadata)
            key = f"{section}.{name}"
            whole = field.annotation is int
            why = field.description or ""
            result[key] = Bound(key, low, high, open_low, field.default, whole, section in LIVE_SECTIONS, why)
    return result


def _range_of_field(metadata: list[Any]) -> tuple[float, float, bool]:
    """Return smallest and largest value of a field, and True if the smallest is excluded."""
    low = float("-inf")
    high = float("inf")
    open_low = False
    for limit in metadata:
        if isinstance(limit, Gt):
            low = cast(float, limit.gt)
            open_low = True
        elif isinstance(limit, Ge):
            low = cast(float, limit.ge)
        elif isinstance(limit, Le):
            high = cast(float, limit.le)
    return low, high, open_low


def values_by_key(gains: Gains) -> dict[str, float]:
    """Return the value of every key."""
    return {key: getattr(getattr(gains, key.partition(".")[0]), key.partition(".")[2]) for key in bounds()}


def with_values(gains: Gains, values: Mapping[str, float], source: str, live: bool = False) -> Gains:
    """Return gains with some values replaced. All values are checked first.

    Args:
        gains: to be changed.
        values: by key.
        source: name of the values in messages.
        live: only accept keys for a running controller.

    Raises:
        ConfigError: for an unknown key, a value out of bounds, or a key fixed while a controller
            runs.
    """
    content = gains.model_dump(by_alias=True)
    for key, value in values.items():
        bound = checked_bound(key, value, source)
        if live and not bound.live:
            right = f"a key of {', '.join(LIVE_SECTIONS)}, or handctl gains apply and a new run"
            raise ConfigError("is designed before arming and cannot change in a run", f"{source}: {key}", right)
        section, _, name = key.partition(".")
        content[section][name] = int(value) if bound.whole else float(value)
    return validate_content(content, Gains, source)


def checked_bound(key: str, value: float, source: str) -> Bound:
    """Return the bounds of a key after checking a value.

    Raises:
        ConfigError: for an unknown key, or a value out of bounds.
    """
    known = bounds().get(key)
    if known is None:
        near = similar_name(key, bounds(), cutoff=0.5)
        right = f"{near}?" if near else "one of those that handctl gains show lists"
        raise ConfigError("no such gain", f"{source}: {key}", right)
    inside = known.low < value if known.open_low else known.low <= value
    if not (inside and value <= known.high) or (known.whole and value != int(value)):
        raise ConfigError(f"{value:g}", f"{source}: {key}", str(known))
    return known
