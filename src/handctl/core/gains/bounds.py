"""What may be set in a gains file, as data: each key with its bounds, default, unit, and whether it may change live."""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from typing import Any, cast

from annotated_types import Ge, Gt, Le

from handctl.core.gains.gains import Gains
from handctl.document import Document, validated
from handctl.errors import ConfigError

SECTIONS = ("filter", "motion", "tension", "contact")
LIVE = ("motion", "tension", "contact")
"""Sections that a running controller takes. The filter's gains take too long to design within ticks."""


@dataclass(frozen=True, slots=True)
class Bound:
    """One key of the gains.

    Attributes:
        key: section and name, e.g. ``motion.force_N``.
        low: least value; itself not allowed if ``open_low``.
        high: greatest value.
        open_low: whether the value must be greater than ``low``.
        default: of the packaged hands.
        whole: only whole numbers.
        live: may change while a controller runs.
        why: what the key means; empty where its name says it all.
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
        least = f"more than {self.low:g}" if self.open_low else f"at least {self.low:g}"
        return f"{'a whole number, ' if self.whole else ''}{least}, at most {self.high:g}"


@cache
def bounds() -> Mapping[str, Bound]:
    """All keys, in the order of the model, which is where the numbers come from."""
    found = {}
    for section in SECTIONS:
        model = cast(type[Document], Gains.model_fields[section].annotation)
        for name, field in model.model_fields.items():
            low, high, open_low = _limits(field.metadata)
            key, whole = f"{section}.{name}", field.annotation is int
            why = field.description or ""
            found[key] = Bound(key, low, high, open_low, field.default, whole, section in LIVE, why)
    return found


def _limits(metadata: list[Any]) -> tuple[float, float, bool]:
    """Least and greatest value of a field, and whether the least is excluded."""
    low, high, open_low = float("-inf"), float("inf"), False
    for limit in metadata:
        if isinstance(limit, Gt):
            low, open_low = cast(float, limit.gt), True
        elif isinstance(limit, Ge):
            low = cast(float, limit.ge)
        elif isinstance(limit, Le):
            high = cast(float, limit.le)
    return low, high, open_low


def flat(gains: Gains) -> dict[str, float]:
    """Every key with its value."""
    return {key: getattr(getattr(gains, key.partition(".")[0]), key.partition(".")[2]) for key in bounds()}


def with_values(gains: Gains, values: Mapping[str, float], source: str, live: bool = False) -> Gains:
    """Gains with some values changed: all of them, or an error that names the first that cannot be.

    Args:
        gains: that are changed.
        values: by key.
        source: what to call the values in messages.
        live: only keys that a running controller takes.

    Raises:
        ConfigError: an unknown key, a value out of bounds, or a key that may not change while a controller runs.
    """
    content = gains.model_dump(by_alias=True)
    for key, value in values.items():
        bound = checked(key, value, source)
        if live and not bound.live:
            right = f"a key of {', '.join(LIVE)}, or handctl gains apply and a new run"
            raise ConfigError("is designed before arming and cannot change in a run", f"{source}: {key}", right)
        section, _, name = key.partition(".")
        content[section][name] = int(value) if bound.whole else float(value)
    return validated(content, Gains, source)


def checked(key: str, value: float, source: str) -> Bound:
    """The bounds of a key that a value obeys.

    Raises:
        ConfigError: there is no such key, or the value is out of its bounds.
    """
    known = bounds().get(key)
    if known is None:
        near = get_close_matches(key, bounds(), n=1, cutoff=0.5)
        right = f"{near[0]}?" if near else "one of those that handctl gains show lists"
        raise ConfigError("no such gain", f"{source}: {key}", right)
    inside = known.low < value if known.open_low else known.low <= value
    if not (inside and value <= known.high) or (known.whole and value != int(value)):
        raise ConfigError(f"{value:g}", f"{source}: {key}", str(known))
    return known
