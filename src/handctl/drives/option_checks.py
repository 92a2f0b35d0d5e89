"""Checks of motor options in the hand file. All drive protocols use the same checks of motor options."""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, TypeVar

from handctl.drives.motor_description import MotorDescription
from handctl.errors import ConfigError


class FullScale(Protocol):
    """Ranges of the values in the frames of a motor. Each motor model has its own ranges."""

    @property
    def torque(self) -> float:
        """Return the largest torque that a frame can carry [N m]."""
        ...


ModelRangesType = TypeVar("ModelRangesType", bound=FullScale)


class MotorOption(NamedTuple):
    """Declaration of an option of a protocol, which is a key of ``[motor.options]`` in the hand file.

    Attributes:
        value: valid values, and the default.
        meaning: meaning of the option.
        is_required: True if every motor with the protocol must have the option.
    """

    value: str
    meaning: str
    is_required: bool = False

    @property
    def value_text(self) -> str:
        """Return the valid values and the default, or the note that the option is required."""
        return f"required, {self.value}" if self.is_required else self.value


def motor_type_option(models: Mapping[str, Any]) -> MotorOption:
    """Return the declaration of the option ``motor_type`` of a protocol.

    Args:
        models: ranges of each model, by the name of the model.
    """
    names = ", ".join(f'"{name}"' for name in models)
    return MotorOption(
        f"one of {names}",
        "Model of the motor, which determines the scale of all values in the frames.",
        is_required=True,
    )


def checked_positive(value: object, key_path: str, largest: float) -> float:
    """Return the value as a number above 0.

    Args:
        value: value in the hand file.
        key_path: key path of the value, for the error message.
        largest: largest accepted value.

    Raises:
        ConfigError: the value is not a number above 0, or is larger than ``largest``.
    """
    # The check refuses bool, a subclass of int. The comparison with the limits is False for NaN.
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= largest:
        raise ConfigError(
            "missing" if value is None else repr(value),
            key_path,
            f"a number above 0, at most {largest:g}",
        )
    return float(value)


def checked_whole_number(value: object, key_path: str, largest: int) -> int:
    """Return the value as a whole number of at least 1.

    Args:
        value: value in the hand file. 50.0 is accepted as 50.
        key_path: key path of the value, for the error message.
        largest: largest accepted value.

    Raises:
        ConfigError: the value is not a whole number from 1 to ``largest``.
    """
    number = value if not isinstance(value, float) else int(value) if value.is_integer() else 0
    if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= largest:
        raise ConfigError(
            "missing" if value is None else repr(value),
            key_path,
            f"a whole number from 1 to {largest}",
        )
    return number


def checked_boolean(value: object, key_path: str) -> bool:
    """Return the value as True or False. Numbers and strings are refused.

    Args:
        value: value in the hand file.
        key_path: key path of the value, for the error message.

    Raises:
        ConfigError: the value is neither true nor false.
    """
    if type(value) is not bool:
        raise ConfigError(repr(value), key_path, "true or false")
    return value


def pop_motor_model(
    options: dict[str, Any], key_path: str, models: Mapping[str, ModelRangesType]
) -> ModelRangesType:
    """Remove the option ``motor_type``, and return the ranges of the motor model that the option names.

    Args:
        options: options of the motor, modified in place.
        key_path: key path of the motor, for the error message.
        models: ranges of each model, by the name of the model.

    Raises:
        ConfigError: the model is missing or unknown.
    """
    model = options.pop("motor_type", None)
    if model not in models:
        problem = "missing" if model is None else repr(model)
        raise ConfigError(problem, f"{key_path}.options.motor_type", "one of " + ", ".join(models))
    return models[model]


def refuse_unknown_options(
    options: Mapping[str, Any], key_path: str, declared_options: Mapping[str, MotorOption]
) -> None:
    """Raise an error if the hand file has options that the protocol does not use.

    Args:
        options: options that are left after the code of the protocol has removed the options that
            it uses.
        key_path: key path of the options.
        declared_options: options of the protocol, for the error message.

    Raises:
        ConfigError: the options contain a key that the protocol does not declare.
    """
    if options:
        *names, last_name = declared_options or ("no such key: this protocol has no options",)
        expected = f"{', '.join(names)} or {last_name}" if names else last_name
        raise ConfigError("unknown key", f"{key_path}.{next(iter(options))}", expected)


def check_full_scale(motor: MotorDescription, ranges: FullScale) -> None:
    """Check that the torque limit of a motor is within the full scale of the motor model.

    Raises:
        ConfigError: the torque limit is larger than the full scale.
    """
    if motor.torque_max_N_m > ranges.torque:
        raise ConfigError(
            f"{motor.torque_max_N_m:g}",
            f"motor[{motor.name}].torque_max_N_m",
            f"at most {ranges.torque:g}",
        )
