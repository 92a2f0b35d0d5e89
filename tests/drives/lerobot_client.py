"""Use LeRobot's bus class for RobStride motors.

The client commands simulated motors of ``python -m firmware_sim drive robstride_mit`` on any bus.
"""

import time
from collections.abc import Callable

import pytest
from lerobot.motors import Motor, MotorNormMode
from lerobot.motors.robstride import RobstrideMotorsBus

REPLY_TIMEOUT_S = 0.5
"""Time that the LeRobot client waits for a reply of a motor [s].

The client's default of 1 ms is too short: the simulated motor is another process, and the machine
can be busy.
"""
WAIT_TIMEOUT_S = 20.0


def use_lerobot_robstride(
    interface: str, channel: str, monkeypatch: pytest.MonkeyPatch, node_ids: tuple[int, ...]
) -> None:
    """Use LeRobot to control a motor and to read all motors.

    Connect to the bus, enable a motor, turn the motor by a torque, hold a position, and disable the
    motor. After that, read all motors on the bus.
    """
    monkeypatch.setattr(
        RobstrideMotorsBus._recv_motor_response, "__defaults__", (None, REPLY_TIMEOUT_S)
    )
    monkeypatch.setattr(
        RobstrideMotorsBus._recv_status_via_clear_fault, "__defaults__", (None, REPLY_TIMEOUT_S)
    )
    motors = {f"m{node}": _lerobot_motor(node) for node in node_ids}
    bus = RobstrideMotorsBus(channel, motors, can_interface=interface, use_can_fd=False)
    bus.connect()
    try:
        bus.configure_motors()
        _turn_by_torque(bus, f"m{node_ids[0]}")
        goal = float(bus.read("Present_Position", f"m{node_ids[0]}")) - 20.0
        _wait_until(
            lambda: abs(_position_after_command(bus, f"m{node_ids[0]}", goal) - goal) < 2.0,
            "held at a position",
        )
        bus.disable_torque()
        assert set(bus.sync_read("Present_Position")) == set(motors)
        assert bus.read("Temperature_MOS", f"m{node_ids[-1]}") == pytest.approx(25.0, abs=5.0)
    finally:
        bus.disconnect()


def _lerobot_motor(node_id: int) -> Motor:
    motor = Motor(id=node_id, model="robstride", norm_mode=MotorNormMode.DEGREES)
    motor.motor_type_str = "O5"
    motor.recv_id = node_id
    return motor


def _turn_by_torque(bus: RobstrideMotorsBus, motor_name: str) -> None:
    start = float(bus.read("Present_Position", motor_name))

    def has_turned() -> bool:
        bus._mit_control(motor_name, 0.0, 0.0, 0.0, 0.0, 0.1)
        return float(bus.read("Present_Position", motor_name)) > start + 20.0

    _wait_until(has_turned, "turned by a torque")
    bus._mit_control(motor_name, 0.0, 1.0, 0.0, 0.0, 0.0)


def _position_after_command(
    bus: RobstrideMotorsBus, motor_name: str, goal_position: float
) -> float:
    bus._mit_control(motor_name, 10.0, 1.0, goal_position, 0.0, 0.0)
    return float(bus.read("Present_Position", motor_name))


def _wait_until(is_condition_met: Callable[[], bool], expected_event: str) -> None:
    end = time.monotonic() + WAIT_TIMEOUT_S
    while not is_condition_met():
        assert time.monotonic() < end, f"never: {expected_event}"
        time.sleep(0.005)
