"""Validators of motor options, shared by the protocols."""

from handctl.errors import ConfigError


def positive(value: object, where: str, most: float) -> float:
    """Return a number above 0.

    Args:
        value: value in the hand file.
        where: key path.
        most: largest plausible value.

    Raises:
        ConfigError: not a number above 0, or larger than ``most``.
    """
    # bool is a subclass of int. The comparison is False for NaN.
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= most:
        raise ConfigError("missing" if value is None else repr(value), where, f"a number above 0, at most {most:g}")
    return float(value)


def whole(value: object, where: str, most: int) -> int:
    """Return a whole number from 1 on.

    Args:
        value: value in the hand file. 50.0 counts as 50.
        where: key path.
        most: largest plausible value.

    Raises:
        ConfigError: not a whole number from 1 to ``most``.
    """
    number = value if not isinstance(value, float) else int(value) if value.is_integer() else 0
    if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= most:
        raise ConfigError("missing" if value is None else repr(value), where, f"a whole number from 1 to {most}")
    return number


def switch(value: object, where: str) -> bool:
    """Return True or False. Numbers and strings are refused.

    Args:
        value: value in the hand file.
        where: key path.

    Raises:
        ConfigError: neither true nor false.
    """
    if type(value) is not bool:
        raise ConfigError(repr(value), where, "true or false")
    return value
