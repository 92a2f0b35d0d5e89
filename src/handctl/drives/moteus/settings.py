"""Settings of a moteus controller.

Before arming, the host reads each setting of the drive. If a setting has a wrong value, the host
writes the setting and reads it again.

Torque limit and watchdog timeout are command registers. Every torque command sets both registers.
Before the first torque command, the host sets torque limit and watchdog timeout with a request that
does not move the motor. All other settings are configuration items, which the host reads and writes
over the diagnostic text channel. ``conf set`` changes only the working memory of the drive. handctl
sends no request that writes the flash.

A frame with text can be lost, and an answer can come late. Each exchange of texts must start with
an empty text channel. After a request without an answer, the host reads the text channel until no
text is left.
"""

import math
import struct
from typing import NamedTuple

from handctl.drives.moteus import codec
from handctl.drives.readback import REQUEST_TIMEOUT_NS

WRITE_TRIES = 3
"""Largest number of writes per setting. The drive does not confirm a write, and the frame of a write can be lost."""
MAX_UNANSWERED_POLLS = 3
"""Number of reads that return no text before a request counts as unanswered, at any control rate."""
MAX_ANSWER_LINE_BYTES = 128
"""Length above which a received text without a line end counts as an answer to another host [bytes]."""


class MoteusSetting(NamedTuple):
    """Setting of a drive, with its required value.

    Attributes:
        name: name of the configuration item, or of the register.
        value: required value of the setting.
        register: number of the register, 0 for a configuration item.
    """

    name: str
    value: float
    register: int = 0

    def is_required_value(self, value: float) -> bool:
        """Return True if a value equals the required value in float32 precision."""
        is_equal = rounded_to_float32(value) == rounded_to_float32(self.value)
        return is_equal or (math.isnan(value) and math.isnan(self.value))


REQUIRED_CONFIGURATION = (
    # If the motor is beyond the positions ``position_min`` and ``position_max``, the drive reduces
    # the torque. The default of ``position_min`` and ``position_max`` is 0.01 turns.
    MoteusSetting("servopos.position_min", math.nan),
    # In the fixed voltage mode of the drive, torque limits have no effect.
    MoteusSetting("servo.fixed_voltage_mode", 0.0),
    # With the value 0 of the timeout mode, the drive stops when its watchdog fires. By default, the
    # drive damps the motor or holds its position when the watchdog fires.
    MoteusSetting("servo.timeout_mode", 0.0),
    MoteusSetting("servopos.position_max", math.nan),
)
"""Configuration items that the host reads before arming and again while the drive is enabled.

Torque limit and watchdog need no repeated read-back, because every command contains both. After a
restart of the drive, the configuration items have their default values. Of two consecutive items,
at least one has a default value that differs from the required value. At most two reads of items
are thus needed to detect a restart.
"""


def position_configuration(gains: codec.PositionGains) -> tuple[MoteusSetting, ...]:
    """Return the configuration items of a drive that closes a position loop.

    The host reads the configuration items again while the drive is enabled. With a limit of
    velocity or acceleration, the drive would plan its own trajectory to the commanded position.
    With a finite limit of the position slip, the drive would move the commanded position towards
    the position of a motor that lags behind. Of two consecutive items, at least one has a default
    value that differs from the required value, see ``REQUIRED_CONFIGURATION``.
    """
    min_position_key, fixed_voltage, timeout_mode, max_position_key = REQUIRED_CONFIGURATION
    return (
        min_position_key,
        fixed_voltage,
        timeout_mode,
        MoteusSetting("servo.default_velocity_limit", math.nan),
        MoteusSetting("servo.pid_position.kp", gains.kp),
        MoteusSetting("servo.max_position_slip", math.nan),
        MoteusSetting("servo.pid_position.kd", gains.kd),
        MoteusSetting("servo.default_accel_limit", math.nan),
        max_position_key,
    )


def gain_per_turn(gain: float) -> float:
    """Convert a gain per radian to a gain per turn, rounded up to six digits and six decimals.

    The rounded gain loses no digit in the texts to and from the drive, and no digit as a float32.
    """
    exact_gain = math.tau * gain
    step = 10.0 ** max(-6, math.floor(math.log10(exact_gain)) - 5) if exact_gain else 1.0
    return float(f"{math.ceil(exact_gain / step) * step:.6g}")


def required_settings(
    torque: float, timeout_s: float, configured_settings: tuple[MoteusSetting, ...]
) -> tuple[MoteusSetting, ...]:
    """Return the settings of the drive, with the values required before arming.

    Args:
        torque: torque limit [N m].
        timeout_s: timeout of the watchdog [s].
        configured_settings: required configuration items.
    """
    return (
        MoteusSetting("torque limit", rounded_to_float32(torque), codec.MAX_TORQUE),
        MoteusSetting("watchdog", rounded_to_float32(timeout_s), codec.TIMEOUT),
        *configured_settings,
    )


def rounded_to_float32(value: float) -> float:
    """Return a value rounded to the precision of a float32."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def read_request(setting: MoteusSetting) -> bytes:
    """Return the text command to read a configuration item."""
    return f"conf get {setting.name}\n".encode()


def write_request(setting: MoteusSetting) -> bytes:
    """Return the text command that changes a configuration item in the working memory."""
    value = f"{setting.value:.6f}".rstrip("0").rstrip(".")
    return f"conf set {setting.name} {value}\n".encode()


def value_in_answer(answer_line: bytes) -> float | None:
    """Return the number in an answer of the drive, or None if the answer is no number."""
    try:
        return float(answer_line)
    except ValueError:
        return None


class DiagnosticChannel(NamedTuple):
    """State of the exchange over the diagnostic text channel.

    Attributes:
        is_drained: True if no text of an earlier request can still arrive.
        request_sent_ns: time at which the host sent the unanswered request [ns], -1 if every
            request has an answer.
        poll_count: number of reads of the text channel since the unanswered request.
        text: received part of the answer.
    """

    is_drained: bool = False
    request_sent_ns: int = -1
    poll_count: int = 0
    text: bytes = b""

    def next_request_payload(self, command: bytes, t_ns: int) -> tuple["DiagnosticChannel", bytes]:
        """Return the next state of the text channel, and the payload to send.

        If the text channel can still contain the answer to an earlier request, the payload is a
        read request, which removes this text. Otherwise, the payload is the request ``command``.
        """
        if not self.is_drained:
            return DiagnosticChannel(), codec.TEXT_REQUEST
        return DiagnosticChannel(True, t_ns), codec.text_request(command)

    def is_awaiting_answer(self, t_ns: int) -> bool:
        """Return True if the host must read the text channel now, because a request has no answer yet."""
        is_late = (
            t_ns - self.request_sent_ns > REQUEST_TIMEOUT_NS
            and self.poll_count >= MAX_UNANSWERED_POLLS
        )
        return 0 <= self.request_sent_ns < t_ns and not is_late

    def poll(self) -> tuple["DiagnosticChannel", bytes]:
        """Return the next state of the text channel, and the payload that reads the answer to the request."""
        return self._replace(poll_count=self.poll_count + 1), codec.TEXT_REQUEST

    def take_line(self, text: bytes) -> tuple["DiagnosticChannel", bytes]:
        """Return the next state of the text channel, and the first line of the answer.

        The returned line is empty if the received text does not yet contain a complete line.
        """
        if self.request_sent_ns < 0:
            return self._replace(is_drained=not text), b""
        line, end, _ = (self.text + text).partition(b"\n")
        if end:
            return DiagnosticChannel(True), line.strip()
        if len(line) > MAX_ANSWER_LINE_BYTES:
            return DiagnosticChannel(), b""
        return self._replace(text=line), b""
