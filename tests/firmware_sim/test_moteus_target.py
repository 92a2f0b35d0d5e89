"""Test the position mode of a simulated moteus: moving target, gains, torque limit, and reports of active limits."""

import math
import struct
from dataclasses import replace

import pytest

from firmware_sim.bus.frame import BRS, EXTENDED_FLAG, FDF, Frame
from firmware_sim.nodes.moteus.node import MoteusNode
from firmware_sim.plant.drivetrain import ENCODER_STEP_RAD
from firmware_sim.programs.drive import SimulatedDriveBench
from firmware_sim.programs.drive_types import drive_spec

NS_PER_MS = 1_000_000
NODE_ID = 2
KP, KD = 4.0, 0.05
"""Factory values of the gains kp [N m/turn] and kd [N m s/turn] of a moteus drive."""
TURN_RAD = 2.0 * math.pi


class SingleDriveBench:
    """A simulated moteus drive with a large inertia at the shaft.

    Because the shaft has a large inertia, the motor torque hardly moves the shaft.
    """

    def __init__(self, inertia: float = 1.0, direction: int = 1) -> None:
        """Create a simulated moteus drive in position mode that makes no torque."""
        self.bench = SimulatedDriveBench(
            [replace(drive_spec("moteus", NODE_ID, inertia=inertia), direction=direction)]
        )
        (node,) = self.bench.nodes
        assert isinstance(node, MoteusNode)
        self.node, self.motor = node, self.bench.motors[0]
        for limit_name in ("position_min", "position_max"):
            node.channel.items[f"servopos.{limit_name}"] = math.nan
        self.send_command(math.nan, kp=0.0, kd=0.0)
        self.bench.advance(20 * NS_PER_MS)
        self.send_command(math.nan, kp=0.0, kd=0.0)

    def reply_to(self, data: bytes) -> bytes:
        """Send a request frame to the simulated drive, and return the data of its reply."""
        (reply,) = self.bench.receive(Frame(EXTENDED_FLAG | 0x8000 | NODE_ID, data, FDF | BRS))
        return reply.data

    def send_command(
        self, position: float, velocity: float = 0.0, torque: float = 0.0, kp: float = 1.0, kd: float = 1.0,
        limit: float = 0.5,
    ) -> None:  # fmt: skip
        """Send a command with position [turn], velocity [turn/s] and feedforward torque [N m] to the drive.

        ``kp`` and ``kd`` are fractions of the factory gains. The watchdog time in the command is
        0.2 s.
        """
        self.reply_to(
            b"\1\0\x0a\x0f\x20" + struct.pack("<fff", position, velocity, torque)
            + b"\x0f\x23" + struct.pack("<fff", kp, kd, limit) + b"\1\x2b\0\x0d\x27" + struct.pack("<f", 0.2)
        )  # fmt: skip

    def read_register(self, number: int) -> float:
        """Read a register of the drive as a floating-point number."""
        reply = self.reply_to(bytes((0x1D, number)))
        assert reply[:2] == bytes((0x2D, number))
        value: float = struct.unpack_from("<f", reply, 2)[0]
        return value

    def advance_time(self, milliseconds: int) -> None:
        """Advance the simulated time by ``milliseconds``."""
        self.bench.advance(self.bench.t_ns + milliseconds * NS_PER_MS)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize(("position", "velocity"), [(0.2, 0.7), (-0.1, -2.0), (0.0, 0.0)])
def test_the_target_moves_with_the_velocity_until_the_next_command(
    position: float, velocity: float, direction: int
) -> None:
    drive = SingleDriveBench(direction=direction)
    drive.send_command(position, velocity)
    drive.advance_time(30)
    assert drive.read_register(0x038) == pytest.approx(position + 0.030 * velocity, abs=1e-6)
    assert drive.read_register(0x039) == pytest.approx(velocity, abs=1e-6)
    drive.send_command(position, velocity)
    assert drive.read_register(0x038) == pytest.approx(position, abs=1e-6)
    drive.advance_time(10)
    drive.send_command(math.nan, -velocity)
    drive.advance_time(10)
    assert drive.read_register(0x038) == pytest.approx(position, abs=1e-6), (
        "without a position, the target goes on"
    )


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize(("kp", "kd"), [(1.0, 1.0), (0.25, 0.5), (0.0, 0.5), (0.5, 0.0)])
def test_the_torque_is_that_of_the_scaled_gains(kp: float, kd: float, direction: int) -> None:
    drive = SingleDriveBench(direction=direction)
    drive.send_command(0.05, 0.4, 0.02, kp, kd)
    drive.advance_time(5)
    target = 0.05 + 0.005 * 0.4
    exact_value = (
        KP * kp * (target - drive.read_register(1))
        + KD * kd * (0.4 - drive.read_register(2))
        + 0.02
    )
    assert drive.read_register(3) == pytest.approx(
        exact_value, abs=KP * ENCODER_STEP_RAD / TURN_RAD + 1e-4
    )
    assert direction * drive.motor.torque == pytest.approx(
        exact_value, abs=KP * ENCODER_STEP_RAD / TURN_RAD + 1e-4
    )


def test_a_limit_in_effect_is_reported_and_bounds_the_sum() -> None:
    drive = SingleDriveBench()
    drive.send_command(1.0, 0.0, 0.05, limit=0.3)
    drive.advance_time(5)
    assert drive.read_register(0x00F) == 102
    assert drive.read_register(3) == pytest.approx(0.3, abs=1e-3)
    drive.send_command(0.01, 0.0, 0.05, limit=0.3)
    drive.advance_time(5)
    assert drive.read_register(0x00F) == 0


def test_a_stopped_drive_forgets_its_target() -> None:
    drive = SingleDriveBench()
    drive.send_command(0.4, 1.0)
    drive.advance_time(50)
    drive.reply_to(b"\1\0\0")
    drive.advance_time(50)
    assert drive.motor.servo.kp == drive.motor.servo.target_speed == 0.0
    drive.send_command(math.nan)
    drive.advance_time(20)
    drive.send_command(math.nan)
    assert drive.read_register(0x038) == pytest.approx(drive.read_register(1), abs=1e-3), (
        "the present position"
    )


def test_the_watchdog_stops_a_moving_target() -> None:
    drive = SingleDriveBench()
    drive.node.channel.items["servo.timeout_mode"] = 0.0
    drive.send_command(0.1, 5.0)
    drive.advance_time(190)
    assert drive.read_register(0) == 10
    drive.advance_time(20)
    assert drive.read_register(0) == 11
    assert (drive.motor.servo.kp, drive.motor.servo.target_speed, drive.motor.servo.torque) == (
        0.0,
        0.0,
        0.0,
    )
