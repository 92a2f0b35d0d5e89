"""Options of a motor that more than one protocol has."""

from handctl.errors import ConfigError


def positive(value: object, where: str, most: float) -> float:
    """A number above 0.

    Args:
        value: as the hand file has it.
        where: key path.
        most: largest that makes sense.

    Raises:
        ConfigError: it is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= most:
        raise ConfigError("missing" if value is None else repr(value), where, f"a number above 0, at most {most:g}")
    return float(value)


def whole(value: object, where: str, most: int) -> int:
    """A whole number from 1 on.

    Args:
        value: as the hand file has it; 50.0 is one, too.
        where: key path.
        most: largest that makes sense.

    Raises:
        ConfigError: it is none.
    """
    number = value if not isinstance(value, float) else int(value) if value.is_integer() else 0
    if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= most:
        raise ConfigError("missing" if value is None else repr(value), where, f"a whole number from 1 to {most}")
    return number


def switch(value: object, where: str) -> bool:
    """True or false, nothing that only counts as one.

    Args:
        value: as the hand file has it.
        where: key path.

    Raises:
        ConfigError: it is neither.
    """
    if type(value) is not bool:
        raise ConfigError(repr(value), where, "true or false")
    return value
