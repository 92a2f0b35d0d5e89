"""Test can-motor-control, a client in Rust for arms of Damiao motors.

The test uses three simulated DM4340 motors on vcan0.

The program needs an environment with the package ``can-motor-control``. The simulated motors use
CAN FD. Version 0.0.8 of the client decodes the feedback of each motor type with the ranges of a
DM4340. With version 0.0.8, torque and velocity of other motor types are wrong by a constant factor.
"""

from collections.abc import Callable
from typing import Any

import can_motor_control as client  # type: ignore[import-not-found,unused-ignore]
import numpy as np
from can_motor_control import damiao  # type: ignore[import-not-found,unused-ignore]

from tests.vcan.clients.check_list import CheckList

CHANNEL = "vcan0"
MOTOR_NAMES = ("m1", "m2", "m3")
MOTOR_COUNT = len(MOTOR_NAMES)
TORQUE_N_M = 0.5
TRAVEL_RAD = 1.0
REPLY_TIMEOUT_US = 20_000
"""Time that the client waits for replies in a tick [us]."""


def make_robot() -> Any:
    motors = [
        client.MotorSpec(name, damiao.MotorType.DM4340, number + 1, number + 0x11)
        for number, name in enumerate(MOTOR_NAMES)
    ]
    builder = client.Robot.builder()
    builder = builder.add_bus("bus", client.SocketCanBus(CHANNEL, fd=True), damiao.DamiaoCodec())
    return builder.add_arm("arm", bus="bus", motors=motors).build()


def command_rows(*columns: Any) -> Any:
    """Return an array of commands with one row per motor.

    The caller gives each column as one number for all motors, or as one number for each motor.
    """
    return np.column_stack([np.broadcast_to(column, MOTOR_COUNT) for column in columns]).astype(
        float
    )


def check_control_mode(
    checks: CheckList,
    robot: Any,
    control_mode: str,
    check_motion: Callable[[CheckList, Any, Callable[[str], Any]], None],
) -> None:
    """Enable the motors in a control mode, check their motion, and disable them."""
    arm = robot["arm"]

    def read(quantity: str) -> Any:
        robot.tick(REPLY_TIMEOUT_US)
        return getattr(arm, quantity)()

    def read_state_matches(is_enabled_expected: bool) -> list[bool]:
        robot.refresh()
        robot.tick(REPLY_TIMEOUT_US)
        return [arm[name].is_enabled is is_enabled_expected for name in MOTOR_NAMES]

    robot.set_mode(control_mode)
    robot.enable()
    checks.check_eventually(
        f"three motors are enabled ({control_mode})", lambda: read_state_matches(True), all
    )
    check_motion(checks, arm, read)
    robot.disable()
    checks.check_eventually(
        f"three motors are disabled ({control_mode})", lambda: read_state_matches(False), all
    )


def use_mit_mode(checks: CheckList, arm: Any, read_feedback: Callable[[str], Any]) -> None:
    """Turn the motors of the arm by a torque, and after that let them hold positions."""
    start = np.array(read_feedback("positions"))

    def command_torque_and_read(quantity: str) -> Any:
        arm.mit_control(command_rows(0.0, 0.0, 0.0, 0.0, TORQUE_N_M))
        return read_feedback(quantity)

    # At the speed without load, the motor can no longer make the commanded torque.
    checks.check_eventually(
        "three motors report the commanded torque",
        lambda: command_torque_and_read("torques"),
        lambda torques: bool(np.allclose(torques, TORQUE_N_M, atol=0.01)),
    )
    checks.check_eventually(
        "they turn by it",
        lambda: command_torque_and_read("positions") - start,
        lambda travels: bool(np.all(travels > TRAVEL_RAD)),
    )
    goals = np.array(arm.positions()) - TRAVEL_RAD

    def command_and_read_errors() -> Any:
        arm.mit_control(command_rows(20.0, 1.0, goals, 0.0, 0.0))
        return read_feedback("positions") - goals

    checks.check_eventually(
        "they hold positions",
        command_and_read_errors,
        lambda angle_errors: bool(np.all(np.abs(angle_errors) < 0.02)),
    )


def use_velocity_mode(checks: CheckList, arm: Any, read_feedback: Callable[[str], Any]) -> None:
    def command_and_read_speeds() -> Any:
        arm.vel_control(np.full(MOTOR_COUNT, 2.0))
        return read_feedback("velocities")

    checks.check_eventually(
        "three motors turn at 2 rad/s",
        command_and_read_speeds,
        lambda measured_speeds: bool(np.all(np.abs(measured_speeds - 2.0) < 0.1)),
    )


def use_position_mode(checks: CheckList, arm: Any, read_feedback: Callable[[str], Any]) -> None:
    goals = np.array(read_feedback("positions")) + TRAVEL_RAD

    def command_and_read_errors() -> Any:
        arm.pos_vel_control(command_rows(goals, 4.0))
        return read_feedback("positions") - goals

    checks.check_eventually(
        "three motors reach positions",
        command_and_read_errors,
        lambda angle_errors: bool(np.all(np.abs(angle_errors) < 0.02)),
    )


def use_force_mode(checks: CheckList, arm: Any, read_feedback: Callable[[str], Any]) -> None:
    goals = np.array(read_feedback("positions")) - TRAVEL_RAD

    def command_and_read_errors() -> Any:
        arm.pos_force_control(command_rows(goals, 4.0, 0.05))
        return read_feedback("positions") - goals

    checks.check_eventually(
        "three motors reach positions with little torque",
        command_and_read_errors,
        lambda angle_errors: bool(np.all(np.abs(angle_errors) < 0.02)),
    )


def main() -> None:
    checks = CheckList()
    robot = make_robot()
    robot.connect()
    check_control_mode(checks, robot, "mit", use_mit_mode)
    check_control_mode(checks, robot, "vel", use_velocity_mode)
    check_control_mode(checks, robot, "pos_vel", use_position_mode)
    check_control_mode(checks, robot, "pos_force", use_force_mode)
    checks.end()


if __name__ == "__main__":
    main()
