"""The diagnostic text channel of a moteus controller.

Commands and answers are lines of text. Source: docs/facts/moteus.md.

A change of a configuration item is only in the working memory until ``conf write`` stores the
change.
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
    "servo.default_velocity_limit": math.nan,
    "servo.default_accel_limit": 50.0,
    "servo.max_position_slip": math.nan,
    "servo.fault_temperature": 75.0,
    "servo.motor_fault_temperature": 120.0,
    "servopos.position_min": -0.01,
    "servopos.position_max": 0.01,
    "motor_position.rotor_to_output_ratio": 1.0,
}
"""Configuration items of a calibrated drive as delivered. The simulation has no other items."""
INTEGER_CONFIGURATION_ITEMS = {"servo.timeout_mode", "servo.fixed_voltage_mode"}
"""Configuration items whose values are integers."""
MAX_COMMAND_LINE_BYTES = 256
"""Size of the drive's line buffer [bytes]. The drive drops a longer command line."""


class TextChannel:
    """The simulated diagnostic text channel of one moteus controller.

    Attributes:
        items: configuration items in the working memory.
        saved: configuration items in the permanent memory.
        out: answers of the drive that the host has not read yet, as one text.
    """

    def __init__(self, stop_drive: Callable[[], None]) -> None:
        """Start with the factory configuration.

        Args:
            stop_drive: function that stops the motor, for the command ``d stop``.
        """
        self.items = dict(FACTORY_CONFIGURATION)
        self.saved = dict(FACTORY_CONFIGURATION)
        self.out = b""
        self._stop = stop_drive
        self._line = b""

    def write(self, data: bytes) -> None:
        """Execute the complete lines of a text, and keep an incomplete last line."""
        *lines, self._line = (self._line + data).replace(b"\r", b"\n").split(b"\n")
        for line in lines:
            if line:
                self.out += (
                    self._execute_command_line(line.decode("latin-1").split()).encode("latin-1")
                    + b"\r\n"
                )
        if len(self._line) > MAX_COMMAND_LINE_BYTES:
            self._line = b""

    def read(self, max_bytes: int) -> bytes:
        """Remove at most ``max_bytes`` bytes from the unread answers, and return these bytes."""
        sent_bytes = self.out[:max_bytes]
        self.out = self.out[max_bytes:]
        return sent_bytes

    def restore_saved(self) -> None:
        """Load the stored configuration, and delete all text in the channel.

        The same happens when the drive restarts.
        """
        self.items = dict(self.saved)
        self.out = self._line = b""

    def _execute_command_line(self, command_words: list[str]) -> str:
        """Execute a command line of the host, and return the answer without its line end."""
        match command_words:
            case ["conf", "get", name]:
                return self._configuration_text(name) if name in self.items else "ERR error reading"
            case ["conf", "set", name, value]:
                return self._set_configuration_item(name, value)
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

    def _configuration_text(self, name: str) -> str:
        """Return the value of a configuration item as the drive prints it."""
        value = self.items[name]
        return f"{int(value)}" if name in INTEGER_CONFIGURATION_ITEMS else f"{value:f}"

    def _set_configuration_item(self, name: str, text: str) -> str:
        """Set a configuration item and return the answer to the host."""
        try:
            value = float(text)
        except ValueError:
            value = math.inf
        if (
            name not in self.items
            or math.isinf(value)
            or (name in INTEGER_CONFIGURATION_ITEMS and not value.is_integer())
        ):
            return "ERR error setting"
        self.items[name] = value
        return "OK"
