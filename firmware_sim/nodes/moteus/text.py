"""Diagnostic text channel of a moteus controller: commands in lines, answers in lines. Source: facts, moteus.

Configuration items are in the working memory until ``conf write`` stores them.
"""

import math
from collections.abc import Callable

FACTORY_CONFIGURATION: dict[str, float] = {
    "servo.timeout_mode": 12.0,
    "servo.default_timeout_s": 0.1,
    "servo.timeout_max_torque_Nm": 5.0,
    "servo.fixed_voltage_mode": 0.0,
    "servo.max_current_A": 100.0,
    "servo.pid_position.kp": 4.0,
    "servo.pid_position.ki": 1.0,
    "servo.pid_position.kd": 0.05,
    "servo.fault_temperature": 75.0,
    "servo.motor_fault_temperature": 120.0,
    "servopos.position_min": -0.01,
    "servopos.position_max": 0.01,
    "motor_position.rotor_to_output_ratio": 1.0,
}
"""Configuration items of a drive as delivered, calibrated. Other items do not exist in the simulation."""
INTEGER_ITEMS = {"servo.timeout_mode", "servo.fixed_voltage_mode"}
"""Items with integers."""
LONGEST_LINE = 256
"""Size of the drive's line buffer [bytes]. A longer line is dropped."""


class TextChannel:
    """The text channel.

    Attributes:
        items: configuration in the working memory.
        saved: stored configuration.
        out: answers that the host has not read.
    """

    def __init__(self, stop: Callable[[], None]) -> None:
        """Start with the factory configuration.

        Args:
            stop: stops the motor, for ``d stop``.
        """
        self.items = dict(FACTORY_CONFIGURATION)
        self.saved = dict(FACTORY_CONFIGURATION)
        self.out = b""
        self._stop = stop
        self._line = b""

    def write(self, data: bytes) -> None:
        """Execute the complete lines of a text."""
        *lines, self._line = (self._line + data).replace(b"\r", b"\n").split(b"\n")
        for line in lines:
            if line:
                self.out += self._execute(line.decode("latin-1").split()).encode("latin-1") + b"\r\n"
        if len(self._line) > LONGEST_LINE:
            self._line = b""

    def read(self, longest: int) -> bytes:
        """Return at most `longest` bytes of the answers, and remove these bytes."""
        part = self.out[:longest]
        self.out = self.out[longest:]
        return part

    def forget(self) -> None:
        """Load the stored configuration, as after a restart."""
        self.items = dict(self.saved)
        self.out = self._line = b""

    def _execute(self, words: list[str]) -> str:
        """Execute a command and return its answer without the end of line."""
        match words:
            case ["conf", "get", name]:
                return self._shown(name) if name in self.items else "ERR error reading"
            case ["conf", "set", name, value]:
                return self._set(name, value)
            case ["conf", "write"]:
                self.saved = dict(self.items)
            case ["conf", "load"]:
                self.items = dict(self.saved)
            case ["conf", "default"]:
                self.items = dict(FACTORY_CONFIGURATION)
            case ["d", "stop"]:
                self._stop()
            case ["tel", "stop"]:
                pass
            case _:
                return "ERR unknown command"
        return "OK"

    def _shown(self, name: str) -> str:
        """Return an item as the drive prints it."""
        value = self.items[name]
        return f"{int(value)}" if name in INTEGER_ITEMS else f"{value:f}"

    def _set(self, name: str, text: str) -> str:
        """Set an item and return the answer."""
        try:
            value = float(text)
        except ValueError:
            value = math.inf
        if name not in self.items or math.isinf(value) or (name in INTEGER_ITEMS and not value.is_integer()):
            return "ERR error setting"
        self.items[name] = value
        return "OK"
