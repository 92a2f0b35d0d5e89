"""Settings of a moteus controller: read, written if wrong, and read again.

Torque limit and watchdog are command registers. Every torque command sets both registers. Before
the first torque, a request that does not move the motor sets them. The other settings are
configuration items of the diagnostic text channel. ``conf set`` changes the working memory alone,
and no request writes the flash.

A frame with text may be lost, and an answer may come late. Therefore each exchange starts with an
empty channel: if a request got no answer, the host reads until no text is left.
"""

import math
import struct
from typing import NamedTuple

from handctl.drives.moteus import codec
from handctl.drives.readback import REQUEST_TIMEOUT_NS

WRITE_TRIES = 3
"""Number of writes per setting. The drive does not confirm a write, and a possibly lost write is repeated."""
UNANSWERED_READS = 3
"""Number of reads without text after which a request counts as unanswered, at any control rate."""
LONGEST_LINE = 128
"""Length of text without an end of line above which the text belongs to another host [bytes]."""


class MoteusSetting(NamedTuple):
    """Setting with its required value.

    Attributes:
        name: name of the configuration item, or of the register.
        value: required value.
        register: number of the register, 0 for a configuration item.
    """

    name: str
    value: float
    register: int = 0

    def is_right(self, value: float) -> bool:
        """Return True if a value equals the required one in float32 precision."""
        return value == self.value or (math.isnan(value) and math.isnan(self.value))


CONFIGURATION = (
    # Beyond these positions the drive would reduce the torque. The default is 0.01 turns.
    MoteusSetting("servopos.position_min", math.nan),
    # Torque limits do not act in this mode.
    MoteusSetting("servo.fixed_voltage_mode", 0.0),
    # After a timeout of the watchdog the drive stops. By default it would damp, or hold its
    # position.
    MoteusSetting("servo.timeout_mode", 0.0),
    MoteusSetting("servopos.position_max", math.nan),
)
"""Configuration items, read again while the drive is enabled.

Torque limit and watchdog need no repeated read-back, because every command carries both. After a
restart the items have their defaults. One of two consecutive items has a default that differs from
the required value, so a restart is found by at most two reads.
"""


def required_settings(torque: float, timeout_s: float) -> tuple[MoteusSetting, ...]:
    """Return the settings required before arming.

    Args:
        torque: torque limit [N m].
        timeout_s: watchdog [s].
    """
    return (
        MoteusSetting("torque limit", rounded_to_float32(torque), codec.MAX_TORQUE),
        MoteusSetting("watchdog", rounded_to_float32(timeout_s), codec.TIMEOUT),
        *CONFIGURATION,
    )


def rounded_to_float32(value: float) -> float:
    """Return a value rounded to float32 precision."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def read_request(setting: MoteusSetting) -> bytes:
    """Return the text command that reads a configuration item."""
    return f"conf get {setting.name}\n".encode()


def write_request(setting: MoteusSetting) -> bytes:
    """Return the text command that changes a configuration item in the working memory."""
    return f"conf set {setting.name} {setting.value:g}\n".encode()


def value_in_answer(line: bytes) -> float | None:
    """Return the number in an answer, or None for any other text."""
    try:
        return float(line)
    except ValueError:
        return None


class Channel(NamedTuple):
    """State of the exchange over the diagnostic text channel.

    Attributes:
        empty: True if no text of an earlier request can still arrive.
        asked_ns: time of the open request [ns], -1 without one.
        polls: number of reads for the answer of the open request.
        text: part of the answer received so far.
    """

    empty: bool = False
    asked_ns: int = -1
    polls: int = 0
    text: bytes = b""

    def ask(self, command: bytes, t_ns: int) -> tuple["Channel", bytes]:
        """Return the channel and the next payload: the request, or a read that first empties the channel."""
        if not self.empty:
            return Channel(), codec.TEXT_REQUEST
        return Channel(True, t_ns), codec.text_request(command)

    def awaits(self, t_ns: int) -> bool:
        """Return True if the host must read the answer of the open request in this tick."""
        late = t_ns - self.asked_ns > REQUEST_TIMEOUT_NS and self.polls >= UNANSWERED_READS
        return 0 <= self.asked_ns < t_ns and not late

    def poll(self) -> tuple["Channel", bytes]:
        """Return the channel and the payload that reads an answer."""
        return self._replace(polls=self.polls + 1), codec.TEXT_REQUEST

    def take(self, text: bytes) -> tuple["Channel", bytes]:
        """Return the channel and the first complete line of an answer, empty if no line is complete."""
        if self.asked_ns < 0:
            return self._replace(empty=not text), b""
        line, end, _ = (self.text + text).partition(b"\n")
        if end:
            return Channel(True), line.strip()
        if len(line) > LONGEST_LINE:
            return Channel(), b""
        return self._replace(text=line), b""
