"""ODrive settings for which CANSimple has no message.

The host reads the settings of the watchdog and of the torque limit by SDO. The host corrects wrong
values, and reads the corrected settings again.

The number of each endpoint differs between firmware versions and boards (``flat_endpoints.json``).
The hand file contains the endpoint numbers of a drive. If the hand file contains no endpoint
numbers, handctl cannot verify the watchdog of the drive over CAN. The operator must then set the
watchdog over USB.
"""

import struct
from collections.abc import MutableMapping
from typing import Any, NamedTuple

from handctl.drives import readback
from handctl.drives.contract import DriveProperty
from handctl.drives.odrive import codec
from handctl.drives.readback import ReadbackCursor
from handctl.errors import ConfigError

WRITE_TRIES = 3
"""Largest number of writes per setting. The drive does not confirm a write, and the frame of a write can be lost."""
ENDPOINT_KEYS = (
    "endpoint_enable_watchdog",
    "endpoint_watchdog_timeout",
    "endpoint_torque_max",
    "endpoint_torque_min",
)
"""Names of the options whose value is an endpoint number."""
WATCHDOG_KEYS = ENDPOINT_KEYS[:2]
"""Names of the options with the endpoints of the watchdog."""


class OdriveSetting(NamedTuple):
    """Setting of an ODrive: endpoint number, bytes of the required value, and name."""

    endpoint: int
    raw: bytes
    name: str


def pop_settings(
    options: MutableMapping[str, Any], key_path: str, watchdog_s: float, torque: float
) -> tuple[OdriveSetting, ...]:
    """Return the settings whose endpoint numbers are in the options, and remove the endpoint numbers from the options.

    Args:
        options: options of the motor, modified in place.
        key_path: key path of the options, for error messages.
        watchdog_s: required timeout of the watchdog [s].
        torque: required torque limit at the motor's shaft [N m].

    Raises:
        ConfigError: an endpoint number is invalid, or the options contain only one of the two
            watchdog endpoints.
    """
    values = (
        b"\1",
        codec.encode_floats(watchdog_s),
        codec.encode_floats(torque),
        codec.encode_floats(-torque),
    )
    settings = []
    for key, raw_bytes in zip(ENDPOINT_KEYS, values, strict=True):
        endpoint = options.pop(key, None)
        if endpoint is None:
            continue
        if type(endpoint) is not int or not 0 < endpoint <= 0xFFFF:
            raise ConfigError(
                repr(endpoint), f"{key_path}.{key}", "a number from flat_endpoints.json, 1 to 65535"
            )
        settings.append(OdriveSetting(endpoint, raw_bytes, key.removeprefix("endpoint_")))
    names = {setting.name for setting in settings}
    if len(names & {"enable_watchdog", "watchdog_timeout"}) == 1:
        raise ConfigError(
            "one of two watchdog endpoints",
            f"{key_path}.{ENDPOINT_KEYS[0]}",
            f"both {ENDPOINT_KEYS[0]} and {ENDPOINT_KEYS[1]}, or neither",
        )
    return tuple(settings)


def unverified_protections(
    settings: tuple[OdriveSetting, ...], firmware_05: bool
) -> tuple[str, ...]:
    """Return one line for each of the drive's protections that handctl cannot verify."""
    names = {setting.name for setting in settings}
    protections = []
    if "watchdog_timeout" not in names:
        remedy = (
            "set it over USB" if firmware_05 else f"give {ENDPOINT_KEYS[0]} and {ENDPOINT_KEYS[1]}"
        )
        protections.append(
            f"watchdog not verified: CANSimple cannot read it; a dead host may leave torque on; {remedy}"
        )
    if not {"torque_max", "torque_min"} <= names:
        remedy = (
            "set it over USB" if firmware_05 else f"give {ENDPOINT_KEYS[2]} and {ENDPOINT_KEYS[3]}"
        )
        protections.append(
            f"the drive's own torque limit is not verified: CANSimple cannot read it; {remedy}"
        )
    return tuple(protections)


def unchecked_properties(
    settings: tuple[OdriveSetting, ...], firmware_05: bool
) -> dict[DriveProperty, str]:
    """Return a reason for each of the drive's properties that handctl cannot check.

    The reason names the missing options of the motor. With firmware 0.5, the operator sets the
    watchdog over USB, so handctl can check that the watchdog works.
    """
    if firmware_05:
        return {DriveProperty.READBACK: "firmware 0.5 has no message that reads its settings"}
    names = {setting.name for setting in settings}
    missing_names = [key for key in ENDPOINT_KEYS if key.removeprefix("endpoint_") not in names]
    reasons = {}
    if missing_names:
        reasons[DriveProperty.READBACK] = f"missing options {', '.join(missing_names)}"
    if set(WATCHDOG_KEYS) & set(missing_names):
        reasons[DriveProperty.WATCHDOG] = (
            f"handctl cannot switch the watchdog on: missing options {', '.join(WATCHDOG_KEYS)}"
        )
    return reasons


def on_reply(
    cursor: ReadbackCursor, settings: tuple[OdriveSetting, ...], data: bytes
) -> tuple[ReadbackCursor, str]:
    """Return the new position in the read-back, after the host has received a TxSdo.

    A TxSdo that answers another request has no effect.

    Returns:
        The new position in the read-back, and the problem in words (empty if there is no problem).
    """
    setting = settings[cursor.step]
    endpoint, raw_bytes = codec.decode_sdo_reply(data)
    if not cursor.is_waiting or endpoint != setting.endpoint or len(raw_bytes) < len(setting.raw):
        return cursor, ""
    if raw_bytes[: len(setting.raw)] == setting.raw:
        return cursor.next_setting(), ""
    return readback.cursor_after_wrong_value(
        cursor,
        setting.name,
        value_as_text(raw_bytes, setting),
        value_as_text(setting.raw, setting),
        WRITE_TRIES,
    )


def next_request(
    cursor: ReadbackCursor, settings: tuple[OdriveSetting, ...], t_ns: int
) -> tuple[ReadbackCursor, bytes, str]:
    """Return the new read-back cursor, the payload of the next request, and the text of a problem.

    The payload is empty while the host waits for an answer of the drive. The text is empty if no
    problem has occurred.
    """
    setting = settings[cursor.step]
    if cursor.must_write:  # the drive does not answer a write request
        return (
            cursor.cursor_after_write(),
            codec.sdo_request(codec.SDO_WRITE, setting.endpoint, setting.raw),
            "",
        )
    cursor, must_send, problem = readback.request_setting(
        cursor, f"endpoint {setting.endpoint} ({setting.name})", t_ns
    )
    return (
        cursor,
        codec.sdo_request(codec.SDO_READ, setting.endpoint) if must_send else b"",
        problem,
    )


def value_as_text(value_bytes: bytes, setting: OdriveSetting) -> str:
    """Return the value of a setting as text.

    A setting with one byte is a flag. A setting with four bytes is a float32.
    """
    if len(setting.raw) == 1:
        return str(value_bytes[0])
    return f"{struct.unpack_from('<f', value_bytes)[0]:g}"
