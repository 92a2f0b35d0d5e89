"""Test the position, velocity and homing modes of simulated drives: limits, ramps, trajectories and changes of mode."""

import itertools
import math
import random
import struct
from collections.abc import Callable
from dataclasses import replace

import pytest

from firmware_sim.bus.frame import Frame
from firmware_sim.nodes.motion_control import MotionSetpoint
from firmware_sim.programs.drive import SimulatedDriveBench
from firmware_sim.programs.drive_types import drive_spec

NS_PER_MS = 1_000_000
TURN_RAD = math.tau


def sample_each_ms(
    bench: SimulatedDriveBench, duration_s: float, read_value: Callable[[], float]
) -> list[float]:
    """Advance a bench by ``duration_s``.

    Return the value of the function ``read_value`` in each simulated millisecond.
    """
    values = []
    for _ in range(round(duration_s * 1000)):
        bench.advance(bench.t_ns + NS_PER_MS)
        values.append(read_value())
    return values


def largest_acceleration(velocities: list[float], window_ms: int = 20) -> float:
    """Return the largest mean acceleration over any ``window_ms`` milliseconds [unit/s2].

    The argument ``velocities`` has one velocity for each millisecond.
    """
    pairs = zip(velocities, velocities[window_ms:], strict=False)
    return (
        max(abs(speed_after - speed_before) for speed_before, speed_after in pairs)
        * 1000
        / window_ms
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_trapezoid_arrives_within_speed_and_ramps_and_never_overshoots(seed: int) -> None:
    rng = random.Random(seed)
    speed, rise, fall = (10.0 ** rng.uniform(-1, 2) for _ in range(3))
    target = rng.uniform(-10.0, 10.0)
    setpoint = MotionSetpoint(rng.uniform(-10.0, 10.0))
    side = math.copysign(1.0, target - setpoint.position)
    step_s = 1e-3
    for _ in range(1_000_000):
        velocity_before = setpoint.velocity
        arrived = setpoint.trapezoid(target, speed, rise, fall, step_s)
        assert abs(setpoint.velocity) <= speed * (1 + 1e-9)
        slope = abs(setpoint.velocity - velocity_before) / step_s
        assert slope <= max(rise, fall) * (1 + 1e-9) or arrived
        assert side * (target - setpoint.position) >= -1e-9
        if arrived:
            break
    assert setpoint.position == target


def test_a_trapezoid_turns_round_for_a_new_target() -> None:
    setpoint = MotionSetpoint()
    for _ in range(500):
        setpoint.trapezoid(10.0, 2.0, 5.0, 2.5, 1e-3)
    assert setpoint.velocity == pytest.approx(2.0)
    fastest = 0.0
    for _ in range(10_000):
        if setpoint.trapezoid(0.0, 2.0, 5.0, 2.5, 1e-3):
            break
        fastest = min(fastest, setpoint.velocity)
    assert setpoint.position == 0.0
    assert -2.0 <= fastest < -1.0


# Tests of the modes of a Damiao motor.


def damiao_bench(operation_mode: int) -> SimulatedDriveBench:
    """Return a bench with an enabled Damiao motor in a control mode."""
    bench = SimulatedDriveBench([drive_spec("mit", 2)])
    write_register(bench, 10, struct.pack("<I", operation_mode))
    bench.receive(Frame(2, b"\xff" * 7 + b"\xfc"))
    return bench


def write_register(bench: SimulatedDriveBench, register: int, raw_bytes: bytes) -> None:
    bench.receive(Frame(0x7FF, b"\2\0\x55" + bytes((register,)) + raw_bytes))


def read_register(bench: SimulatedDriveBench, register: int) -> bytes:
    return bench.receive(Frame(0x7FF, b"\2\0\x33" + bytes((register,)) + bytes(4)))[-1].data[4:]


@pytest.mark.parametrize("motion_sign", [1, -1])
def test_the_ramps_of_a_damiao_motor_act_in_position_velocity_mode(motion_sign: int) -> None:
    bench = damiao_bench(2)
    write_register(bench, 4, struct.pack("<f", 4.0))
    write_register(bench, 5, struct.pack("<f", -2.0))
    bench.receive(Frame(0x102, struct.pack("<ff", motion_sign * 6.0, 3.0)))
    motor = bench.motors[0]
    speeds = sample_each_ms(bench, 5.0, lambda: motion_sign * motor.omega)
    assert speeds[500] == pytest.approx(4.0 * 0.5, rel=0.1)
    assert max(speeds) <= 1.02 * 3.0
    assert min(speeds) > -0.1
    # The motor reaches 3 rad/s after 0.75 s, when it has turned by 1.125 rad. From 3 rad/s, the
    # motor brakes for 1.5 s and turns by 2.25 rad.
    assert sample_each_ms(bench, 1.0, lambda: motion_sign * motor.theta)[-1] == pytest.approx(
        6.0, abs=0.01
    )


def test_the_ramp_of_a_damiao_motor_acts_in_velocity_mode() -> None:
    bench = damiao_bench(3)
    write_register(bench, 4, struct.pack("<f", 5.0))
    write_register(bench, 5, struct.pack("<f", -10.0))
    motor = bench.motors[0]
    bench.receive(Frame(0x202, struct.pack("<f", 6.0)))
    assert largest_acceleration(
        sample_each_ms(bench, 2.0, lambda: motor.omega), 100
    ) == pytest.approx(5.0, rel=0.15)
    assert motor.omega == pytest.approx(6.0, rel=0.01)
    bench.receive(Frame(0x202, struct.pack("<f", 0.0)))
    speeds = sample_each_ms(bench, 2.0, lambda: motor.omega)
    assert speeds[300] == pytest.approx(3.0, abs=0.4)
    assert speeds[-1] == pytest.approx(0.0, abs=0.02)


def test_the_largest_speed_of_a_damiao_motor_acts() -> None:
    bench = damiao_bench(3)
    write_register(bench, 6, struct.pack("<f", 2.0))
    bench.receive(Frame(0x202, struct.pack("<f", 15.0)))
    bench.advance(3000 * NS_PER_MS)
    assert bench.motors[0].omega == pytest.approx(2.0, rel=0.02)


def test_a_deceleration_is_negative() -> None:
    bench = damiao_bench(2)
    register_before = read_register(bench, 5)
    for value in (3.0, 0.0, math.nan, -math.inf):
        write_register(bench, 5, struct.pack("<f", value))
        assert read_register(bench, 5) == register_before
    for register in (4, 6):
        register_before = read_register(bench, register)
        for value in (-3.0, 0.0, math.nan, math.inf):
            write_register(bench, register, struct.pack("<f", value))
            assert read_register(bench, register) == register_before


@pytest.mark.parametrize(
    ("speed_code", "current_code"), [(10_001, 500), (1000, 10_001), (65_535, 65_535)]
)
def test_force_position_codes_end_at_10000(speed_code: int, current_code: int) -> None:
    bench = damiao_bench(4)
    assert bench.receive(Frame(0x302, struct.pack("<fHH", 3.0, speed_code, current_code))) == []
    assert bench.malformed_frame_count == 1
    bench.advance(100 * NS_PER_MS)
    assert bench.motors[0].theta == 0.0


def test_a_blocked_damiao_motor_holds_the_current_of_force_position_mode() -> None:
    bench = damiao_bench(4)
    motor = bench.motors[0]
    bench.receive(Frame(0x302, struct.pack("<fHH", 3.0, 500, 2000)))
    for _ in range(2000):
        motor.theta = motor.omega = 0.0
        bench.advance(bench.t_ns + NS_PER_MS)
    assert motor.torque == pytest.approx(0.2 * 7.0, rel=0.02)


def test_a_damiao_motor_changes_its_mode_while_enabled() -> None:
    """A change of the control mode discards the old setpoint of the motor.

    After a change of mode, the motor turns freely until it gets a command for the new mode.
    """
    bench = damiao_bench(3)
    motor = bench.motors[0]
    bench.receive(Frame(0x202, struct.pack("<f", 5.0)))
    bench.advance(1000 * NS_PER_MS)
    write_register(bench, 10, struct.pack("<I", 2))
    bench.advance(bench.t_ns + 20 * NS_PER_MS)
    assert motor.command == 0.0
    bench.receive(Frame(0x202, struct.pack("<f", 5.0)))
    bench.advance(bench.t_ns + 20 * NS_PER_MS)
    assert motor.command == 0.0, "a frame of the old mode has no effect"
    bench.receive(Frame(0x102, struct.pack("<ff", 1.0, 3.0)))
    bench.advance(bench.t_ns + 4000 * NS_PER_MS)
    assert motor.theta == pytest.approx(1.0, abs=0.01)
    write_register(bench, 10, struct.pack("<I", 1))
    bench.receive(Frame(2, bytes.fromhex("7fff7ff000000fff")))
    assert (motor.servo.torque, motor.servo.limit) == (10.0, 7.0), (
        "MIT mode has a separate torque limit"
    )


def test_the_watchdog_of_a_damiao_motor_ends_a_motion() -> None:
    bench = damiao_bench(3)
    write_register(bench, 9, struct.pack("<I", 2000))
    bench.receive(Frame(0x202, struct.pack("<f", 5.0)))
    bench.advance(300 * NS_PER_MS)
    assert (bench.motors[0].command, bench.motors[0].servo.kd) == (0.0, 0.0)
    assert bench.receive(Frame(0x7FF, b"\2\0\xcc\0" + bytes(4)))[-1].data[0] >> 4 == 0xD


# Tests of the modes of an ODrive.


def odrive_bench(
    control_mode: int, input_mode: int, *messages: tuple[int, bytes], inertia: float | None = None
) -> SimulatedDriveBench:
    """Return a bench with an ODrive (node 3) in closed-loop control.

    The bench sends the given messages to the ODrive before the closed-loop control begins.
    """
    bench = SimulatedDriveBench([drive_spec("odrive", 3, inertia=inertia)])
    send_messages(
        bench,
        (0x0B, struct.pack("<II", control_mode, input_mode)),
        *messages,
        (0x07, struct.pack("<I", 8)),
    )
    return bench


def send_messages(bench: SimulatedDriveBench, *messages: tuple[int, bytes]) -> None:
    for command, data in messages:
        bench.receive(Frame(3 << 5 | command, data))


def write_endpoint(bench: SimulatedDriveBench, endpoint: int, value: float) -> None:
    send_messages(bench, (0x04, struct.pack("<BHBf", 1, endpoint, 0, value)))


def next_heartbeat(bench: SimulatedDriveBench) -> tuple[int, int, int]:
    """Return the errors, the axis state and the trajectory flag in the next heartbeat of the ODrive."""
    bench.take_unsolicited_frames()
    bench.advance(bench.t_ns + 200 * NS_PER_MS)
    data = [frame.data for frame in bench.take_unsolicited_frames() if frame.can_id == 3 << 5 | 1][
        -1
    ]
    return int.from_bytes(data[:4], "little"), data[4], data[6]


def test_an_odrive_holds_a_velocity_without_an_error() -> None:
    bench = odrive_bench(2, 1)
    send_messages(bench, (0x0D, struct.pack("<ff", -2.0, 0.0)))
    bench.advance(5000 * NS_PER_MS)
    assert bench.motors[0].omega == pytest.approx(-2.0 * TURN_RAD, rel=1e-3)


def test_the_velocity_ramp_of_an_odrive_acts() -> None:
    bench = odrive_bench(2, 2)
    write_endpoint(bench, 205, 3.0)
    motor = bench.motors[0]
    send_messages(bench, (0x0D, struct.pack("<ff", 3.0, 0.0)))
    speeds = sample_each_ms(bench, 2.0, lambda: motor.omega / TURN_RAD)
    assert speeds[499] == pytest.approx(1.5, rel=0.05)
    assert speeds[-1] == pytest.approx(3.0, rel=0.02)
    assert largest_acceleration(speeds, 100) <= 3.3


def test_the_torque_ramp_of_an_odrive_acts() -> None:
    bench = odrive_bench(1, 6, inertia=1.0)
    write_endpoint(bench, 206, 0.2)
    send_messages(bench, (0x0E, struct.pack("<f", 0.1)))
    torques = sample_each_ms(bench, 0.8, lambda: bench.motors[0].torque)
    assert torques[249] == pytest.approx(0.05, rel=0.1)
    assert torques[-1] == pytest.approx(0.1, rel=0.01)


def test_the_position_filter_of_an_odrive_does_not_overshoot() -> None:
    bench = odrive_bench(3, 3)
    write_endpoint(bench, 207, 4.0)
    send_messages(bench, (0x0C, struct.pack("<fhh", 1.0, 0, 0)))
    angles = sample_each_ms(bench, 4.0, lambda: bench.motors[0].theta / TURN_RAD)
    # The input filter is critically damped with the time constant 1 / bandwidth, here 1/4 s. With
    # the time constant 1/4 s, the step response of the filter is 1 - (1 + 4 t) exp(-4 t).
    assert angles[499] == pytest.approx(1.0 - 3.0 * math.exp(-2.0), abs=0.03)
    assert max(angles) < 1.02
    assert angles[-1] == pytest.approx(1.0, abs=0.005)


def test_a_trajectory_of_an_odrive_has_ramps_and_says_when_it_is_done() -> None:
    limits = (0x11, struct.pack("<f", 1.0)), (0x12, struct.pack("<ff", 1.0, 0.5))
    bench = odrive_bench(3, 5, *limits)
    motor = bench.motors[0]
    send_messages(bench, (0x0C, struct.pack("<fhh", 3.0, 0, 0)))
    # The drive accelerates for 1 s over 0.5 turns, moves 1.5 turns at full speed, and brakes for 2
    # s over 1 turn. The whole trajectory of the drive takes 4.5 s.
    speeds = sample_each_ms(bench, 1.0, lambda: motor.omega / TURN_RAD)
    assert speeds[499] == pytest.approx(0.5, rel=0.05)
    assert next_heartbeat(bench)[2] == 0
    sample_each_ms(bench, 2.1, lambda: 0.0)
    assert motor.omega / TURN_RAD == pytest.approx(0.6, abs=0.05)
    assert next_heartbeat(bench)[2] == 0
    sample_each_ms(bench, 1.5, lambda: 0.0)
    assert next_heartbeat(bench) == (0, 8, 1)
    assert motor.theta / TURN_RAD == pytest.approx(3.0, abs=0.005)
    send_messages(bench, (0x0C, struct.pack("<fhh", 2.0, 0, 0)))
    assert next_heartbeat(bench)[2] == 0


def test_the_torque_limits_of_an_odrive_act_in_position_control() -> None:
    bench = odrive_bench(3, 1)
    write_endpoint(bench, 203, 0.1)
    write_endpoint(bench, 204, -0.1)
    motor = bench.motors[0]
    send_messages(bench, (0x0C, struct.pack("<fhh", 5.0, 0, 0)))
    for _ in range(1000):
        motor.theta = motor.omega = 0.0
        bench.advance(bench.t_ns + NS_PER_MS)
    assert motor.torque == pytest.approx(0.1, rel=0.01)


def test_an_odrive_ignores_a_change_of_the_mode_in_closed_loop() -> None:
    bench = odrive_bench(2, 1)
    send_messages(bench, (0x0B, struct.pack("<II", 1, 1)), (0x0D, struct.pack("<ff", 1.0, 0.0)))
    bench.advance(2000 * NS_PER_MS)
    assert bench.motors[0].omega == pytest.approx(TURN_RAD, rel=0.02)


@pytest.mark.parametrize("control_mode", [1, 2, 3])
@pytest.mark.parametrize(
    "setpoint_message",
    [(0x0C, struct.pack("<fhh", math.nan, 0, 0)), (0x0D, struct.pack("<ff", 0, math.inf))],
)
def test_a_setpoint_that_is_not_finite_disarms(
    control_mode: int, setpoint_message: tuple[int, bytes]
) -> None:
    bench = odrive_bench(control_mode, 1)
    send_messages(bench, setpoint_message)
    assert next_heartbeat(bench)[:2] == (1 << 6, 1)
    assert bench.motors[0].command == 0.0


def test_an_odrive_keeps_its_gains_and_limits_when_they_are_impossible() -> None:
    bench = SimulatedDriveBench([drive_spec("odrive", 3)])
    settings_before = bench.nodes[0].motion.settings  # type: ignore[attr-defined]
    send_messages(
        bench,
        (0x11, struct.pack("<f", 0.0)),
        (0x12, struct.pack("<ff", 1.0, -1.0)),
        (0x13, struct.pack("<f", math.nan)),
        (0x1A, struct.pack("<f", -1.0)),
        (0x1B, struct.pack("<ff", math.inf, 0.0)),
    )
    assert bench.nodes[0].motion.settings == settings_before  # type: ignore[attr-defined]


# Tests of the modes of a CiA 402 drive.

COUNTS_PER_TURN = 1 << 16


def cia402_bench(
    operation_mode: int, *object_values: tuple[int, int, int, int], **drive_options: object
) -> SimulatedDriveBench:
    """Return a bench with an enabled CiA 402 drive (node 33) in a mode.

    Before the drive is enabled, the function writes each entry of ``object_values`` to the object
    dictionary of the drive. An entry is (index, sub-index, value, size).
    """
    spec = drive_spec("cia402", 33)
    bench = SimulatedDriveBench([replace(spec, options={**spec.options, **drive_options})])
    write_object(bench, 0x6060, 0, operation_mode, 1)
    for object_value in object_values:
        write_object(bench, *object_value)
    for word in (0x06, 0x07, 0x0F):
        write_object(bench, 0x6040, 0, word, 2)
    return bench


def send_sdo(bench: SimulatedDriveBench, request_data: bytes) -> bytes:
    return [
        frame.data
        for frame in bench.receive(Frame(0x600 + 33, request_data))
        if frame.can_id == 0x580 + 33
    ][-1]


def write_object(
    bench: SimulatedDriveBench, index: int, sub_index: int, value: int, size: int
) -> int:
    """Write an object of the CiA 402 drive by SDO. Return the abort code, or 0 if the drive sends no abort code."""
    raw = (value & ((1 << 8 * size) - 1)).to_bytes(size, "little").ljust(4, b"\0")
    reply = send_sdo(bench, struct.pack("<BHB", 0x23 | (4 - size) << 2, index, sub_index) + raw)
    return int.from_bytes(reply[4:], "little") if reply[0] == 0x80 else 0


def read_object(bench: SimulatedDriveBench, index: int, sub_index: int = 0) -> int:
    reply = send_sdo(bench, struct.pack("<BHB4x", 0x40, index, sub_index))
    size = 4 - (reply[0] >> 2 & 3)
    return int.from_bytes(reply[4 : 4 + size], "little", signed=True)


def send_controlword(bench: SimulatedDriveBench, control_word: int) -> int:
    """Write a control word to the CiA 402 drive, wait 10 ms, and return the status word of the drive."""
    write_object(bench, 0x6040, 0, control_word, 2)
    bench.advance(bench.t_ns + 10 * NS_PER_MS)
    return read_object(bench, 0x6041)


def test_a_cia402_drive_lists_its_modes() -> None:
    bench = SimulatedDriveBench([drive_spec("cia402", 33)])
    # In the object of the supported modes, bit n - 1 stands for mode n. The drive supports profile
    # position, homing, and the three cyclic modes.
    assert read_object(bench, 0x6502) == sum(1 << mode - 1 for mode in (1, 6, 8, 9, 10))
    for mode, displayed_mode in ((1, 1), (6, 6), (8, 8), (9, 9), (10, 10), (3, 0), (-1, 0)):
        write_object(bench, 0x6060, 0, mode, 1)
        assert read_object(bench, 0x6061) == displayed_mode


def test_a_cyclic_position_is_followed_and_interpolated() -> None:
    bench = cia402_bench(8, (0x60C2, 1, 20, 1), (0x60C2, 2, -3, 1))
    motor = bench.motors[0]
    target = 0
    angles = []
    for _ in range(100):
        target += 200
        write_object(bench, 0x607A, 0, target, 4)
        angles += sample_each_ms(bench, 0.02, lambda: motor.theta)
    speeds = [
        (angle_after - angle_before) * 1000
        for angle_before, angle_after in itertools.pairwise(angles)
    ]
    rate = 200 / 0.02 / COUNTS_PER_TURN * TURN_RAD
    assert max(speeds[1000:]) < 1.1 * rate, "20 ms steps are smoothed"
    assert min(speeds[1000:]) > 0.9 * rate
    bench.advance(bench.t_ns + 2000 * NS_PER_MS)
    assert read_object(bench, 0x6064) == pytest.approx(target, abs=10)
    assert read_object(bench, 0x6041) & 0x3C00 == 1 << 12


def test_a_cyclic_velocity_is_held() -> None:
    bench = cia402_bench(9, (0x60FF, 0, -120, 4))
    bench.advance(3000 * NS_PER_MS)
    assert bench.motors[0].omega == pytest.approx(-120 / 60 * TURN_RAD, rel=0.01)
    assert read_object(bench, 0x606C) == pytest.approx(-120, abs=1)
    write_object(bench, 0x6080, 0, 30, 4)
    bench.advance(bench.t_ns + 3000 * NS_PER_MS)
    assert bench.motors[0].omega == pytest.approx(-30 / 60 * TURN_RAD, rel=0.02)
    assert read_object(bench, 0x6041) & 1 << 11, 'the bit "internal limit" is set'


def test_the_torque_limit_acts_in_cyclic_position() -> None:
    bench = cia402_bench(8, (0x6072, 0, 100, 2))
    motor = bench.motors[0]
    write_object(bench, 0x607A, 0, COUNTS_PER_TURN, 4)
    for _ in range(1000):
        motor.theta = motor.omega = 0.0
        bench.advance(bench.t_ns + NS_PER_MS)
    assert motor.torque == pytest.approx(0.1, rel=0.01)


def test_a_following_error_is_a_fault() -> None:
    bench = cia402_bench(8, (0x6065, 0, 1000, 4), (0x6066, 0, 50, 2))
    motor = bench.motors[0]
    write_object(bench, 0x607A, 0, 5000, 4)
    bench.take_unsolicited_frames()
    for _ in range(100):
        motor.theta = motor.omega = 0.0
        bench.advance(bench.t_ns + NS_PER_MS)
    assert read_object(bench, 0x6041) & 0x4F == 0x08
    emergency_messages = [
        frame.data for frame in bench.take_unsolicited_frames() if frame.can_id == 0x80 + 33
    ]
    assert [int.from_bytes(data[:2], "little") for data in emergency_messages] == [0x8611]
    assert motor.command == 0.0


def test_a_profile_position_has_ramps_and_says_when_it_is_reached() -> None:
    bench = cia402_bench(1, (0x6081, 0, 60, 4), (0x6083, 0, 60, 4), (0x6084, 0, 30, 4))
    motor = bench.motors[0]
    write_object(bench, 0x607A, 0, 3 * COUNTS_PER_TURN, 4)
    bench.advance(100 * NS_PER_MS)
    assert motor.theta == pytest.approx(0.0, abs=1e-3), "a target waits for the edge of bit 4"
    word = send_controlword(bench, 0x1F)
    assert word & (1 << 12 | 1 << 10) == 1 << 12, "the target is acknowledged and not reached"
    assert not send_controlword(bench, 0x0F) & 1 << 12
    # The drive accelerates for 1 s with 1 turn/s2, keeps the speed of 1 turn/s for 1.5 s, and
    # brakes for 2 s with 0.5 turn/s2.
    speeds = sample_each_ms(bench, 4.6, lambda: motor.omega / TURN_RAD)
    assert speeds[480] == pytest.approx(0.5, rel=0.05)
    assert max(speeds) < 1.02
    bench.advance(bench.t_ns + 300 * NS_PER_MS)
    assert read_object(bench, 0x6041) & 1 << 10
    assert read_object(bench, 0x6064) == pytest.approx(3 * COUNTS_PER_TURN, abs=100)


@pytest.mark.parametrize("is_immediate", [False, True])
def test_a_second_set_point_waits_unless_it_is_immediate(is_immediate: bool) -> None:
    bench = cia402_bench(1, (0x6083, 0, 6000, 4), (0x6084, 0, 6000, 4))
    motor = bench.motors[0]
    write_object(bench, 0x607A, 0, COUNTS_PER_TURN, 4)
    send_controlword(bench, 0x1F)
    send_controlword(bench, 0x0F)
    write_object(bench, 0x607A, 0, 0, 4)
    send_controlword(bench, 0x1F | is_immediate << 5)
    assert bool(send_controlword(bench, 0x0F) & 1 << 12) != is_immediate, "the buffer is full"
    max_position = max(sample_each_ms(bench, 3.0, lambda: motor.theta / TURN_RAD))
    assert max_position == pytest.approx(0.0 if is_immediate else 1.0, abs=0.1)
    assert motor.theta == pytest.approx(0.0, abs=0.02)


def test_a_relative_set_point_and_halt() -> None:
    bench = cia402_bench(1)
    motor = bench.motors[0]
    for turns in (1, 2):
        write_object(bench, 0x607A, 0, COUNTS_PER_TURN, 4)
        send_controlword(bench, 0x5F)
        send_controlword(bench, 0x4F)
        bench.advance(bench.t_ns + 2500 * NS_PER_MS)
        assert motor.theta / TURN_RAD == pytest.approx(turns, abs=0.01)
    write_object(bench, 0x607A, 0, 0, 4)
    send_controlword(bench, 0x1F)
    bench.advance(bench.t_ns + 500 * NS_PER_MS)
    send_controlword(bench, 0x11F)
    bench.advance(bench.t_ns + 500 * NS_PER_MS)
    assert motor.omega == pytest.approx(0.0, abs=0.05)
    assert read_object(bench, 0x6041) & 1 << 10, "the motor is at standstill"
    assert motor.theta / TURN_RAD > 0.5
    send_controlword(bench, 0x1F)
    bench.advance(bench.t_ns + 3000 * NS_PER_MS)
    assert motor.theta == pytest.approx(0.0, abs=0.02), (
        "after the halt the motor moves to the target"
    )


def test_a_set_point_bit_left_by_homing_is_no_edge() -> None:
    bench = cia402_bench(6)
    assert send_controlword(bench, 0x1F) & 1 << 12
    write_object(bench, 0x6060, 0, 1, 1)
    write_object(bench, 0x607A, 0, COUNTS_PER_TURN, 4)
    assert not send_controlword(bench, 0x1F) & 1 << 12, "no target is acknowledged"
    send_controlword(bench, 0x0F)
    assert send_controlword(bench, 0x1F) & 1 << 12


def test_the_position_limits_of_a_cia402_drive_act() -> None:
    bench = cia402_bench(
        8, (0x607D, 1, -COUNTS_PER_TURN // 4, 4), (0x607D, 2, COUNTS_PER_TURN // 2, 4)
    )
    for target, end in (
        (2 * COUNTS_PER_TURN, COUNTS_PER_TURN // 2),
        (-2 * COUNTS_PER_TURN, -COUNTS_PER_TURN // 4),
    ):
        write_object(bench, 0x607A, 0, target, 4)
        bench.advance(bench.t_ns + 3000 * NS_PER_MS)
        assert read_object(bench, 0x6064) == pytest.approx(end, abs=20)
        assert read_object(bench, 0x6041) & 1 << 11


def test_homing_here_sets_the_position() -> None:
    bench = cia402_bench(6, (0x607C, 0, 1234, 4))
    assert not send_controlword(bench, 0x0F) & 1 << 12
    word = send_controlword(bench, 0x1F)
    assert word & (1 << 10 | 1 << 12 | 1 << 13) == 1 << 10 | 1 << 12, (
        "target reached and homing attained"
    )
    assert read_object(bench, 0x6064) == pytest.approx(1234, abs=5)
    assert bench.motors[0].theta == pytest.approx(0.0, abs=1e-3), "the motor did not move"


@pytest.mark.parametrize(("homing_method", "expected_end_rad"), [(33, 0.0), (34, TURN_RAD)])
def test_homing_finds_the_next_index_pulse(homing_method: int, expected_end_rad: float) -> None:
    bench = cia402_bench(6, (0x6098, 0, homing_method, 1), (0x6099, 2, 30, 4))
    motor = bench.motors[0]
    motor.theta = 2.0
    write_object(bench, 0x6060, 0, 10, 1)
    write_object(bench, 0x6060, 0, 6, 1)
    send_controlword(bench, 0x1F)
    speeds = sample_each_ms(bench, 4.0, lambda: abs(motor.omega))
    assert max(speeds) < 1.15 * 30 / 60 * TURN_RAD
    assert motor.theta == pytest.approx(expected_end_rad, abs=0.02)
    assert read_object(bench, 0x6041) & 1 << 12
    assert read_object(bench, 0x6064) == pytest.approx(0, abs=110)


def test_a_homing_method_without_its_switch_is_refused() -> None:
    bench = cia402_bench(6)
    for method in (1, 17, 18, 36, -3):
        assert write_object(bench, 0x6098, 0, method, 1) == 0x06090030
    assert read_object(bench, 0x6098) == 37


@pytest.mark.parametrize("operation_mode", [1, 8])
def test_a_mode_change_while_enabled_holds_the_position(operation_mode: int) -> None:
    bench = cia402_bench(9, (0x60FF, 0, 60, 4))
    motor = bench.motors[0]
    write_object(bench, 0x607A, 0, 50 * COUNTS_PER_TURN, 4)
    bench.advance(2000 * NS_PER_MS)
    angle = motor.theta
    write_object(bench, 0x6060, 0, operation_mode, 1)
    bench.advance(bench.t_ns + 2000 * NS_PER_MS)
    assert motor.theta == pytest.approx(angle, abs=0.2)
    assert motor.omega == pytest.approx(0.0, abs=0.05)
    write_object(bench, 0x6060, 0, 10, 1)
    bench.advance(bench.t_ns + 20 * NS_PER_MS)
    assert (motor.command, motor.servo.kd) == (0.0, 0.0), "torque mode has a separate target"


def test_a_disabled_cia402_drive_does_not_move() -> None:
    bench = cia402_bench(9, (0x60FF, 0, 60, 4))
    bench.advance(1000 * NS_PER_MS)
    send_controlword(bench, 0x06)
    assert (bench.motors[0].command, bench.motors[0].servo.kd) == (0.0, 0.0)
    assert read_object(bench, 0x6041) & 0x3C00 == 0
