"""Independent model of a motor, written from the manual of the motor.

The model of the motor receives bytes and returns bytes. Tests can inject faults into the model of
the motor.
"""

import struct
from dataclasses import dataclass, field

from handctl.drives.frame import Frame

FLOAT_REGISTERS = {21: 12.5, 22: 50.0, 23: 0.8}
INTEGER_REGISTERS = {9: 0, 10: 1, 15: 0x1234}


@dataclass
class ScriptedMotor:
    """A motor with a state and registers, into which a test can inject faults.

    Position, velocity and torque of the motor are integer codes, as in a frame.

    Attributes:
        unanswered_registers: numbers of the registers for which the motor answers no request.
        fixed_registers: numbers of the registers that keep their value when a host writes them.
        ignored_commands: codes of special commands that have no effect.
        is_silent: True if the motor sends no replies at all.
    """

    node_id: int = 1
    reply_id: int = 0x11
    state_nibble: int = 0
    feedback_codes: tuple[int, int, int] = (0x8000, 0x800, 0x800)
    temperatures: tuple[int, int] = (30, 35)
    registers: dict[int, float] = field(
        default_factory=lambda: {**FLOAT_REGISTERS, **INTEGER_REGISTERS}
    )
    unanswered_registers: set[int] = field(default_factory=set)
    fixed_registers: set[int] = field(default_factory=set)
    ignored_commands: set[int] = field(default_factory=set)
    is_silent: bool = False
    torque_codes: list[int] = field(default_factory=list)
    written_registers: list[int] = field(default_factory=list)

    def answer_frame(self, frame: Frame, t_ns: int) -> list[Frame]:
        """Return a list with the motor's reply to a frame of the host.

        If the motor sends no reply to the frame, the list is empty.
        """
        data = self._reply_data(frame)
        if data is None or self.is_silent:
            return []
        return [Frame(self.reply_id, data, frame.flags, frame.bus, t_ns)]

    def _reply_data(self, frame: Frame) -> bytes | None:
        if frame.can_id == 0x7FF and frame.data[0] | frame.data[1] << 8 == self.node_id:
            return self._answer_register_request(frame.data)
        if frame.can_id != self.node_id:
            return None
        if frame.data[:7] == b"\xff" * 7:
            self._run_special_command(frame.data[7])
        elif self.state_nibble == 1:
            self.torque_codes.append(frame.data[6] << 8 & 0xF00 | frame.data[7])
        return self.feedback_bytes()

    def _run_special_command(self, command_code: int) -> None:
        if command_code in self.ignored_commands:
            return
        if command_code == 0xFC and self.state_nibble == 0:
            self.state_nibble = 1
        elif (command_code == 0xFD and self.state_nibble == 1) or (
            command_code == 0xFB and self.state_nibble > 1
        ):
            self.state_nibble = 0

    def _answer_register_request(self, request_data: bytes) -> bytes | None:
        operation, register = request_data[2], request_data[3]
        if operation == 0xCC:
            return self.feedback_bytes()
        if register in self.unanswered_registers:
            return None
        layout = "<I" if register in INTEGER_REGISTERS else "<f"
        if operation == 0x55:
            self.written_registers.append(register)
            assert self.state_nibble != 1, "a register was written while torque was on"
            if register not in self.fixed_registers:
                (self.registers[register],) = struct.unpack(layout, request_data[4:])
        return request_data[:4] + struct.pack(layout, self.registers[register])

    def feedback_bytes(self) -> bytes:
        """Return the 8 bytes of a feedback frame, packed bit by bit as in the table of the motor's manual."""
        position, velocity, torque = (
            format(code, f"0{bits}b")
            for code, bits in zip(self.feedback_codes, (16, 12, 12), strict=True)
        )
        bits = (
            format(self.state_nibble, "04b")
            + format(self.node_id & 0xF, "04b")
            + position
            + velocity
            + torque
        )
        return int(bits, 2).to_bytes(6, "big") + bytes(self.temperatures)
