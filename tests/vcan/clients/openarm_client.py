"""Test openarm_can, the C++ library of the arm OpenArm.

The test uses three simulated DM4310 motors on vcan0. The program needs an environment with the
package ``openarm_can``. The simulated motors reply with CAN FD frames, as the motors of an OpenArm
do.
"""

from typing import Any

import openarm_can  # type: ignore[import-not-found,unused-ignore]

from tests.vcan.clients.check_list import CheckList

CHANNEL = "vcan0"
SEND_IDS = [1, 2, 3]
REPLY_IDS = [0x11, 0x12, 0x13]
MOTOR_COUNT = len(SEND_IDS)
TORQUE_N_M = 0.1
TRAVEL_RAD = 1.0
REPLY_TIMEOUT_US = 20_000
"""Time that the client waits for the first reply of a motor [us].

The client's default of 500 us is too short for a simulated motor in another process.
"""


def request_feedback(arm: Any) -> list[Any]:
    """Request the feedback of all motors of the arm, and return the motors."""
    arm.refresh_all()
    arm.recv_all(REPLY_TIMEOUT_US)
    return list(arm.get_arm().get_motors())


def connect_arm(control_mode: Any) -> Any:
    """Open the bus, write the control mode of the motors, and enable the motors."""
    arm = openarm_can.OpenArm(CHANNEL, True)
    types = [openarm_can.MotorType.DM4310] * MOTOR_COUNT
    arm.init_arm_motors(types, SEND_IDS, REPLY_IDS, [control_mode] * MOTOR_COUNT)
    arm.recv_all(REPLY_TIMEOUT_US)
    arm.set_callback_mode_all(openarm_can.CallbackMode.STATE)
    arm.enable_all()
    arm.recv_all(REPLY_TIMEOUT_US)
    return arm


def disable_arm(arm: Any, checks: CheckList, mode_name: str) -> None:
    arm.disable_all()
    arm.recv_all(REPLY_TIMEOUT_US)
    checks.check_eventually(
        f"three motors are disabled ({mode_name})",
        lambda: [motor.is_enabled() for motor in request_feedback(arm)],
        [False] * MOTOR_COUNT,
    )


def check_registers(checks: CheckList) -> None:
    """Read the position, velocity and torque ranges of the motors, and compare them with the table of openarm_can."""
    arm = openarm_can.OpenArm(CHANNEL, True)
    arm.init_arm_motors([openarm_can.MotorType.DM4310] * MOTOR_COUNT, SEND_IDS, REPLY_IDS)
    arm.set_callback_mode_all(openarm_can.CallbackMode.PARAM)
    limits = openarm_can.Motor.get_limit_param(openarm_can.MotorType.DM4310)
    registers = openarm_can.MotorVariable
    expected = {
        registers.PMAX: limits.pMax,
        registers.VMAX: limits.vMax,
        registers.TMAX: limits.tMax,
        registers.Gr: 10.0,
    }
    for register, value in expected.items():
        arm.query_param_all(register.value)
        arm.recv_all(REPLY_TIMEOUT_US)
        parameters = [motor.get_param(register.value) for motor in arm.get_arm().get_motors()]
        checks.check(f"register {register.name}", parameters == [value] * MOTOR_COUNT, parameters)


def check_mit_mode(checks: CheckList) -> None:
    """Turn the motors of the arm by a torque, and after that let them hold positions."""
    arm = connect_arm(openarm_can.ControlMode.MIT)
    checks.check_eventually(
        "three motors are enabled",
        lambda: [motor.is_enabled() for motor in request_feedback(arm)],
        [True] * MOTOR_COUNT,
    )
    start = [motor.get_position() for motor in request_feedback(arm)]

    def command(kp: float, kd: float, goals: list[float], torque: float) -> list[float]:
        rows = [openarm_can.MITParam(kp, kd, goal, 0.0, torque) for goal in goals]
        arm.get_arm().mit_control_all(rows)
        arm.recv_all(REPLY_TIMEOUT_US)
        return [motor.get_position() for motor in arm.get_arm().get_motors()]

    def command_and_measure_torques() -> list[float]:
        command(0.0, 0.0, start, TORQUE_N_M)
        return [motor.get_torque() for motor in arm.get_arm().get_motors()]

    checks.check_eventually(
        "three motors report the commanded torque",
        command_and_measure_torques,
        lambda measured_torques: all(
            abs(torque - TORQUE_N_M) < 0.01 for torque in measured_torques
        ),
    )
    checks.check_eventually(
        "they turn by it",
        lambda: command(0.0, 0.0, start, TORQUE_N_M),
        lambda positions: all(a - b > TRAVEL_RAD for a, b in zip(positions, start, strict=True)),
    )
    goals = [motor.get_position() - TRAVEL_RAD for motor in request_feedback(arm)]
    checks.check_eventually(
        "they hold positions",
        lambda: command(20.0, 1.0, goals, 0.0),
        lambda positions: all(abs(a - b) < 0.02 for a, b in zip(positions, goals, strict=True)),
    )
    checks.check("no reply has another identifier", not arm.get_unmatched_frames())
    disable_arm(arm, checks, "MIT")


def check_velocity_mode(checks: CheckList) -> None:
    """Command a velocity to the motors in velocity mode."""
    arm = connect_arm(openarm_can.ControlMode.VEL)

    def command_and_read_speeds() -> list[float]:
        arm.get_arm().vel_control_all([openarm_can.VelParam(2.0)] * MOTOR_COUNT)
        arm.recv_all(REPLY_TIMEOUT_US)
        return [motor.get_velocity() for motor in arm.get_arm().get_motors()]

    checks.check_eventually(
        "three motors turn at 2 rad/s",
        command_and_read_speeds,
        lambda measured_speeds: all(abs(speed - 2.0) < 0.1 for speed in measured_speeds),
    )
    disable_arm(arm, checks, "velocity")


def main() -> None:
    checks = CheckList()
    check_registers(checks)
    check_mit_mode(checks)
    check_velocity_mode(checks)
    checks.end()


if __name__ == "__main__":
    main()
