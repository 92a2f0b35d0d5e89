"""A motor with the firmware of a Damiao drive: it speaks only when spoken to. Source: facts, mit_damiao.

Choices where the fact sheet says "assumption": the watchdog is fed by commands on ESC_ID only, not by register traffic;
FE acts only while disabled; positions beyond PMAX saturate; unknown registers are not answered.
"""

import enum

from firmware_sim.bus.frame import Frame
from firmware_sim.description import MotorSpec
from firmware_sim.nodes.mit import registers as reg
from firmware_sim.nodes.mit.codec import WARM_PERIOD_NS, WORD, MitRow, feedback_word, obey, schedule
from firmware_sim.nodes.thermal import Thermal, ThermalRow
from firmware_sim.plant.motor import Motor

REGISTER_ID = 0x7FF
WATCHDOG_UNIT_NS = 50_000
_SPECIAL = b"\xff" * 7
_ENABLE, _DISABLE, _ZERO, _CLEAR = 0xFC, 0xFD, 0xFE, 0xFB
_READ, _WRITE, _SAVE, _REFRESH = 0x33, 0x55, 0xAA, 0xCC


class State(enum.IntEnum):
    """The state nibble of the feedback; everything above ENABLED is an error and means no torque."""

    DISABLED = 0x0
    ENABLED = 0x1
    OVER_CURRENT = 0xA
    MOSFET_HOT = 0xB
    WINDING_HOT = 0xC
    COMMUNICATION_LOST = 0xD
    OVERLOAD = 0xE


_ENABLED = State.ENABLED


class MitNode:
    """One motor node.

    Attributes:
        state: the state nibble.
        registers: the register file.
        offset: wire angle at theta = 0 [rad].
        thermal: temperatures.
        ids: identifiers that it may answer.
        malformed: frames on its identifiers that it could not read.
        wake_ns: when time must pass for it next [ns].
        fed_ns: last frame that fed its watchdog [ns].
        timeout_ns: of the watchdog [ns]; 0 if it is off.
        warmed_ns: when its temperatures were computed last [ns]; below 0 before the first time.
        node_id, reply_id: its own identifier and that of its answers, of registers 8 and 7.
        position_range, velocity_range, torque_range: of registers 21 to 23 [rad], [rad/s], [N m].
        direction: +1 or -1, of the motor's angle to that of the spool.
    """

    state: int

    def __init__(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Args: the motor's description; its rotor; wire angle at theta = 0 [rad]."""
        self.motor, self.offset = motor, offset
        self.registers = reg.Registers(spec)
        self.thermal = self._temperatures(spec.torque_constant)
        self.state = State.DISABLED
        self.malformed = 0
        self.wake_ns = 0
        self.direction = spec.direction
        self._torque_peak = spec.torque_peak
        self.fed_ns = 0
        self.warmed_ns = -1
        self._renew()

    def _temperatures(self, torque_constant: float) -> Thermal:
        """Return temperatures of a drive that is as warm as the room."""
        return Thermal(torque_constant)

    @property
    def cyclic(self) -> tuple[int, ...]:
        """Identifiers of the frames that come in every tick."""
        return (self.node_id,)

    def _renew(self) -> None:
        """Take over what depends on registers."""
        self.node_id, self.reply_id = int(self.registers[reg.ESC_ID]), int(self.registers[reg.MST_ID])
        self._mode_ids = {self.node_id + offset for offset in (0x100, 0x200, 0x300)}
        self.ids = frozenset((self.node_id, REGISTER_ID, *self._mode_ids))
        ranges = self.registers[reg.PMAX], self.registers[reg.VMAX], self.registers[reg.TMAX]
        self.position_range, self.velocity_range, self.torque_range = ranges
        self.motor.servo.limit = min(self._torque_peak, self.torque_range)
        self.timeout_ns = int(self.registers[reg.TIMEOUT]) * WATCHDOG_UNIT_NS

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Return the answers to a frame in the frame's own format; None if it is not for this motor."""
        can_id, data, flags, bus, _ = frame
        if can_id == self.node_id:
            if t_ns >= self.wake_ns:
                self.wake(t_ns)
            answer = self._command(data, t_ns)
        elif can_id == REGISTER_ID:
            if len(data) < 4 or int.from_bytes(data[:2], "little") != self.node_id:
                return None
            self.wake(t_ns)
            answer = self._register(data)
        elif can_id in self._mode_ids:
            self.wake(t_ns)
            answer = self._special(data, t_ns)  # some clients send FD and FE to the identifier of a mode
        else:
            return None
        schedule(self)
        if answer is None:
            self.malformed += 1
            return []
        return [Frame(self.reply_id, answer, flags, bus, t_ns)]

    def _command(self, data: bytes, t_ns: int) -> bytes | None:
        if len(data) != 8:
            return None
        if data[7] >= _CLEAR and data[7] != 0xFF and data[:7] == _SPECIAL:
            return self._special(data, t_ns)
        self.fed_ns = t_ns
        if self.state == _ENABLED:
            obey(self, self.motor.servo, WORD.unpack(data)[0])
        return self.feedback()

    def _special(self, data: bytes, t_ns: int) -> bytes | None:
        if len(data) != 8 or data[:7] != _SPECIAL:
            return None
        self.fed_ns = t_ns
        code = data[7]
        if code == _ENABLE:
            self._enable()
        elif code == _DISABLE:
            self._disable()
        elif code == _ZERO:
            if self.state != State.ENABLED:
                self.offset = -self.direction * self.motor.encoder()
        elif code == _CLEAR:
            self._clear()
        else:
            return None
        return self.feedback()

    def _enable(self) -> None:
        if self.state == State.DISABLED:
            self.motor.servo.release()
            self.state = State.ENABLED

    def _disable(self) -> None:
        self.motor.servo.release()
        if self.state == State.ENABLED:
            self.state = State.DISABLED

    def _clear(self) -> None:
        if self.state > State.ENABLED:
            self.state = State.DISABLED

    def trip(self, state: State) -> None:
        """Enter an error state: no torque until it is cleared and the motor enabled again."""
        self.motor.servo.release()
        self.state = state

    def feedback(self) -> bytes:
        """Return the feedback of this moment."""
        motor, thermal = self.motor, self.thermal
        return WORD.pack(feedback_word(self, motor, motor.encoder(), thermal.mosfet, thermal.winding))

    def _register(self, data: bytes) -> bytes | None:
        operation, register = data[2], data[3]
        if operation == _REFRESH:
            return self.feedback()
        head = data[:3]
        if operation == _SAVE and self.state != State.ENABLED:
            self.registers.save()
            return head + b"\x01\0\0\0\0"
        if operation not in (_READ, _WRITE) or register not in self.registers:
            return None
        if operation == _WRITE:
            if len(data) != 8:
                return None
            self.registers.write(register, data[4:])
            self._renew()
        self._measure()
        return head + data[3:4] + self.registers.read(register)

    def _measure(self) -> None:
        position = self.direction * self.motor.encoder() + self.offset
        self.registers.show(reg.MOTOR_POSITION, position)
        self.registers.show(reg.OUTPUT_POSITION, position)
        self.registers.show(reg.T_BOARD, self.thermal.mosfet)
        self.registers.show(reg.T_MOTOR, self.thermal.winding)

    def power_cycle(self) -> None:
        """Lose what was not saved, and start disabled."""
        self.registers.power_cycle()
        self.motor.servo.release()
        self.state = State.DISABLED
        self._renew()

    def forget(self, torque_max: float) -> None:
        """Fall back to what was saved, and go on as before; ``torque_max``: TMAX from now on [N m], 0: as saved."""
        self.registers.power_cycle()
        if torque_max:
            self.registers.show(reg.TMAX, torque_max)
        self._renew()

    def wake(self, t_ns: int) -> None:
        """Judge the watchdog and the temperatures."""
        if t_ns - self.warmed_ns >= WARM_PERIOD_NS or self.warmed_ns < 0:
            self._warm(t_ns)
        if self.state == State.ENABLED and self.timeout_ns and t_ns >= self.fed_ns + self.timeout_ns:
            self.trip(State.COMMUNICATION_LOST)
        schedule(self)

    def _warm(self, t_ns: int) -> None:
        if self.warmed_ns >= 0:
            self.thermal.advance((t_ns - self.warmed_ns) * 1e-9, self.motor.heat)
        self.motor.heat, self.warmed_ns = 0.0, t_ns
        if self.state == State.ENABLED and self.thermal.winding > self.registers[reg.OVER_TEMPERATURE]:
            self.trip(State.WINDING_HOT)


class MitNodeRow(MitRow, MitNode):
    """A node whose numbers are a row of an array."""

    layout = MitRow

    def prepare(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Fill the row; see ``MitNode``."""
        MitNode.__init__(self, spec, motor, offset)
        self.motor_number = motor.number

    def _temperatures(self, torque_constant: float) -> Thermal:
        thermal: ThermalRow = self.temperatures
        Thermal.__init__(thermal, torque_constant)
        return thermal
