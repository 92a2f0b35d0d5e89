"""Options of an ODrive in the hand file."""

from collections.abc import MutableMapping
from typing import Any, NamedTuple

from handctl.drives.odrive import settings as endpoints
from handctl.drives.odrive.firmware_05 import FIRMWARE
from handctl.drives.options import positive, whole
from handctl.errors import ConfigError

MOST = 1000
"""Largest plausible ratio, current [A], and period [ms]."""
KNOWN = "gear_ratio, current_limit_A, heartbeat_ms, encoder_period_ms, firmware, torque_feedback or endpoint_..."
"""Option names, for messages."""


class Options(NamedTuple):
    """Values of the options.

    Attributes:
        ratio: turns of the motor's shaft per turn of the spool.
        current: current limit [A].
        heartbeat: period of the heartbeat [ms].
        torque_feedback: True to request torque in every tick.
        cyclic_s: period of the drive's own messages [s], 0 to request position in every tick.
        old: True for firmware 0.5.
    """

    ratio: float
    current: float
    heartbeat: int
    torque_feedback: bool
    cyclic_s: float
    old: bool


def take_options(options: MutableMapping[str, Any], where: str) -> Options:
    """Read the options and remove their keys. Keys of endpoints remain.

    Args:
        options: options of the motor.
        where: key path of the options.

    Raises:
        ConfigError: an invalid value, or an option unknown to the firmware.
    """
    firmware, feedback = options.pop("firmware", FIRMWARE[0]), options.pop("torque_feedback", False)
    if firmware not in FIRMWARE:
        raise ConfigError(repr(firmware), f"{where}.firmware", " or ".join(map(repr, FIRMWARE)))
    old = firmware == "0.5"
    if type(feedback) is not bool or (feedback and old):
        right = "false: firmware 0.5 tells no torque" if feedback is True else "true or false"
        raise ConfigError(repr(feedback), f"{where}.torque_feedback", right)
    if old and (keys := [key for key in options if key in endpoints.KEYS]):
        raise ConfigError("firmware 0.5 has no SDO", f"{where}.{keys[0]}", "no such key")
    cyclic = options.pop("encoder_period_ms", None)
    if cyclic is not None:
        cyclic = whole(cyclic, f"{where}.encoder_period_ms", MOST)
    return Options(
        ratio=positive(options.pop("gear_ratio", 1.0), f"{where}.gear_ratio", MOST),
        current=positive(options.pop("current_limit_A", 10.0), f"{where}.current_limit_A", MOST),
        heartbeat=whole(options.pop("heartbeat_ms", 100), f"{where}.heartbeat_ms", MOST),
        torque_feedback=feedback,
        cyclic_s=(cyclic or 0) / 1e3,
        old=old,
    )
