"""A RobStride motor in its MIT mode, with 11-bit identifiers.

Source: docs/facts/robstride.md, section MIT mode.

    identifier          payload                          effect, and answer
    motor               FF FF FF FF FF FF FF FC          enable, feedback
    motor               FF FF FF FF FF FF mode FC        mode of operation 0, 1 or 2, feedback
    motor               FF FF FF FF FF FF FF FD          stop, feedback
    motor               FF FF FF FF FF FF protocol FD    protocol from the next power-up on, identity
    motor               FF FF FF FF FF FF FF FE          present position is zero, feedback
    motor               FF FF FF FF FF FF FF FB          clear faults, feedback
    motor               FF FF FF FF FF FF xx FB          faults in bytes 1 to 4, low byte first
    motor               FF FF FF FF FF FF number FA      number of the motor, identity
    motor               FF FF FF FF FF FF FD host        number of the host, identity
    motor               all others                       position 16, velocity 12, kp 12, kd 12, torque 12 bit, feedback
    0x100 + motor       target position, largest speed   feedback
    0x200 + motor       target speed, current limit      feedback

A feedback frame has the identifier of the host. The payload of feedback is the number of the motor,
the position (16 bits), the velocity (12 bits), the torque (12 bits) and the temperature (16 bits,
in 0.1 degC). An identity frame has the identifier of the motor.

Choices of this simulator where the fact sheet has only an assumption:

- The motor ignores frames with 29-bit identifiers.
- The motor answers commands of the position mode and the velocity mode, but the commands have no
  effect.
- The motor sends no fault reports.
"""

import struct

from firmware_sim.bus.frame import EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from firmware_sim.description.hand_description import MotorSpec
from firmware_sim.nodes.mit.codec import KD_MAX, KP_MAX, MitRanges, decode_command, value_to_code
from firmware_sim.nodes.protocol_spec import ProtocolSpec
from firmware_sim.nodes.robstride import bench
from firmware_sim.nodes.robstride.node import (
    DEFAULT_MOTOR_TYPE,
    FAULT_REPORT_BITS,
    FAULT_REPORT_SHIFT,
    RUN_MODE,
    RobstrideNode,
)
from firmware_sim.plant.motor import Motor

POSITION_RANGE = 12.57
"""Largest position in the frames of MIT mode [rad]."""
FACTORY_HOST_ID = 0
"""Number of the host in a motor as delivered."""
HOST_ID_OFFSET = 0x10
"""Number of the host minus number of the motor, if the hand file does not give ``host_id``."""
_SPECIAL_COMMAND_START = b"\xff" * 6
"""First six bytes of a special command."""


class RobstrideMitNode(RobstrideNode):
    """A simulated RobStride motor in MIT mode.

    Attributes:
        host_id: identifier of the feedback frames.
        next_protocol: protocol that the motor will use from the next power-up on: 0 private, 1
            CANopen, 2 MIT.
    """

    def __init__(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Set up the node in the state after power-up.

        Args:
            spec: description of the motor.
            motor: rotor of the motor.
            offset: angle that the motor reports when the spool angle theta is 0 [rad].
        """
        super().__init__(spec, motor, offset)
        self.host_id = int(spec.options.get("host_id", spec.node_id + HOST_ID_OFFSET))
        self.next_protocol = 2
        counts = int(spec.options.get("can_timeout", 0))
        self._saved[0x7028] = struct.pack("<I", counts)
        self.parameters = dict(self._saved)
        self._ranges = MitRanges(POSITION_RANGE, self._velocity, self._torque)

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Execute and answer a frame.

        Returns:
            The answers, or None if the frame is not for the motor.
        """
        is_other_frame = frame.can_id & (EXTENDED_FLAG | REMOTE_FLAG) or frame.flags & FDF
        if is_other_frame or frame.can_id & 0xFF != self.node_id or frame.can_id >> 8 > 2:
            return None
        data = frame.data
        if len(data) != 8:
            self.malformed_frame_count += 1
            return []
        if frame.can_id >> 8:
            return [self._feedback_frame(frame)]
        if data[:6] == _SPECIAL_COMMAND_START and data[6:] != b"\xff\xff":
            return self._process_special_command(data[6], data[7], frame, t_ns)
        self.watchdog_fed_ns = t_ns
        if self.mode == RUN_MODE:
            self.follow_command(data)
        self._schedule()
        return [self._feedback_frame(frame)]

    def _process_special_command(
        self, data_area: int, command_code: int, frame: Frame, t_ns: int
    ) -> list[Frame]:
        """Execute a special command.

        Byte 6 of the frame is either FF, or an argument of the command.
        """
        is_plain_request = data_area == 0xFF
        if command_code == 0xFB and not is_plain_request:
            return [
                Frame(
                    self.host_id,
                    bytes((self.node_id,)) + struct.pack("<I", self._fault_word) + bytes(3),
                )
            ]
        if command_code == 0xFC and is_plain_request:
            self._enable(b"", t_ns)
        elif command_code == 0xFC and data_area <= 2:
            self._set_run_mode(data_area)
        elif command_code == 0xFD and is_plain_request:
            self._stop(clear_faults=False)
        elif command_code == 0xFB:
            # LeRobot sends the command below repeatedly to running motors. So the command must not
            # stop a motor.
            self.fault = 0
        elif command_code == 0xFE and is_plain_request:
            self.offset = -self._direction * self.motor.encoder()
        else:
            return self._change_configuration(data_area, command_code)
        return [self._feedback_frame(frame)]

    def _set_run_mode(self, mode: int) -> None:
        """Set the mode of operation (0, 1 or 2), unless the motor is enabled."""
        if self.mode != RUN_MODE:
            self.parameters[0x7005] = bytes(((0, 5, 2)[mode], 0, 0, 0))

    def _change_configuration(self, data_area: int, command_code: int) -> list[Frame]:
        """Change the protocol, the number of the motor, or the number of the host.

        The motor replies with its identity.
        """
        node_id = self.node_id
        if command_code == 0xFD and data_area <= 2:
            self.next_protocol = data_area
        elif command_code == 0xFA and 0 < data_area < 0x80:
            self.node_id = data_area
        elif data_area == 0xFD and command_code < 0x80:
            self.host_id = command_code
        else:
            self.malformed_frame_count += 1
            return []
        return [Frame(node_id, self._serial.to_bytes(8, "big"))]

    @property
    def _fault_word(self) -> int:
        """Return the present faults, coded as in a fault report."""
        return (
            sum(report_bit for bit, report_bit in FAULT_REPORT_BITS.items() if self.fault & bit)
            | self.fault >> FAULT_REPORT_SHIFT
        )

    def follow_command(self, data: bytes) -> None:
        """Set the servo from the payload of a control command."""
        command = decode_command(data, self._ranges)
        servo = self.motor.servo
        sign = self._direction
        limit = self.torque_limit
        servo.kp = command.kp * self._kp / KP_MAX
        servo.kd = command.kd * self._kd / KD_MAX
        servo.position = sign * (command.position - self.offset)
        servo.velocity = sign * command.velocity
        servo.torque = sign * max(-limit, min(limit, command.torque))
        servo.limit = limit

    def _feedback_frame(self, frame: Frame) -> Frame:
        """Return the frame with the present feedback."""
        motor = self.motor
        sign = self._direction
        position = value_to_code(sign * motor.encoder() + self.offset, POSITION_RANGE, 16)
        velocity = value_to_code(sign * motor.velocity, self._velocity, 12)
        torque = value_to_code(sign * motor.torque, self._torque, 12)
        word = self.node_id << 40 | position << 24 | velocity << 12 | torque
        data = word.to_bytes(6, "big") + struct.pack(">h", int(10 * self.thermal.winding))
        return Frame(self.host_id, data, 0, frame.bus)

    def wake(self, t_ns: int) -> list[Frame]:
        """Check the watchdog and the temperature, but send no fault reports.

        Returns:
            No frame.
        """
        super().wake(t_ns)
        return []


def _host_frame(node_id: int) -> tuple[int, bytes]:
    """Return a stop command for a motor."""
    return node_id, b"\xff" * 7 + b"\xfd"


def _make_ineffective_disable(frame: Frame) -> Frame:
    """Replace a stop command by a command with zero torque, so that the motor stays enabled."""
    is_disable_command = frame.can_id < 0x80 and frame.data == b"\xff" * 7 + b"\xfd"
    return frame._replace(data=b"\x7f\xff\x7f\xf0\0\0\x07\xff") if is_disable_command else frame


def _force_command(node: RobstrideMitNode, frame: Frame) -> None:
    """Follow an MIT control command in any mode of the motor."""
    if (
        frame.can_id == node.node_id
        and len(frame.data) == 8
        and frame.data[:6] != _SPECIAL_COMMAND_START
    ):
        node.follow_command(frame.data)


_DEFAULT_SHAFT = bench.shaft_of_robstride_motor(DEFAULT_MOTOR_TYPE)
ROBSTRIDE_MIT_SPEC = ProtocolSpec(
    RobstrideMitNode, range(1, 0x80),
    _DEFAULT_SHAFT._replace(position=POSITION_RANGE, options={**_DEFAULT_SHAFT.options, "host_id": FACTORY_HOST_ID}),
    _host_frame, _make_ineffective_disable, force_command=_force_command,
)  # fmt: skip
"""Specification of RobStride motors in MIT mode."""
