"""Settings of an ODrive that no CANSimple message can set: read by SDO, written if wrong, read again.

The numbers of the endpoints belong to one firmware and one board (``flat_endpoints.json``), so the hand file gives
them. Without them the drive's watchdog is whatever was set over USB, and nobody on the bus can know it.
"""

import struct
from collections.abc import MutableMapping
from typing import Any, NamedTuple

from handctl.drives.odrive import codec
from handctl.errors import ConfigError

REQUEST_TIMEOUT_NS = 20_000_000
REQUEST_TRIES = 10
WRITES = 3
"""No drive tells that a write has arrived: one that may have been lost is sent again, so often in all."""
KEYS = ("endpoint_enable_watchdog", "endpoint_watchdog_timeout", "endpoint_torque_max", "endpoint_torque_min")


class Setting(NamedTuple):
    """Endpoint, the bytes that it must hold, and what to call it."""

    endpoint: int
    raw: bytes
    name: str


class Walk(NamedTuple):
    """How far the settings are known: index, how often this one was written, when and how often it was asked."""

    step: int = 0
    written: int = 0
    sent_ns: int = -1
    tries: int = 0


def take_settings(
    options: MutableMapping[str, Any], where: str, watchdog_s: float, torque: float
) -> tuple[Setting, ...]:
    """Settings whose endpoints the options name; their keys are taken out.

    Args:
        options: of the motor.
        where: key path of the options.
        watchdog_s: time-out [s].
        torque: limit at the motor's shaft [N m].

    Raises:
        ConfigError: an endpoint that is no number, or half a watchdog.
    """
    values = (b"\1", codec.floats(watchdog_s), codec.floats(torque), codec.floats(-torque))
    found = []
    for key, raw in zip(KEYS, values, strict=True):
        endpoint = options.pop(key, None)
        if endpoint is None:
            continue
        if type(endpoint) is not int or not 0 < endpoint <= 0xFFFF:
            raise ConfigError(repr(endpoint), f"{where}.{key}", "a number from flat_endpoints.json, 1 to 65535")
        found.append(Setting(endpoint, raw, key.removeprefix("endpoint_")))
    names = {setting.name for setting in found}
    if len(names & {"enable_watchdog", "watchdog_timeout"}) == 1:
        raise ConfigError("half a watchdog", f"{where}.{KEYS[0]}", f"both {KEYS[0]} and {KEYS[1]}, or neither")
    return tuple(found)


def unverified(settings: tuple[Setting, ...]) -> tuple[str, ...]:
    """What these settings leave unknown, for a person to read before arming."""
    names = {setting.name for setting in settings}
    told = []
    if "watchdog_timeout" not in names:
        told.append("watchdog not verified: CANSimple cannot read it; a dead host may leave torque on")
    if not {"torque_max", "torque_min"} <= names:
        told.append("the drive's own torque limit is not verified: CANSimple cannot read it")
    return tuple(told)


def take(walk: Walk, settings: tuple[Setting, ...], data: bytes) -> tuple[Walk, bytes, str]:
    """Take in a TxSdo.

    Returns:
        the walk from here; payload of RxSdo to send at once, empty if none; what is wrong, empty if nothing is.
    """
    setting = settings[walk.step]
    endpoint, raw = codec.sdo_reply(data)
    if walk.sent_ns < 0 or endpoint != setting.endpoint or len(raw) < len(setting.raw):
        return walk, b"", ""
    if raw[: len(setting.raw)] == setting.raw:
        return Walk(walk.step + 1), b"", ""
    if walk.written == WRITES:
        wrong = f"{setting.name} reads {shown(raw, setting)} after writing, expected {shown(setting.raw, setting)}"
        return walk, b"", wrong
    write = codec.sdo_request(codec.SDO_WRITE, setting.endpoint, setting.raw)
    return Walk(walk.step, walk.written + 1), write, ""


def ask(walk: Walk, settings: tuple[Setting, ...], t_ns: int) -> tuple[Walk, bytes, str]:
    """The read request that is due; as ``take``."""
    setting = settings[walk.step]
    if walk.sent_ns >= 0 and t_ns - walk.sent_ns < REQUEST_TIMEOUT_NS:
        return walk, b"", ""
    if walk.tries >= REQUEST_TRIES:
        return walk, b"", f"endpoint {setting.endpoint} ({setting.name}) is not answered"
    return walk._replace(sent_ns=t_ns, tries=walk.tries + 1), codec.sdo_request(codec.SDO_READ, setting.endpoint), ""


def shown(raw: bytes, setting: Setting) -> str:
    """A value for people."""
    if len(setting.raw) == 1:
        return str(raw[0])
    return f"{struct.unpack_from('<f', raw)[0]:g}"
