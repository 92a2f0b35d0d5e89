"""Validators of motor options, shared by the protocols."""

from handctl.errors import ConfigError


def positive_number(value: object, where: str, largest: float) -> float:
    """Return the value as a number above 0.

    Args:
        value: value in the hand file.
        where: key path.
        largest: largest accepted value.

    Raises:
        ConfigError: not a number above 0, or larger than ``largest``.
    """
    # bool is a subclass of int. The comparison is False for NaN.
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= largest:
        raise ConfigError("missing" if value is None else repr(value), where, f"a number above 0, at most {largest:g}")
    return float(value)


def whole_number(value: object, where: str, largest: int) -> int:
    """Return a whole number of at least 1.

    Args:
        value: value in the hand file. 50.0 counts as 50.
        where: key path.
        largest: largest accepted value.

    Raises:
        ConfigError: not a whole number from 1 to ``largest``.
    """
    number = value if not isinstance(value, float) else int(value) if value.is_integer() else 0
    if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= largest:
        raise ConfigError("missing" if value is None else repr(value), where, f"a whole number from 1 to {largest}")
    return number


def boolean(value: object, where: str) -> bool:
    """Return the value as True or False. Numbers and strings are refused.

    Args:
        value: value in the hand file.
        where: key path.

    Raises:
        ConfigError: neither true nor false.
    """
    if type(value) is not bool:
        raise ConfigError(repr(value), where, "true or false")
    return value
