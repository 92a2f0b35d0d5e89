"""Validators of motor options, shared by the protocols."""

from collections.abc import Mapping
from typing import Any, Protocol, TypeVar

from handctl.drives.motor_description import MotorDescription
from handctl.errors import ConfigError


class FullScale(Protocol):
    """Ranges of a motor model."""

    @property
    def torque(self) -> float:
        """Return the full scale of the torque [N m]."""
        ...


Ranges = TypeVar("Ranges", bound=FullScale)


def checked_positive(value: object, where: str, largest: float) -> float:
    """Return the value as a number above 0.

    Args:
        value: value in the hand file.
        where: key path.
        largest: largest accepted value.

    Raises:
        ConfigError: not a number above 0, or larger than ``largest``.
    """
    # bool is a subclass of int, so it is excluded. The comparison is False for NaN.
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= largest:
        raise ConfigError("missing" if value is None else repr(value), where, f"a number above 0, at most {largest:g}")
    return float(value)


def checked_whole_number(value: object, where: str, largest: int) -> int:
    """Return a whole number of at least 1.

    Args:
        value: value in the hand file. 50.0 is accepted as 50.
        where: key path.
        largest: largest accepted value.

    Raises:
        ConfigError: not a whole number from 1 to ``largest``.
    """
    number = value if not isinstance(value, float) else int(value) if value.is_integer() else 0
    if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= largest:
        raise ConfigError("missing" if value is None else repr(value), where, f"a whole number from 1 to {largest}")
    return number


def checked_boolean(value: object, where: str) -> bool:
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


def pop_motor_model(options: dict[str, Any], where: str, models: Mapping[str, Ranges]) -> Ranges:
    """Remove the option ``motor_type``, and return the ranges of this model.

    Args:
        options: options of the motor, modified in place.
        where: key path of the motor.
        models: ranges by the name of the model.

    Raises:
        ConfigError: the model is missing or unknown.
    """
    model = options.pop("motor_type", None)
    if model not in models:
        problem = "missing" if model is None else repr(model)
        raise ConfigError(problem, f"{where}.options.motor_type", "one of " + ", ".join(models))
    return models[model]


def refuse_unknown_options(options: Mapping[str, Any], where: str, right: str) -> None:
    """Check that a drive has used all options.

    Args:
        options: options that are left.
        where: key path of the options.
        right: keys that the drive accepts, for the message.

    Raises:
        ConfigError: an option is left.
    """
    if options:
        raise ConfigError("unknown key", f"{where}.{next(iter(options))}", right)


def check_full_scale(motor: MotorDescription, ranges: FullScale) -> None:
    """Check that the torque limit of a motor is within the full scale of the model.

    Raises:
        ConfigError: the limit is larger.
    """
    if motor.torque_max_N_m > ranges.torque:
        raise ConfigError(
            f"{motor.torque_max_N_m:g}", f"motor[{motor.name}].torque_max_N_m", f"at most {ranges.torque:g}"
        )
