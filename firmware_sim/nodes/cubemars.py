"""A motor with the firmware of a CubeMars AK drive in MIT mode.

The motor has no registers and no watchdog, and its feedback contains no state.

Commands have the layout of ``mit.codec``. Feedback (8 bytes, highest byte and bit first):

    byte 0     identifier
    byte 1..2  position   16 bit, -range..range [rad]
    byte 3..5  velocity   12 bit, torque 12 bit
    byte 6     temperature + 40 [degC]
    byte 7     error

Older firmware sends only the first six bytes. Source: fact sheet mit_damiao, section variants.

The fact sheet mit_damiao does not determine the following behaviour. A disabled motor answers
commands. An error of the motor removes the torque. The error ends when the cause of the error ends.
A special command has seven bytes FF and a code. If the code is unknown, the motor sends no answer.
"""

import enum
import math

from firmware_sim.bus.frame import Frame
from firmware_sim.description.hand_description import MotorSpec
from firmware_sim.nodes.drive_temperatures import DriveTemperatures
from firmware_sim.nodes.mit.codec import MitRanges, decode_command, value_to_code
from firmware_sim.nodes.protocol_spec import ProtocolSpec, ShaftSpec
from firmware_sim.plant.motor import Motor

FULL_SCALE_BY_MOTOR_TYPE = {
    "ak60-6": (12.5, 50.0, 15.0),
    "ak70-10": (12.5, 50.0, 25.0),
    "ak80-6": (12.5, 76.0, 12.0),
    "ak80-9": (12.5, 50.0, 18.0),
    "ak10-9": (12.5, 50.0, 65.0),
}
"""Position [rad], velocity [rad/s] and torque [N m] at full scale, by motor model."""
SPEED_CONSTANT_BY_MOTOR_TYPE = {
    "ak60-6": (80.0, 6.0),
    "ak70-10": (100.0, 10.0),
    "ak80-6": (100.0, 6.0),
    "ak80-9": (100.0, 9.0),
    "ak10-9": (60.0, 9.0),
}
"""Speed constant [1/min/V] and gear ratio, by motor model.

Source: names of the models, such as AK80-9 KV100.
"""
SUPPLY_V = 48.0
"""Supply voltage of the motors [V]."""
STALL_TORQUE_RATIO = 2.0
"""Assumed stall torque divided by the torque at full scale."""
DEFAULT_MOTOR_TYPE = "ak80-9"
"""Motor model if the hand file gives none."""
THERMAL_PERIOD_NS = 100_000_000
"""Period of the update of the temperatures [ns]."""
OVERHEATING_C = 100.0
"""Winding temperature above which the drive reports an error [degC]."""
COOLED_DOWN_C = 90.0
"""Winding temperature below which the over-temperature error ends [degC]."""
ZEROING_DURATION_NS = 1_000_000_000
"""Time for which the drive does not answer because it stores a new zero position [ns]."""
_SPECIAL_COMMAND_START = b"\xff" * 7
"""First seven bytes of a special command."""
TEMPERATURE_ZERO_C = -40
"""Temperature for which the temperature byte in the feedback is 0 [degC].

The manual of the drive subtracts 40 in its example of a reply.
"""
_ENABLE_COMMAND = 0xFC
_DISABLE_COMMAND = 0xFD
_ZERO_COMMAND = 0xFE


class FeedbackError(enum.IntEnum):
    """Error code in byte 7 of the feedback."""

    NO_ERROR = 0
    HOT = 1
    OVER_CURRENT = 2
    OVER_VOLTAGE = 3
    UNDER_VOLTAGE = 4
    ENCODER = 5
    PHASE_IMBALANCE = 6


class CubemarsNode:
    """A simulated CubeMars motor on the bus.

    Attributes:
        enabled: True if the motor follows commands.
        error: present error of the motor.
        offset: angle that the motor reports when the spool angle theta is 0 [rad].
        thermal: temperatures of the motor.
        short: True if the feedback has six bytes, as in older firmware.
        ids: identifiers of the frames that the node answers.
        malformed_frame_count: number of frames with an identifier of the node that the node could not decode.
        wake_ns: time of the next call of ``wake`` [ns].
        watchdog_fed_ns: negative number, which means that the drive has no watchdog.
    """

    def __init__(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Set up the node in the state after power-up.

        Args:
            spec: description of the motor.
            motor: rotor of the motor.
            offset: angle that the motor reports when the spool angle theta is 0 [rad].
        """
        self.motor = motor
        self.offset = offset
        self.thermal = DriveTemperatures(spec.torque_constant)
        self.enabled = False
        self.error = FeedbackError.NO_ERROR
        self.short = bool(spec.options.get("short", False))
        self.malformed_frame_count = 0
        self.wake_ns = 0
        self.watchdog_fed_ns = -1
        self._id = spec.node_id
        self._direction = spec.direction
        self.ids = frozenset((spec.node_id,))
        self._ranges = MitRanges(
            *FULL_SCALE_BY_MOTOR_TYPE[str(spec.options.get("motor_type", DEFAULT_MOTOR_TYPE))]
        )
        motor.servo.limit = min(spec.torque_peak, self._ranges.torque)
        self._thermal_ns = -1
        self._silent_until_ns = 0

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Process a frame, and answer with a frame of the same identifier.

        Returns:
            The answers, or None if the frame is not meant for this motor.
        """
        if frame.can_id != self._id:
            return None
        data = frame.data
        if len(data) != 8:
            self.malformed_frame_count += 1
            return []
        if t_ns < self._silent_until_ns:
            return []
        # Eight bytes FF are no special command but a valid MIT command, in which all fields have
        # their maximum.
        if data[:7] == _SPECIAL_COMMAND_START and data[7] != 0xFF:
            return self._process_special_command(data[7], frame, t_ns)
        self._apply_command(data)
        return [self._feedback_frame(frame, t_ns)]

    def _process_special_command(self, command_code: int, frame: Frame, t_ns: int) -> list[Frame]:
        """Execute a special command."""
        if command_code == _ENABLE_COMMAND:
            self._enable_torque(is_enabled=self.error == FeedbackError.NO_ERROR)
        elif command_code == _DISABLE_COMMAND:
            self._enable_torque(is_enabled=False)
        elif command_code == _ZERO_COMMAND:
            self.offset = -self._direction * self.motor.encoder()
            self._silent_until_ns = t_ns + ZEROING_DURATION_NS
            return []
        else:
            self.malformed_frame_count += 1
            return []
        return [self._feedback_frame(frame, t_ns)]

    def _enable_torque(self, is_enabled: bool) -> None:
        """Switch the torque of the motor on or off.

        If the motor was enabled before and stays enabled, the servo keeps its setpoint. If the
        motor was disabled before or is disabled now, the servo is released.
        """
        if not (is_enabled and self.enabled):
            self.motor.servo.release()
        self.enabled = is_enabled

    def _apply_command(self, data: bytes) -> None:
        """Apply an MIT command if the motor is enabled."""
        if not self.enabled:
            return
        command = decode_command(data, self._ranges)
        servo = self.motor.servo
        sign = self._direction
        servo.kp = command.kp
        servo.kd = command.kd
        servo.position = sign * (command.position - self.offset)
        servo.velocity = sign * command.velocity
        servo.torque = sign * command.torque

    def _feedback_frame(self, frame: Frame, t_ns: int) -> Frame:
        """Return the frame with the present feedback."""
        motor = self.motor
        sign = self._direction
        ranges = self._ranges
        position = value_to_code(sign * motor.encoder() + self.offset, ranges.position, 16)
        velocity = value_to_code(sign * motor.velocity, ranges.velocity, 12)
        torque = value_to_code(sign * motor.torque, ranges.torque, 12)
        word = self._id & 0xFF
        for code, bits in ((position, 16), (velocity, 12), (torque, 12)):
            word = word << bits | code
        data = word.to_bytes(6, "big")
        if not self.short:
            data += bytes(
                (min(255, max(0, int(self.thermal.mosfet) - TEMPERATURE_ZERO_C)), self.error)
            )
        return Frame(self._id, data, frame.flags, frame.bus, t_ns)

    def trip(self, feedback_error: FeedbackError) -> None:
        """Enter an error state, which removes the torque.

        With the argument ``FeedbackError.NO_ERROR``, the error state ends.
        """
        self.error = feedback_error
        if feedback_error != FeedbackError.NO_ERROR:
            self._enable_torque(is_enabled=False)

    def power_cycle(self) -> None:
        """Restart the motor. After the restart, the motor is disabled and has no error."""
        self.error = FeedbackError.NO_ERROR
        self._enable_torque(is_enabled=False)

    def wake(self, t_ns: int) -> None:
        """Update the temperatures, and set or end the over-temperature error."""
        if self._thermal_ns < 0 or t_ns - self._thermal_ns >= THERMAL_PERIOD_NS:
            if self._thermal_ns >= 0:
                self.thermal.advance((t_ns - self._thermal_ns) * 1e-9, self.motor.heat)
            self.motor.heat = 0.0
            self._thermal_ns = t_ns
            if self.thermal.winding > OVERHEATING_C:
                self.trip(FeedbackError.HOT)
            elif self.error == FeedbackError.HOT and self.thermal.winding < COOLED_DOWN_C:
                self.trip(FeedbackError.NO_ERROR)
        self.wake_ns = self._thermal_ns + THERMAL_PERIOD_NS


def shaft_of_cubemars_motor(motor_type: str) -> ShaftSpec:
    """Build the description of the shaft of a motor type.

    The inertia and the stall torque of the shaft are assumptions.
    """
    position, velocity, peak = FULL_SCALE_BY_MOTOR_TYPE[motor_type]
    speed_constant, ratio = SPEED_CONSTANT_BY_MOTOR_TYPE[motor_type]
    top_speed = speed_constant * SUPPLY_V / ratio * math.tau / 60.0
    options = {"motor_type": motor_type}
    limits = peak, top_speed, STALL_TORQUE_RATIO * peak
    return ShaftSpec(peak, 2e-4 * peak, 1.0, position, velocity, options, *limits)


def _host_frame(node_id: int) -> tuple[int, bytes]:
    return node_id, bytes(8)


def _make_ineffective_disable(frame: Frame) -> Frame:
    """Replace the command *disable* by an MIT command with zero torque."""
    return (
        frame._replace(data=b"\x7f\xff\x7f\xf0\0\0\x07\xff")
        if frame.data == _SPECIAL_COMMAND_START + b"\xfd"
        else frame
    )


def _force_command(node: CubemarsNode, frame: Frame) -> None:
    """Apply an MIT command in any state of the motor."""
    if (
        frame.can_id in node.ids
        and len(frame.data) == 8
        and frame.data[:7] != _SPECIAL_COMMAND_START
    ):
        enabled = node.enabled
        node.enabled = True
        node._apply_command(frame.data)
        node.enabled = enabled


CUBEMARS_SPEC = ProtocolSpec(
    CubemarsNode,
    range(1, 0x100),
    shaft_of_cubemars_motor(DEFAULT_MOTOR_TYPE),
    _host_frame,
    _make_ineffective_disable,
    force_command=_force_command,
)
"""Specification of the MIT protocol with CubeMars motors."""
