"""Test the simulated Damiao motor: its states, registers and watchdog.

The fact sheet of the motor defines the expected behaviour.
"""

import struct

import pytest

from firmware_sim.bus.frame import BRS, EXTENDED_FLAG, FDF, Frame
from firmware_sim.description.hand_description import load_hand
from firmware_sim.lockstep_hand import LockstepHand
from firmware_sim.nodes.mit.node import FeedbackState, MitNode
from firmware_sim.plant.motor import Motor

NS_PER_MS = 1_000_000
MOTOR_SPEC = load_hand("jamia").motors[1]
MOTOR_ID = MOTOR_SPEC.node_id
FULL_TORQUE = bytes.fromhex("7fff7ff000000fff")


class MotorBench:
    """One motor with a free spool, simulated in steps of 0.5 ms."""

    def __init__(self) -> None:
        self.motor = Motor(MOTOR_SPEC, 0.5e-3)
        self.node = MitNode(MOTOR_SPEC, self.motor, 0.1)
        self.t_ns = 0

    def run(self, duration_ms: float) -> None:
        for _ in range(round(duration_ms * 2)):
            self.motor.advance(0.0)
            self.t_ns += NS_PER_MS // 2
            if self.t_ns >= self.node.wake_ns:
                self.node.wake(self.t_ns)

    def reply_to(self, payload: bytes, can_id: int = MOTOR_ID, flags: int = 0) -> bytes:
        answers = self.node.receive(Frame(can_id, payload, flags), self.t_ns)
        assert answers is not None
        (answer,) = answers
        assert answer.can_id == MOTOR_ID + 0x10
        assert answer.flags == flags
        return answer.data

    def state(self) -> FeedbackState:
        return self.node.state

    def send_special_command(self, command_code: int) -> int:
        """Send a special command to the motor, and return the state bits of its reply."""
        return self.reply_to(b"\xff" * 7 + bytes([command_code]))[0] >> 4

    def send_register_request(
        self, operation: int, register_number: int, expected_value: bytes = bytes(4)
    ) -> bytes:
        return self.reply_to(
            struct.pack("<HBB", MOTOR_ID, operation, register_number) + expected_value, can_id=0x7FF
        )


@pytest.fixture
def bench() -> MotorBench:
    return MotorBench()


def test_a_motor_sends_only_answers(bench: MotorBench) -> None:
    assert bench.node.receive(Frame(MOTOR_ID + 1, FULL_TORQUE), 0) is None
    assert bench.node.receive(Frame(MOTOR_ID | EXTENDED_FLAG, FULL_TORQUE), 0) is None
    request_for_other_motor = struct.pack("<HBB4x", MOTOR_ID + 1, 0x33, 23)
    assert bench.node.receive(Frame(0x7FF, request_for_other_motor), 0) is None


def test_no_torque_until_enabled_and_none_after_disable(bench: MotorBench) -> None:
    for _ in range(20):
        assert bench.reply_to(FULL_TORQUE)[0] >> 4 == FeedbackState.DISABLED
        bench.run(1)
    assert bench.motor.torque == 0.0
    assert bench.motor.theta == 0.0
    assert bench.send_special_command(0xFC) == FeedbackState.ENABLED
    bench.reply_to(FULL_TORQUE)
    bench.run(5)
    assert bench.motor.torque == pytest.approx(0.8, rel=1e-3)
    assert bench.send_special_command(0xFD) == FeedbackState.DISABLED
    bench.reply_to(FULL_TORQUE)
    bench.run(5)
    assert abs(bench.motor.torque) < 1e-6


def test_enabling_does_not_bring_back_an_old_command(bench: MotorBench) -> None:
    bench.send_special_command(0xFC)
    bench.reply_to(FULL_TORQUE)
    bench.send_special_command(0xFD)
    bench.send_special_command(0xFC)
    bench.run(5)
    assert abs(bench.motor.torque) < 0.8 * 0.01


@pytest.mark.parametrize("timeout_ms", [100, 1000])
def test_the_watchdog_trips_on_time_and_latches(bench: MotorBench, timeout_ms: int) -> None:
    bench.send_register_request(0x55, 9, struct.pack("<I", timeout_ms))
    bench.run(1)
    bench.send_special_command(0xFC)
    bench.reply_to(FULL_TORQUE)
    limit_ms = timeout_ms * 0.05
    bench.run(limit_ms - 0.5)
    assert bench.state() == FeedbackState.ENABLED
    bench.run(0.5)
    assert bench.state() == FeedbackState.COMMUNICATION_LOST
    bench.run(5)
    assert abs(bench.motor.torque) < 1e-6
    assert bench.reply_to(FULL_TORQUE)[0] >> 4 == 0xD
    assert bench.send_special_command(0xFC) == 0xD, "the enable command does not clear an error"
    assert bench.send_special_command(0xFB) == FeedbackState.DISABLED
    assert bench.send_special_command(0xFC) == FeedbackState.ENABLED


def test_commands_feed_the_watchdog_and_refresh_does_not(bench: MotorBench) -> None:
    bench.send_register_request(0x55, 9, struct.pack("<I", 200))
    bench.send_special_command(0xFC)
    for _ in range(10):
        bench.run(9)
        assert bench.reply_to(FULL_TORQUE)[0] >> 4 == FeedbackState.ENABLED
    bench.run(6)
    bench.send_register_request(0xCC, 0)
    bench.run(6)
    assert bench.state() == FeedbackState.COMMUNICATION_LOST


def test_the_watchdog_is_off_by_default(bench: MotorBench) -> None:
    assert struct.unpack("<I", bench.send_register_request(0x33, 9)[4:]) == (0,)
    bench.send_special_command(0xFC)
    bench.run(500)
    assert bench.state() == FeedbackState.ENABLED


@pytest.mark.parametrize(("register_number", "expected_value"), [(21, 12.5), (22, 50.0), (23, 0.8)])
def test_ranges_are_read_as_floats(
    bench: MotorBench, register_number: int, expected_value: float
) -> None:
    reply = bench.send_register_request(0x33, register_number)
    assert reply[:4] == struct.pack("<HBB", MOTOR_ID, 0x33, register_number)
    assert struct.unpack("<f", reply[4:])[0] == pytest.approx(expected_value)


def test_writing_tmax_limits_the_torque_and_scales_the_answer(bench: MotorBench) -> None:
    reply = bench.send_register_request(0x55, 23, struct.pack("<f", 0.2))
    assert reply == struct.pack("<HBBf", MOTOR_ID, 0x55, 23, 0.2)
    bench.send_special_command(0xFC)
    bench.reply_to(FULL_TORQUE)
    bench.run(5)
    assert bench.motor.torque == pytest.approx(0.2, rel=1e-3)
    data = bench.reply_to(FULL_TORQUE)
    assert ((data[4] & 0xF) << 8 | data[5]) >= 4093


def test_the_torque_is_limited_to_the_motors_peak(bench: MotorBench) -> None:
    bench.send_register_request(0x55, 23, struct.pack("<f", 10.0))
    bench.send_special_command(0xFC)
    bench.reply_to(FULL_TORQUE)
    bench.run(5)
    assert bench.motor.torque == pytest.approx(MOTOR_SPEC.torque_peak, rel=1e-3)


def test_invalid_writes_are_ignored(bench: MotorBench) -> None:
    bench.send_register_request(0x55, 10, struct.pack("<I", 5))
    assert struct.unpack("<I", bench.send_register_request(0x33, 10)[4:]) == (1,)
    bench.send_register_request(0x55, 23, struct.pack("<f", float("nan")))
    assert struct.unpack("<f", bench.send_register_request(0x33, 23)[4:])[0] == pytest.approx(0.8)


def test_unknown_registers_and_short_frames_are_not_answered(bench: MotorBench) -> None:
    assert bench.node.receive(Frame(0x7FF, struct.pack("<HBB4x", MOTOR_ID, 0x33, 200)), 0) == []
    assert bench.node.receive(Frame(MOTOR_ID, b"\x01\x02"), 0) == []
    assert bench.node.malformed_frame_count == 2


def test_registers_are_lost_at_power_off_unless_saved(bench: MotorBench) -> None:
    bench.send_register_request(0x55, 9, struct.pack("<I", 77))
    bench.node.power_cycle()
    assert struct.unpack("<I", bench.send_register_request(0x33, 9)[4:]) == (0,)
    bench.send_register_request(0x55, 9, struct.pack("<I", 77))
    assert bench.send_register_request(0xAA, 0)[2:4] == b"\xaa\x01"
    bench.node.power_cycle()
    assert struct.unpack("<I", bench.send_register_request(0x33, 9)[4:]) == (77,)


def test_zero_makes_the_present_position_zero_while_disabled(bench: MotorBench) -> None:
    bench.motor.theta = 1.0
    data = bench.reply_to(b"\xff" * 7 + b"\xfe")
    position = int.from_bytes(data[1:3], "big") * 25.0 / 65535 - 12.5
    assert abs(position) <= 2 * 25.0 / 65535


def test_the_answer_has_the_format_of_the_request(bench: MotorBench) -> None:
    bench.reply_to(FULL_TORQUE, flags=FDF | BRS)
    bench.reply_to(FULL_TORQUE, flags=FDF)


def test_the_servo_holds_a_position(bench: MotorBench) -> None:
    bench.send_special_command(0xFC)
    kp, kd = round(5.0 / 500 * 4095), round(0.05 / 5 * 4095)
    code = int((1.1 + 12.5) * 65535 / 25.0)
    word = code << 48 | 2047 << 36 | kp << 24 | kd << 12 | 2047
    bench.reply_to(word.to_bytes(8, "big"))
    bench.run(1000)
    # The encoder of the motor has an offset of 0.1 rad. The Coulomb friction of 0.015 N m causes an
    # error of up to 3 mrad at a stiffness of 5 N m/rad.
    assert bench.motor.theta == pytest.approx(1.0, abs=4e-3)


def test_over_temperature_trips_the_motor(bench: MotorBench) -> None:
    bench.send_register_request(0x55, 23, struct.pack("<f", 10.0))
    bench.send_special_command(0xFC)
    bench.reply_to(FULL_TORQUE)
    while bench.state() == FeedbackState.ENABLED and bench.t_ns < 600_000 * NS_PER_MS:
        elapsed_ns = bench.node.wake_ns - bench.t_ns
        bench.t_ns = bench.node.wake_ns
        bench.motor.heat += MOTOR_SPEC.torque_peak**2 * elapsed_ns * 1e-9
        bench.node.wake(bench.t_ns)
    assert bench.state() == FeedbackState.WINDING_OVERHEATED
    assert bench.t_ns > 20_000 * NS_PER_MS
    assert bench.reply_to(FULL_TORQUE)[7] >= 100


def test_a_motor_answers_only_at_its_new_identifier() -> None:
    rig = LockstepHand("jamia", homed=True)
    world, torque = rig.world, bytes.fromhex("7fff7ff000000fff")

    def answer_ids(can_id: int, data: bytes = torque) -> list[int]:
        return [frame.can_id for frame in world.receive(Frame(can_id, data))]

    assert answer_ids(MOTOR_ID) == [MOTOR_ID + 0x10]
    assert answer_ids(MOTOR_ID + 0x40) == []
    assert world.foreign_frame_count == 1
    assert answer_ids(0x7FF, struct.pack("<HBBI", MOTOR_ID, 0x55, 8, MOTOR_ID + 0x40)) == [
        MOTOR_ID + 0x10
    ]
    assert answer_ids(MOTOR_ID + 0x40) == [MOTOR_ID + 0x10]
    assert answer_ids(MOTOR_ID) == []
    assert answer_ids(0x7FF, struct.pack("<HBBI", MOTOR_ID + 0x40, 0x55, 8, MOTOR_ID + 1)) == [
        MOTOR_ID + 0x10
    ]
    assert answer_ids(MOTOR_ID + 1) == [MOTOR_ID + 0x10, MOTOR_ID + 0x11], (
        "two motors have this identifier"
    )
