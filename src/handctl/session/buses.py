"""Buses as words where no hand tells their names."""

from collections.abc import Sequence

from handctl.errors import ConfigError
from handctl.hand.file.quantities import NAME_PATTERN
from handctl.runtime.buses.open import check_spec


def named_buses(given: Sequence[str]) -> dict[str, str]:
    """Specification by name, where no hand tells the names: NAME=SPEC, or names that a hand file can have.

    Raises:
        ConfigError: a name twice, or none of a bus.
    """
    found: dict[str, str] = {}
    for number, text in enumerate(given):
        head, equals, spec = text.partition("=")
        named = bool(equals) and ":" not in head
        name = head if named else "main" if number == 0 else f"bus{number}"
        if name in found or not NAME_PATTERN.fullmatch(name):
            raise ConfigError(repr(text), "--bus", "SPEC, or NAME=SPEC with every name once, of letters, digits and _")
        found[name] = spec if named else text
        check_spec(found[name])
    return found
