"""Test the motor-chain class of the library i2rt with four simulated DM4310 motors on vcan0.

The program needs an environment with the package ``dreamscale-i2rt``, which installs i2rt.
"""

import time
from typing import Any

import numpy as np
from i2rt.motor_config_tool.dm_motor_registers import (  # type: ignore[import-not-found,unused-ignore]
    DMRegAddr,
    read_register,
    save_register_to_flash,
    write_register,
)
from i2rt.motor_config_tool.utils import (  # type: ignore[import-not-found,unused-ignore]
    RawCanInterface,
)
from i2rt.motor_drivers.dm_driver import (  # type: ignore[import-not-found,unused-ignore]
    ControlMode,
    DMChainCanInterface,
    DMSingleMotorCanInterface,
)
from i2rt.motor_drivers.motor_check import (  # type: ignore[import-not-found,unused-ignore]
    run_startup_checks,
)

from tests.vcan.clients.check_list import CheckList

CHANNEL = "vcan0"
MOTOR_IDS = (1, 2, 3, 4)
MOTORS = [(number, "DM4310") for number in MOTOR_IDS]
MOTOR_COUNT = len(MOTORS)
TORQUE_N_M = 0.1
TRAVEL_RAD = 1.0
WATCHDOG_UNITS = 8000
"""Watchdog time that i2rt's tool set_timeout writes, in units of 50 us."""


def check_registers(checks: CheckList) -> None:
    """Let i2rt compare the registers of the motors with the motor types that the program declares."""

    def verify_motors(
        motors: list[tuple[int, str]], mode: str, repairs_settings: bool = False
    ) -> str:
        run_startup_checks(
            CHANNEL,
            motors,
            check_motor_types=True,
            check_motor_config=True,
            control_mode=mode,
            repair=repairs_settings,
        )
        return "verified"

    checks.check("types, control mode and ranges are verified", bool(verify_motors(MOTORS, "MIT")))
    wrong_motors = [(1, "DM4340"), *MOTORS[1:]]
    checks.check_raises(
        "a wrong type is refused", lambda: verify_motors(wrong_motors, "MIT"), "motor 1 reported"
    )
    checks.check_raises(
        "a wrong control mode is reported", lambda: verify_motors(MOTORS, "VEL"), "CTRL_MODE"
    )
    checks.check(
        "a wrong control mode is repaired",
        bool(verify_motors(MOTORS, "VEL", repairs_settings=True)),
    )
    bus = RawCanInterface(channel=CHANNEL, bustype="socketcan")
    try:
        modes = [read_register(bus, number, DMRegAddr.CTRL_MODE) for number in MOTOR_IDS]
    finally:
        bus.close()
    checks.check("the repaired control mode is read back", modes == [3] * MOTOR_COUNT, modes)


def open_motor_chain(control_mode: str) -> Any:
    return DMChainCanInterface(
        MOTORS, [0] * MOTOR_COUNT, [1] * MOTOR_COUNT, channel=CHANNEL, control_mode=control_mode
    )


def close_motor_chain(chain: Any) -> None:
    """Stop the thread of a motor chain, disable the motors of the chain, and close its socket."""
    chain.running = False
    time.sleep(0.3)  # the thread of the chain ends after its present cycle
    for number in MOTOR_IDS:
        chain.motor_interface.motor_off(number)
    chain.close()


def check_velocity_mode(checks: CheckList) -> None:
    """Let a motor chain in velocity mode turn all motors. The product Flow Base of i2rt uses velocity mode."""
    chain = open_motor_chain(ControlMode.VEL)

    def command_and_read_speeds() -> list[float]:
        states = chain.set_commands(np.zeros(MOTOR_COUNT), vel=np.full(MOTOR_COUNT, 3.0))
        return [state.vel for state in states]

    checks.check_eventually(
        "four motors turn at 3 rad/s in velocity mode",
        command_and_read_speeds,
        lambda measured_speeds: all(abs(speed - 3.0) < 0.1 for speed in measured_speeds),
    )
    chain.set_commands(np.zeros(MOTOR_COUNT))
    time.sleep(0.5)
    close_motor_chain(chain)


def check_mit_mode(checks: CheckList) -> None:
    """Send torques, and after them positions, to a chain of motors in MIT mode.

    The arm YAM of i2rt uses its motors in MIT mode.
    """
    chain = open_motor_chain(ControlMode.MIT)
    start = np.array([state.pos for state in chain.read_states()])

    def command_torque_and_read_travel() -> Any:
        states = chain.set_commands(np.full(MOTOR_COUNT, TORQUE_N_M))
        return np.array([state.pos for state in states]) - start

    checks.check_eventually(
        "four motors turn by a torque",
        command_torque_and_read_travel,
        lambda travels: bool(np.all(travels > TRAVEL_RAD)),
    )
    torques = [state.eff for state in chain.read_states()]
    checks.check(
        "they report this torque", bool(np.allclose(torques, TORQUE_N_M, atol=0.01)), torques
    )
    goal = np.array([state.pos for state in chain.read_states()]) - TRAVEL_RAD

    def errors() -> Any:
        states = chain.set_commands(
            np.zeros(MOTOR_COUNT),
            pos=goal,
            kp=np.full(MOTOR_COUNT, 20.0),
            kd=np.full(MOTOR_COUNT, 1.0),
        )
        return np.array([state.pos for state in states]) - goal

    checks.check_eventually(
        "they hold positions",
        errors,
        lambda angle_errors: bool(np.all(np.abs(angle_errors) < 0.02)),
    )
    checks.check("the control loop has met no error", bool(chain.running))
    close_motor_chain(chain)


def check_watchdog(checks: CheckList) -> None:
    """Set the watchdog time of a motor, and wait until the watchdog fires.

    Let i2rt enable the motor again. Before the motor can be enabled, i2rt must clear the error of
    the motor.
    """
    motor = MOTOR_IDS[0]
    bus = RawCanInterface(channel=CHANNEL, bustype="socketcan")
    try:
        write_register(bus, motor, DMRegAddr.TIMEOUT, WATCHDOG_UNITS)
        save_register_to_flash(bus, motor, DMRegAddr.TIMEOUT)
        stored_watchdog_units = read_register(bus, motor, DMRegAddr.TIMEOUT)
    finally:
        bus.close()
    checks.check(
        "the watchdog time is stored",
        stored_watchdog_units == WATCHDOG_UNITS,
        stored_watchdog_units,
    )
    client = DMSingleMotorCanInterface(channel=CHANNEL, bustype="socketcan")

    def command() -> Any:
        return client.set_control(motor, "DM4310", 0.0, 0.0, 0.0, 0.0, 0.0)

    try:
        checks.check_raises("a disabled motor says so", command, "disabled")
        client.motor_on(motor, "DM4310")
        checks.check("an enabled motor says so", command().error_code == "0x1")
        time.sleep(1.0)  # the test waits longer than the watchdog time of 0.4 s
        checks.check_raises("the watchdog fires", command, "loss communication")
        motor_feedback = client.motor_on(motor, "DM4310")
        checks.check("a motor in error is cleared and enabled", motor_feedback.error_code == "0x1")
    finally:
        client.close()
    # The client sends the command that clears an error three times, and reads only one of the three
    # replies. The client would treat the other two replies as replies to later commands, so the test
    # gives the client a new socket. Even on the new socket, a late reply can arrive, so the test
    # reads the motor state until the state is the expected one.
    client = DMSingleMotorCanInterface(channel=CHANNEL, bustype="socketcan")

    def state() -> str:
        try:
            return str(command().error_message)
        except RuntimeError as error:
            return str(error)

    try:
        client.motor_off(motor)
        checks.check_eventually(
            "the motor is disabled at the end", state, lambda text: "disabled" in text
        )
    finally:
        client.close()


def main() -> None:
    checks = CheckList()
    check_registers(checks)
    check_velocity_mode(checks)
    run_startup_checks(
        CHANNEL, MOTORS, check_motor_types=True, check_motor_config=True, control_mode="MIT"
    )
    check_mit_mode(checks)
    check_watchdog(checks)
    checks.end()


if __name__ == "__main__":
    main()
