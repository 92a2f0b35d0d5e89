"""Options in the hand file for a motor on an ODrive."""

from collections.abc import MutableMapping
from typing import Any, NamedTuple

from handctl.drives.odrive import settings as endpoints
from handctl.drives.odrive.firmware_05 import FIRMWARE_VERSIONS
from handctl.drives.option_checks import MotorOption, checked_positive, checked_whole_number
from handctl.errors import ConfigError

MAX_OPTION_VALUE = 1000
"""Largest accepted value of a ratio, a current [A], and a period [ms]."""
_PERIOD_RANGE_TEXT = f"a whole number from 1 to {MAX_OPTION_VALUE}"
OPTIONS = {
    "firmware": MotorOption('"0.6" (default) or "0.5"', "Version of the firmware of the drive."),
    "gear_ratio": MotorOption(
        f"above 0, at most {MAX_OPTION_VALUE} (default: 1)",
        "Turns of the motor per turn of the spool.",
    ),
    "current_limit_A": MotorOption(
        f"above 0, at most {MAX_OPTION_VALUE} (default: 10)",
        "Current limit that handctl writes into the drive [A].",
    ),
    "heartbeat_ms": MotorOption(
        f"{_PERIOD_RANGE_TEXT} (default: 100)", "Period of the heartbeat that the drive sends."
    ),
    "encoder_period_ms": MotorOption(
        _PERIOD_RANGE_TEXT,
        "Period with which the drive sends its position. If absent, handctl requests the position in each tick.",
    ),
    "torque_feedback": MotorOption(
        "true or false (default)",
        "True if handctl also requests the measured torque. Firmware 0.5 does not report it.",
    ),
    **{
        key: MotorOption(
            "a whole number from 1 to 65535",
            f"Number of the endpoint `{key.removeprefix('endpoint_')}` in the file `flat_endpoints.json` of the "
            "firmware 0.6 of the drive. If absent, handctl cannot verify this setting.",
        )
        for key in endpoints.ENDPOINT_KEYS
    },
}
"""Options of an ODrive in the hand file."""


class OdriveOptions(NamedTuple):
    """Values of the options of a motor on an ODrive.

    Attributes:
        ratio: turns of the motor's shaft per turn of the spool.
        current: current limit of the drive [A].
        heartbeat: period of the heartbeats [ms].
        torque_feedback: True to request the torque in every tick.
        encoder_period_s: period of the drive's unrequested position messages [s], 0 to request the position
            in every tick.
        firmware_05: True for firmware 0.5.
    """

    ratio: float
    current: float
    heartbeat: int
    torque_feedback: bool
    encoder_period_s: float
    firmware_05: bool


def pop_options(options: MutableMapping[str, Any], key_path: str) -> OdriveOptions:
    """Remove the known options except the endpoint numbers from ``options``, and return the removed values.

    Args:
        options: options of the motor, modified in place.
        key_path: key path of the options, for error messages.

    Raises:
        ConfigError: the value of an option is invalid, or the firmware does not have an option.
    """
    firmware = options.pop("firmware", FIRMWARE_VERSIONS[0])
    feedback = options.pop("torque_feedback", False)
    if firmware not in FIRMWARE_VERSIONS:
        raise ConfigError(
            repr(firmware), f"{key_path}.firmware", " or ".join(map(repr, FIRMWARE_VERSIONS))
        )
    firmware_05 = firmware == "0.5"
    if type(feedback) is not bool or (feedback and firmware_05):
        expected_text = (
            "false: firmware 0.5 does not report torque" if feedback is True else "true or false"
        )
        raise ConfigError(repr(feedback), f"{key_path}.torque_feedback", expected_text)
    if firmware_05 and (keys := [key for key in options if key in endpoints.ENDPOINT_KEYS]):
        raise ConfigError("firmware 0.5 has no SDO", f"{key_path}.{keys[0]}", "no such key")
    encoder_period_ms = options.pop("encoder_period_ms", None)
    if encoder_period_ms is not None:
        encoder_period_ms = checked_whole_number(
            encoder_period_ms, f"{key_path}.encoder_period_ms", MAX_OPTION_VALUE
        )
    return OdriveOptions(
        ratio=checked_positive(
            options.pop("gear_ratio", 1.0), f"{key_path}.gear_ratio", MAX_OPTION_VALUE
        ),
        current=checked_positive(
            options.pop("current_limit_A", 10.0), f"{key_path}.current_limit_A", MAX_OPTION_VALUE
        ),
        heartbeat=checked_whole_number(
            options.pop("heartbeat_ms", 100), f"{key_path}.heartbeat_ms", MAX_OPTION_VALUE
        ),
        torque_feedback=feedback,
        encoder_period_s=(encoder_period_ms or 0) / 1e3,
        firmware_05=firmware_05,
    )
