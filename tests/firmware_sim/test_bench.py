"""Test simulated drives with free shafts: the factory settings of each drive, and the motion of its shaft."""

import math
import struct
from dataclasses import replace

import pytest

from firmware_sim.__main__ import main
from firmware_sim.bus.frame import BRS, EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from firmware_sim.description.hand_description import SimulatorError
from firmware_sim.faults.faulty_drive import DRIVE_FAULTS
from firmware_sim.nodes import PROTOCOL_SPECS, cubemars
from firmware_sim.nodes.cia402.object_dictionary import EDS_PATH, ObjectDictionary
from firmware_sim.nodes.mit import bench as mit_bench
from firmware_sim.nodes.odrive import bench as odrive_bench
from firmware_sim.programs.drive import SimulatedDriveBench
from firmware_sim.programs.drive_types import drive_spec

NS_PER_MS = 1_000_000
ENABLE_PAYLOAD = b"\xff" * 7 + b"\xfc"


def read_register(bench: SimulatedDriveBench, node_id: int, register_number: int) -> bytes:
    (reply,) = bench.receive(Frame(0x7FF, bytes((node_id, 0, 0x33, register_number, 0, 0, 0, 0))))
    assert reply.can_id == node_id + 0x10
    return reply.data[4:]


@pytest.mark.parametrize("motor_type", mit_bench.MOTOR_TYPE_RANGES)
def test_an_mit_motor_has_the_manufacturers_ranges_and_no_watchdog(motor_type: str) -> None:
    bench = SimulatedDriveBench(
        [drive_spec("mit", 2, motor_type), drive_spec("mit", 5, motor_type)]
    )
    for node in (2, 5):
        ranges = [
            struct.unpack("<f", read_register(bench, node, number))[0] for number in (21, 22, 23)
        ]
        assert ranges == pytest.approx(mit_bench.MOTOR_TYPE_RANGES[motor_type])
        assert read_register(bench, node, 9) == bytes(4)
        assert read_register(bench, node, 35) == b"\4\0\0\0"


@pytest.mark.parametrize(
    ("motor_type", "expected_ratio"),
    [("dm3507", 7), ("dm4310", 10), ("dm4310v", 10), ("dm4340", 40), ("dm6248", 48), ("dm8009", 9)],
)
def test_an_mit_motor_reads_the_gear_ratio_of_its_type(
    motor_type: str, expected_ratio: int
) -> None:
    """Reproduce a defect: simulated MIT motors of every type reported the gear ratio 16.

    Because of the wrong gear ratio, the client i2rt refused all simulated MIT motors.
    """
    bench = SimulatedDriveBench([drive_spec("mit", 2, motor_type)])
    assert struct.unpack("<f", read_register(bench, 2, 20)) == (expected_ratio,)


def test_a_motor_set_to_fd_reports_it_and_answers_in_fd() -> None:
    bench = SimulatedDriveBench([drive_spec("mit", 1, fd=True)])
    assert read_register(bench, 1, 35)[0] == 9
    (reply,) = bench.receive(Frame(1, ENABLE_PAYLOAD, FDF | BRS))
    assert reply.flags == FDF | BRS


def test_a_free_shaft_turns_by_its_inertia() -> None:
    bench = SimulatedDriveBench([drive_spec("odrive", 0, inertia=1e-3)])
    for command, data in ((0x0B, struct.pack("<II", 1, 1)), (0x07, struct.pack("<I", 8))):
        bench.receive(Frame(command, data))
    bench.receive(Frame(0x0E, struct.pack("<f", 0.1)))
    bench.advance(200 * NS_PER_MS)
    spec = drive_spec("odrive", 0, inertia=1e-3)
    expected = (
        (0.1 - spec.coulomb) / spec.viscous * (1.0 - math.exp(-0.2 * spec.viscous / spec.inertia))
    )
    assert bench.motors[0].omega == pytest.approx(expected, rel=0.03)
    bench.receive(Frame(0x07, struct.pack("<I", 1)))
    bench.advance(20_000 * NS_PER_MS)
    assert abs(bench.motors[0].omega) < 0.01, "friction stops the shaft"


def test_an_odrive_follows_positions_and_velocities() -> None:
    bench = SimulatedDriveBench([drive_spec("odrive", 3)])
    bench.receive(Frame(3 << 5 | 0x07, struct.pack("<I", 8)))
    bench.receive(Frame(3 << 5 | 0x0C, struct.pack("<fhh", 1.5, 0, 0)))
    bench.advance(2000 * NS_PER_MS)
    assert bench.motors[0].theta == pytest.approx(1.5 * math.tau, abs=0.1)
    bench.receive(Frame(3 << 5 | 0x07, struct.pack("<I", 1)))
    bench.receive(Frame(3 << 5 | 0x0B, struct.pack("<II", 2, 1)))
    bench.receive(Frame(3 << 5 | 0x07, struct.pack("<I", 8)))
    bench.receive(Frame(3 << 5 | 0x0D, struct.pack("<ff", -2.0, 0.0)))
    bench.advance(3000 * NS_PER_MS)
    assert bench.motors[0].omega == pytest.approx(-2.0 * math.tau, rel=0.05)
    bench.receive(Frame(3 << 5 | 0x0C, struct.pack("<fhh", math.nan, 0, 0)))
    assert bench.motors[0].servo.kd == 0.0


def run_at_torque(
    protocol: str, torque: float, motor_type: str = "", inertia: float | None = None
) -> tuple[SimulatedDriveBench, float]:
    """Command a simulated drive to make a torque [N m] for five seconds.

    Return the bench with the simulated drive, and the final speed of its shaft [rad/s].
    """
    bench = SimulatedDriveBench([drive_spec(protocol, 2, motor_type, inertia=inertia)])
    spec = drive_spec(protocol, 2, motor_type)
    code = round((torque / spec.torque_max + 1.0) / 2.0 * 4095)
    bench.receive(Frame(2, ENABLE_PAYLOAD))
    for _ in range(50):
        bench.receive(Frame(2, (0x7FFF7FF << 36 | code).to_bytes(8, "big")))
        bench.advance(bench.t_ns + 100 * NS_PER_MS)
    return bench, bench.motors[0].omega


@pytest.mark.parametrize("motor_type", sorted(mit_bench.MOTOR_TYPE_RANGES))
@pytest.mark.parametrize("inertia", [None, 2e-5], ids=["free shaft", "light shaft"])
def test_a_damiao_motor_turns_no_faster_than_its_no_load_speed(
    motor_type: str, inertia: float | None
) -> None:
    """Reproduce a defect: 1 N m drove a DM4310 motor to 76 rad/s, although its speed without load is 21 rad/s."""
    shaft = mit_bench.shaft_of_mit_motor(motor_type)
    for sign in (1.0, -1.0):
        _, speed = run_at_torque("mit", sign * 0.1 * shaft.peak, motor_type, inertia)
        assert 0.9 * shaft.top_speed < sign * speed <= shaft.top_speed


def test_a_dm4310_turns_at_200_rpm_at_one_newton_metre() -> None:
    _, speed = run_at_torque("mit", 1.0)
    assert speed == pytest.approx(200.0 / 60.0 * math.tau, rel=0.01)


@pytest.mark.parametrize("motor_type", sorted(cubemars.FULL_SCALE_BY_MOTOR_TYPE))
def test_a_cubemars_motor_turns_no_faster_than_its_no_load_speed(motor_type: str) -> None:
    shaft = cubemars.shaft_of_cubemars_motor(motor_type)
    _, speed = run_at_torque("mit", 0.1 * shaft.peak, motor_type)
    assert 0.9 * shaft.top_speed < speed <= shaft.top_speed


def test_a_motor_makes_no_more_than_its_peak_torque() -> None:
    """A DM4310 motor accepts commands up to 10 N m, but its peak torque is 7 N m."""
    bench, _ = run_at_torque("mit", 10.0, inertia=100.0)
    assert bench.motors[0].torque == pytest.approx(7.0, rel=0.01)


def test_the_torque_falls_with_the_speed() -> None:
    bench = SimulatedDriveBench([drive_spec("mit", 2, inertia=100.0)])
    motor, rating = bench.motors[0], mit_bench.MOTOR_RATINGS["dm4310"]
    motor.servo.torque = 7.0
    for fraction, expected in (
        (0.0, 7.0),
        (0.75, 0.25 * rating.stall_torque),
        (1.0, 0.0),
        (1.5, 0.0),
    ):
        motor.omega = fraction * rating.top_speed
        bench.advance(bench.t_ns + 20 * NS_PER_MS)
        assert motor.torque == pytest.approx(expected, abs=0.15)


def send_to_odrive(bench: SimulatedDriveBench, *messages: tuple[int, bytes]) -> None:
    """Send messages to the ODrive with node number 3 on a bench."""
    for command, data in messages:
        bench.receive(Frame(3 << 5 | command, data))


TORQUE_MODE_MESSAGE = (0x0B, struct.pack("<II", 1, 1))
CLOSED_LOOP_MESSAGE = (0x07, struct.pack("<I", 8))
IDLE_MESSAGE = (0x07, struct.pack("<I", 1))


@pytest.mark.parametrize("inertia", [2e-5, 1e-4, 1e-2])
def test_the_velocity_limit_of_an_odrive_acts_in_torque_control(inertia: float) -> None:
    bench = SimulatedDriveBench([drive_spec("odrive", 3, inertia=inertia)])
    send_to_odrive(
        bench,
        TORQUE_MODE_MESSAGE,
        (0x0F, struct.pack("<ff", 2.0, 20.0)),
        CLOSED_LOOP_MESSAGE,
        (0x0E, struct.pack("<f", 0.05)),
    )
    bench.advance(10_000 * NS_PER_MS)
    assert 1.5 * math.tau < bench.motors[0].omega <= 2.0 * math.tau
    send_to_odrive(bench, (0x0F, struct.pack("<ff", 1.0, 20.0)), (0x0E, struct.pack("<f", 0.05)))
    bench.advance(bench.t_ns + 5_000 * NS_PER_MS)
    assert bench.motors[0].omega <= 1.0 * math.tau, "the drive brakes above its velocity limit"
    send_to_odrive(bench, IDLE_MESSAGE)
    bench.motors[0].omega = 100.0
    bench.advance(bench.t_ns + 50 * NS_PER_MS)
    assert bench.motors[0].omega > 80.0, "an idle motor coasts"


def test_the_velocity_limit_of_an_odrive_acts_in_position_control() -> None:
    bench = SimulatedDriveBench([drive_spec("odrive", 3)])
    send_to_odrive(
        bench,
        (0x0F, struct.pack("<ff", 2.0, 20.0)),
        CLOSED_LOOP_MESSAGE,
        (0x0C, struct.pack("<fhh", 20.0, 0, 0)),
    )
    fastest = 0.0
    for _ in range(100):
        bench.advance(bench.t_ns + 50 * NS_PER_MS)
        fastest = max(fastest, bench.motors[0].omega)
    assert 1.8 * math.tau < fastest <= 2.0 * math.tau


def test_a_trajectory_of_an_odrive_has_a_velocity_limit_of_its_own() -> None:
    bench = SimulatedDriveBench([drive_spec("odrive", 3)])
    send_to_odrive(
        bench, (0x0B, struct.pack("<II", 3, 5)), (0x11, struct.pack("<f", 1.0)), CLOSED_LOOP_MESSAGE
    )
    send_to_odrive(bench, (0x0C, struct.pack("<fhh", 10.0, 0, 0)))
    fastest = 0.0
    for _ in range(300):
        bench.advance(bench.t_ns + 50 * NS_PER_MS)
        fastest = max(fastest, bench.motors[0].omega)
    assert 0.8 * math.tau < fastest <= 1.02 * math.tau
    assert bench.motors[0].theta == pytest.approx(10.0 * math.tau, abs=0.2)


def test_the_current_limit_of_an_odrive_acts() -> None:
    bench = SimulatedDriveBench([drive_spec("odrive", 3, inertia=1.0)])
    send_to_odrive(
        bench,
        TORQUE_MODE_MESSAGE,
        (0x0F, struct.pack("<ff", 50.0, 4.0)),
        CLOSED_LOOP_MESSAGE,
        (0x0E, struct.pack("<f", 1.0)),
    )
    bench.advance(10 * NS_PER_MS)
    assert bench.motors[0].torque == pytest.approx(4.0 * odrive_bench.TORQUE_CONSTANT, rel=0.01)


@pytest.mark.parametrize("command_number", [0x00, 0x03, 0x06, 0x09, 0x14, 0x15, 0x17, 0x1C, 0x1D])
def test_an_odrive_answers_an_empty_data_frame_as_a_request(command_number: int) -> None:
    bench = SimulatedDriveBench([drive_spec("odrive", 3)])
    (remote,) = bench.receive(Frame(3 << 5 | command_number | REMOTE_FLAG, b""))
    (data,) = bench.receive(Frame(3 << 5 | command_number, b""))
    assert (data.can_id, data.data) == (remote.can_id, remote.data)


def encoder_position(bench: SimulatedDriveBench) -> float:
    (reply,) = bench.receive(Frame(3 << 5 | 0x09 | REMOTE_FLAG, b""))
    return float(struct.unpack_from("<f", reply.data)[0])


@pytest.mark.parametrize("firmware_version", ["0.6", "0.5"])
def test_an_odrive_obeys_set_absolute_position(firmware_version: str) -> None:
    bench = SimulatedDriveBench([drive_spec("odrive", 3, firmware=firmware_version)])
    send_to_odrive(
        bench,
        (
            0x19,
            struct.pack("<f", 7.25)
            if firmware_version == "0.6"
            else struct.pack("<i", 7 * 8192 + 2048),
        ),
    )
    assert encoder_position(bench) == pytest.approx(7.25)
    send_to_odrive(bench, CLOSED_LOOP_MESSAGE, (0x0C, struct.pack("<fhh", 7.5, 0, 0)))
    bench.advance(2000 * NS_PER_MS)
    assert encoder_position(bench) == pytest.approx(7.5, abs=0.02)


def test_an_odrive_calibrates() -> None:
    spec = drive_spec("odrive", 3)
    bench = SimulatedDriveBench([replace(spec, options={**spec.options, "uncalibrated": True})])

    def read_heartbeat() -> tuple[int, int]:
        bench.advance(bench.t_ns + 200 * NS_PER_MS)
        heartbeats = [
            frame for frame in bench.take_unsolicited_frames() if frame.can_id == 3 << 5 | 0x01
        ]
        return heartbeats[-1].data[4], heartbeats[-1].data[5]

    send_to_odrive(bench, CLOSED_LOOP_MESSAGE)
    assert read_heartbeat() == (1, 14), "the error is a missing calibration"
    send_to_odrive(bench, (0x07, struct.pack("<I", 3)))
    assert read_heartbeat() == (3, 1), "the calibration runs"
    send_to_odrive(bench, IDLE_MESSAGE)
    assert read_heartbeat() == (1, 2), "the calibration was cancelled"
    send_to_odrive(bench, (0x07, struct.pack("<I", 3)))
    bench.advance(bench.t_ns + 4_000 * NS_PER_MS)
    assert read_heartbeat() == (1, 0)
    send_to_odrive(bench, CLOSED_LOOP_MESSAGE)
    assert read_heartbeat() == (8, 0)


def test_an_odrive_keeps_what_reboot_saves() -> None:
    bench = SimulatedDriveBench([drive_spec("odrive", 3)])

    def endpoint(number: int) -> bytes:
        (reply,) = bench.receive(Frame(3 << 5 | 0x04, struct.pack("<BHB", 0, number, 0)))
        return reply.data[4:]

    send_to_odrive(bench, (0x04, struct.pack("<BHBf", 1, 202, 0, 0.25)), (0x16, b"\0"))
    assert endpoint(202) == struct.pack("<f", 0.0), "a reboot does not save values"
    send_to_odrive(
        bench, (0x04, struct.pack("<BHBf", 1, 202, 0, 0.25)), (0x16, b"\1"), (0x16, b"\0")
    )
    assert endpoint(202) == struct.pack("<f", 0.25)
    send_to_odrive(bench, (0x16, b"\2"))
    assert endpoint(202) == struct.pack("<f", 0.0), "the saved values are erased"


def test_the_help_names_the_endpoints_and_the_eds_file(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["drive", "--help"])
    text = capsys.readouterr().out
    for key, number in odrive_bench.ENDPOINT_NUMBERS.items():
        assert f"{number}  {key.removeprefix('endpoint_')}" in text
    assert str(EDS_PATH) in text


@pytest.mark.parametrize(
    ("watchdog_behaviour", "polled_state", "idle_state"),
    [("commands", 0xD, 0x0), ("frames", 0x1, 0x0), ("always", 0xD, 0xD)],
)
def test_the_watchdog_of_a_damiao_motor_is_selectable(
    watchdog_behaviour: str, polled_state: int, idle_state: int
) -> None:
    """The vendor of Damiao motors describes the watchdog condition as "no CAN commands within the interval".

    The vendor does not state whether register requests count as commands. The vendor also does not
    state whether the watchdog of a disabled motor is active.
    """
    spec = drive_spec("mit", 2)
    for enabled, expected in ((True, polled_state), (False, idle_state)):
        bench = SimulatedDriveBench([replace(spec, options={"watchdog": watchdog_behaviour})])
        bench.receive(Frame(0x7FF, b"\2\0\x55\x09" + struct.pack("<I", 2000)))
        bench.receive(Frame(2, ENABLE_PAYLOAD if enabled else b"\xff" * 7 + b"\xfd"))
        for _ in range(30):
            bench.advance(bench.t_ns + 20 * NS_PER_MS)
            if enabled:
                read_register(bench, 2, 9)
        (reply,) = bench.receive(Frame(0x7FF, b"\2\0\xcc\0" + bytes(4)))
        assert reply.data[0] >> 4 == expected


def test_the_eds_file_and_a_drive_agree_on_the_rated_torque() -> None:
    assert ObjectDictionary(33)[0x6076, 0] == 1000
    bench = SimulatedDriveBench([drive_spec("cia402", 33)])
    reply = bench.receive(Frame(0x600 + 33, b"\x40\x76\x60\0" + bytes(4)))[-1]
    assert int.from_bytes(reply.data[4:], "little") == 1000


@pytest.mark.parametrize("drive_fault", ["", *sorted(DRIVE_FAULTS)])
@pytest.mark.parametrize("protocol", sorted(PROTOCOL_SPECS))
def test_no_frame_ends_a_drive(protocol: str, drive_fault: str) -> None:
    """Reproduce a defect.

    A simulated MIT motor with the fault ``deaf`` raised OverflowError at the first remote or
    extended frame.
    """
    bench = SimulatedDriveBench([drive_spec(protocol, 2)], fault=drive_fault)
    special_payloads = [b"\xff" * 7 + bytes((code,)) for code in (0xFB, 0xFC, 0xFD, 0xFE, 0xFF)]
    payloads = (
        [b"\xff" * size for size in range(9)]
        + [bytes(size) for size in range(9)]
        + special_payloads
    )
    identifiers = [0, 2, 0x41, 0x47, 0x4E, 0x80, 0x202, 0x602, 0x702, 0x77F, 0x7FF, 0x12345678]
    for number in identifiers:
        for flags in (0, REMOTE_FLAG, EXTENDED_FLAG, EXTENDED_FLAG | REMOTE_FLAG):
            for data in payloads:
                bench.receive(
                    Frame(number & (0x1FFFFFFF if flags & EXTENDED_FLAG else 0x7FF) | flags, data)
                )
        bench.advance(bench.t_ns + 2 * NS_PER_MS)
        bench.take_unsolicited_frames()


def drive_bench_in_mode(control_mode: int) -> SimulatedDriveBench:
    """Return a bench with one enabled Damiao motor in a control mode."""
    bench = SimulatedDriveBench([drive_spec("mit", 2)])
    bench.receive(Frame(0x7FF, b"\2\0\x55\x0a" + struct.pack("<I", control_mode)))
    assert read_register(bench, 2, 10) == struct.pack("<I", control_mode)
    bench.receive(Frame(2, ENABLE_PAYLOAD))
    return bench


def test_a_damiao_motor_holds_a_velocity() -> None:
    bench = drive_bench_in_mode(3)
    bench.receive(Frame(0x202, struct.pack("<f", -5.0)))
    bench.advance(1000 * NS_PER_MS)
    assert bench.motors[0].omega == pytest.approx(-5.0, rel=0.05)
    bench.receive(Frame(0x202, struct.pack("<ff", 100.0, 0.0)))
    bench.advance(3000 * NS_PER_MS)
    assert bench.motors[0].omega <= mit_bench.MOTOR_RATINGS["dm4310"].top_speed


def test_a_damiao_motor_moves_to_a_position_within_a_speed() -> None:
    bench = drive_bench_in_mode(2)
    bench.receive(Frame(0x102, struct.pack("<ff", 3.0, 2.0)))
    fastest = 0.0
    for _ in range(60):
        bench.advance(bench.t_ns + 50 * NS_PER_MS)
        fastest = max(fastest, bench.motors[0].omega)
    assert 1.7 < fastest <= 2.2, "without a ramp the integrator overshoots"
    assert bench.motors[0].theta == pytest.approx(3.0, abs=0.01)


def test_a_damiao_motor_moves_with_a_limited_torque() -> None:
    bench = drive_bench_in_mode(4)
    bench.receive(Frame(0x302, struct.pack("<fHH", 3.0, 1000, 500)))
    max_torque = 0.0
    for _ in range(200):
        bench.advance(bench.t_ns + 2 * NS_PER_MS)
        max_torque = max(max_torque, abs(bench.motors[0].torque))
    assert max_torque == pytest.approx(0.05 * 7.0, rel=0.02)


@pytest.mark.parametrize("control_mode", [1, 2, 3, 4])
def test_a_command_of_another_mode_is_answered_without_effect(control_mode: int) -> None:
    bench = drive_bench_in_mode(control_mode)
    commands = {
        1: Frame(2, (0x7FFF7FF << 36 | 0xFFF).to_bytes(8, "big")),
        2: Frame(0x102, struct.pack("<ff", 3.0, 2.0)),
        3: Frame(0x202, struct.pack("<f", 3.0)),
        4: Frame(0x302, struct.pack("<fHH", 3.0, 1000, 10_000)),
    }
    for other_mode, frame in commands.items():
        if other_mode != control_mode:
            (reply,) = bench.receive(frame)
            assert reply.data[0] >> 4 == 1
    bench.advance(100 * NS_PER_MS)
    assert bench.motors[0].theta == 0.0
    bench.receive(commands[control_mode])
    bench.advance(bench.t_ns + 100 * NS_PER_MS)
    assert bench.motors[0].theta > 0.0


def test_a_change_of_the_mode_ends_the_setpoint() -> None:
    bench = drive_bench_in_mode(3)
    bench.receive(Frame(0x202, struct.pack("<f", 5.0)))
    bench.receive(Frame(0x7FF, b"\2\0\x55\x0a" + struct.pack("<I", 1)))
    assert (bench.motors[0].servo.kd, bench.motors[0].servo.speed_gain) == (0.0, 0.0)


@pytest.mark.parametrize("protocol", ["mit", "odrive", "cia402", "moteus", "robstride"])
def test_faults_act_on_bench_drives(protocol: str) -> None:
    bench = SimulatedDriveBench([drive_spec(protocol, 2), drive_spec(protocol, 3)])
    requests = {
        "mit": Frame(0x7FF, b"\2\0\xcc\0" + bytes(4)),
        "odrive": Frame(2 << 5 | 0x09 | REMOTE_FLAG, b""),
        "cia402": Frame(0x602, b"\x40\0\x10\0" + bytes(4)),
        "moteus": Frame(EXTENDED_FLAG | 0x8002, b"\x11\0\x50\x50", FDF),
        "robstride": Frame(EXTENDED_FLAG | 0xFD02, bytes(8)),
    }
    bench.advance(10 * NS_PER_MS)
    assert bench.receive(requests[protocol])
    bench.faults.inject("drop node=2 for=20ms")
    assert not bench.receive(requests[protocol])
    bench.advance(40 * NS_PER_MS)
    assert bench.receive(requests[protocol])
    bench.faults.inject(f"duplicate node={protocol}2")
    assert len(bench.receive(requests[protocol])) == 2
    assert all(state["felt"] for state in bench.faults.fault_states())


def test_a_fault_of_a_bench_drive_reaches_its_power_stage() -> None:
    bench = SimulatedDriveBench([drive_spec("mit", 2, inertia=1.0)])
    bench.receive(Frame(2, ENABLE_PAYLOAD))
    bench.faults.inject("runaway node=2 size=0.1")
    bench.advance(20 * NS_PER_MS)
    assert bench.motors[0].torque == pytest.approx(1.0, rel=0.05)
    bench.faults.inject("error node=2")
    (reply,) = bench.receive(Frame(0x7FF, b"\2\0\xcc\0" + bytes(4)))
    assert reply.data[0] >> 4 == 0xC


def test_a_bench_has_no_tendons_to_break() -> None:
    bench = SimulatedDriveBench([drive_spec("mit", 2)])
    with pytest.raises(SimulatorError, match="expected one of none"):
        bench.faults.inject("snap tendon=index_tendon")


def test_frames_for_no_node_are_counted() -> None:
    bench = SimulatedDriveBench([drive_spec("cia402", 32), drive_spec("mit", 1)])
    assert bench.receive(Frame(0x123, b"")) == []
    assert bench.foreign_frame_count == 1
    bench.advance(5 * NS_PER_MS)
    assert [frame.can_id for frame in bench.take_unsolicited_frames()] == [0x720]


@pytest.mark.parametrize(
    ("drive_options", "expected_message"),
    [
        ("mit --ids 1,1 --bus local:x", "each number once"),
        ("mit --ids one --bus local:x", "expected numbers"),
        ("mit --ids 0 --bus local:x", f"expected 1 to {PROTOCOL_SPECS['mit'].numbers.stop - 1}"),
        ("odrive --ids 63 --bus local:x", "expected 0 to 62"),
        ("mit --ids 1 --firmware 0.5 --bus local:x", "--firmware: only for drive odrive"),
        ("mit --ids 1 --uncalibrated --bus local:x", "--uncalibrated: only for drive odrive"),
        ("odrive --ids 1 --watchdog always --bus local:x", "--watchdog: only for drive mit"),
        (
            "odrive --ids 1 --clear-answers never --bus local:x",
            "--clear-answers: only for drive mit",
        ),
        ("cia402 --ids 1 --fd --bus local:x", "only for drive mit"),
        ("mit --ids 1 --motor-type ak80-9 --fd --bus local:x", "Damiao"),
        ("odrive --ids 1 --motor-type dm4310 --bus local:x", "only for drive mit"),
        ("cubemars --ids 1 --motor-type dm4310 --bus local:x", "no such motor"),
        ("mit --ids 1 --motor-type dm1 --bus local:x", "dm4310"),
        ("mit --ids 1 --inertia nan --bus local:x", "more than 0"),
        (
            "moteus --ids 1 --broken eager --bus local:x",
            "--broken eager: not possible with drive moteus, a torque command also enables it",
        ),
        ("cubemars --ids 1 --broken readback --bus local:x", "no settings to read back"),
        ("robstride_mit --ids 1 --broken readback --bus local:x", "no settings to read back"),
        ("cubemars --ids 1 --broken watchdog --bus local:x", "it has no watchdog"),
        ("robstride_mit --ids 1 --broken watchdog --bus local:x", "it has no watchdog"),
        ("can --ids 1 --bus local:x", "invalid choice"),
        ("mit --ids 1 --bus nothing", "local:NAME"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(
    drive_options: str, expected_message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["drive", *drive_options.split()]) == 2
    text = capsys.readouterr().err
    assert expected_message in text
    assert text.count("\n") == 1


def sdo_reply(bench: SimulatedDriveBench, request_data: bytes) -> bytes:
    """Send an SDO request to the CiA 402 node 33, and return the data of the node's last reply."""
    return bench.receive(Frame(0x600 + 33, request_data))[-1].data


def test_a_cia402_drive_tells_its_name_in_segments() -> None:
    bench = SimulatedDriveBench([drive_spec("cia402", 33)])
    head = sdo_reply(bench, b"\x40\x08\x10\0" + bytes(4))
    text, toggle = b"", 0
    while len(text) < int.from_bytes(head[4:], "little"):
        segment = sdo_reply(bench, bytes((0x60 | toggle << 4,)) + bytes(7))
        assert segment[0] >> 4 & 1 == toggle
        text += segment[1 : 8 - (segment[0] >> 1 & 7)]
        toggle ^= 1
    assert text == b"firmware_sim CiA 402 drive"
    assert segment[0] & 1, "the last segment is marked"
    assert sdo_reply(bench, b"\x60" + bytes(7))[0] == 0x80


def test_a_cia402_drive_tells_its_counts_and_stores_its_settings() -> None:
    spec = drive_spec("cia402", 33)
    bench = SimulatedDriveBench([replace(spec, options={**spec.options, "counts_per_turn": 4096})])
    assert int.from_bytes(sdo_reply(bench, b"\x40\x8f\x60\1" + bytes(4))[4:], "little") == 4096
    sdo_reply(bench, b"\x2b\x72\x60\0" + struct.pack("<Hxx", 500))
    bench.receive(Frame(0, b"\x81\x21"))
    assert sdo_reply(bench, b"\x40\x72\x60\0" + bytes(4))[4:6] != struct.pack("<H", 500)
    sdo_reply(bench, b"\x2b\x72\x60\0" + struct.pack("<Hxx", 500))
    sdo_reply(bench, b"\x23\x10\x10\1save")
    bench.receive(Frame(0, b"\x81\x21"))
    assert sdo_reply(bench, b"\x40\x72\x60\0" + bytes(4))[4:6] == struct.pack("<H", 500)


@pytest.mark.parametrize("speed_limit_rpm", [100, 600])
def test_the_speed_limit_of_a_cia402_drive_acts(speed_limit_rpm: int) -> None:
    bench = SimulatedDriveBench([drive_spec("cia402", 33)])
    sdo_reply(bench, b"\x23\x80\x60\0" + struct.pack("<I", speed_limit_rpm))
    sdo_reply(bench, b"\x2f\x60\x60\0" + struct.pack("<Bxxx", 10))
    sdo_reply(bench, b"\x2b\x71\x60\0" + struct.pack("<hxx", 200))
    for word in (0x06, 0x07, 0x0F):
        sdo_reply(bench, b"\x2b\x40\x60\0" + struct.pack("<Hxx", word))
    bench.advance(5_000 * NS_PER_MS)
    top = speed_limit_rpm / 60.0 * math.tau
    assert 0.8 * top < bench.motors[0].omega <= top
