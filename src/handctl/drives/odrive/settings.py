"""ODrive settings without a CANSimple message: read by SDO, written if wrong, read again.

Endpoint numbers differ between firmware versions and boards (``flat_endpoints.json``), so the hand
file gives them. Without them the operator must set the drive's watchdog over USB, and handctl
cannot verify it over CAN.
"""

import struct
from collections.abc import MutableMapping
from typing import Any, NamedTuple

from handctl.drives import readback
from handctl.drives.odrive import codec
from handctl.drives.readback import Cursor
from handctl.errors import ConfigError

WRITE_TRIES = 3
"""Number of writes per setting. The drive does not confirm a write, and a possibly lost write is repeated."""
ENDPOINT_KEYS = ("endpoint_enable_watchdog", "endpoint_watchdog_timeout", "endpoint_torque_max", "endpoint_torque_min")
"""Names of the options whose value is an endpoint number."""


class Setting(NamedTuple):
    """Setting with its endpoint number, its required bytes, and its name."""

    endpoint: int
    raw: bytes
    name: str


def pop_settings(
    options: MutableMapping[str, Any], where: str, watchdog_s: float, torque: float
) -> tuple[Setting, ...]:
    """Return the settings whose endpoints the options name, and remove their keys.

    Args:
        options: options of the motor.
        where: key path of the options.
        watchdog_s: watchdog time [s].
        torque: torque limit at the motor's shaft [N m].

    Raises:
        ConfigError: an endpoint without a valid number, or one of the two watchdog endpoints
            missing.
    """
    values = (b"\1", codec.encode_floats(watchdog_s), codec.encode_floats(torque), codec.encode_floats(-torque))
    settings = []
    for key, raw in zip(ENDPOINT_KEYS, values, strict=True):
        endpoint = options.pop(key, None)
        if endpoint is None:
            continue
        if type(endpoint) is not int or not 0 < endpoint <= 0xFFFF:
            raise ConfigError(repr(endpoint), f"{where}.{key}", "a number from flat_endpoints.json, 1 to 65535")
        settings.append(Setting(endpoint, raw, key.removeprefix("endpoint_")))
    names = {setting.name for setting in settings}
    if len(names & {"enable_watchdog", "watchdog_timeout"}) == 1:
        raise ConfigError(
            "one of two watchdog endpoints",
            f"{where}.{ENDPOINT_KEYS[0]}",
            f"both {ENDPOINT_KEYS[0]} and {ENDPOINT_KEYS[1]}, or neither",
        )
    return tuple(settings)


def unverified_protections(settings: tuple[Setting, ...], firmware_05: bool) -> tuple[str, ...]:
    """Return the protections of the drive that handctl cannot verify, one line each."""
    names = {setting.name for setting in settings}
    guards = []
    if "watchdog_timeout" not in names:
        remedy = "set it over USB" if firmware_05 else f"give {ENDPOINT_KEYS[0]} and {ENDPOINT_KEYS[1]}"
        guards.append(f"watchdog not verified: CANSimple cannot read it; a dead host may leave torque on; {remedy}")
    if not {"torque_max", "torque_min"} <= names:
        remedy = "set it over USB" if firmware_05 else f"give {ENDPOINT_KEYS[2]} and {ENDPOINT_KEYS[3]}"
        guards.append(f"the drive's own torque limit is not verified: CANSimple cannot read it; {remedy}")
    return tuple(guards)


def on_reply(cursor: Cursor, settings: tuple[Setting, ...], data: bytes) -> tuple[Cursor, str]:
    """Advance the read-back with a TxSdo. Replies to other requests are ignored.

    Returns:
        the new cursor, and the problem in words, empty without a problem.
    """
    setting = settings[cursor.step]
    endpoint, raw = codec.decode_sdo_reply(data)
    if not cursor.waiting or endpoint != setting.endpoint or len(raw) < len(setting.raw):
        return cursor, ""
    if raw[: len(setting.raw)] == setting.raw:
        return cursor.next_setting(), ""
    return readback.on_wrong_value(
        cursor, setting.name, value_as_text(raw, setting), value_as_text(setting.raw, setting), WRITE_TRIES
    )


def next_request(cursor: Cursor, settings: tuple[Setting, ...], t_ns: int) -> tuple[Cursor, bytes, str]:
    """Return the next request of the read-back: cursor, payload, and problem in words.

    The payload is empty while the drive has not answered. The problem is empty if nothing is wrong.
    """
    setting = settings[cursor.step]
    if cursor.writing:  # a write has no answer
        return cursor.after_write(), codec.sdo_request(codec.SDO_WRITE, setting.endpoint, setting.raw), ""
    cursor, send, problem = readback.request_setting(cursor, f"endpoint {setting.endpoint} ({setting.name})", t_ns)
    return cursor, codec.sdo_request(codec.SDO_READ, setting.endpoint) if send else b"", problem


def value_as_text(raw: bytes, setting: Setting) -> str:
    """Return the value of a setting as text. One byte is a flag, four bytes are a float32."""
    if len(setting.raw) == 1:
        return str(raw[0])
    return f"{struct.unpack_from('<f', raw)[0]:g}"
