"""Typical use of the motor clients of other projects.

The clients run on any bus on which ``python -m firmware_sim drive`` simulates drives.

Each function enables a drive, commands a torque, checks that the free shaft turns, and disables the
drive. The clients give up after waiting 0.4 s to 1 s for a reply. The functions of this module wait
up to 20 s for each expected event.
"""

import asyncio
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can
import canopen
from canopen.profiles.p402 import BaseNode402
from damiao_motor import DaMiaoController
from odrive_can.odrive import DriveError, ODriveCAN

from firmware_sim.nodes.cia402.object_dictionary import EDS_PATH

WAIT_TIMEOUT_S = 20.0
CYCLIC_TORQUE_MODE = "CYCLIC SYNCHRONOUS TORQUE"


def wait_for(is_condition_met: Callable[[], bool], expected_event: str) -> None:
    end = time.monotonic() + WAIT_TIMEOUT_S
    while not is_condition_met():
        assert time.monotonic() < end, f"never: {expected_event}"
        time.sleep(0.005)


def use_damiao_motor(interface: str, channel: str, node_id: int = 2) -> None:
    """Use damiao-motor to read and control a motor.

    Read registers, enable the motor, command a torque, hold a position, and disable the motor.
    """
    controller = DaMiaoController(channel=channel, bustype=interface)
    try:
        motor = controller.add_motor(
            motor_id=node_id, feedback_id=node_id + 0x10, motor_type="4310"
        )
        assert [motor.get_register(number) for number in (21, 22, 23)] == [12.5, 30.0, 10.0]
        assert motor.get_register(7) == node_id + 0x10
        motor.ensure_control_mode("MIT")
        motor.enable()
        wait_for(lambda: motor.state.get("status") == "ENABLED", "enabled")
        start = motor.get_states()["pos"]
        motor.send_cmd_mit(feedforward_torque=0.1)
        wait_for(lambda: _motor_states(motor)["pos"] > start + 0.5, "turned by a torque")
        goal = motor.get_states()["pos"] - 1.0
        motor.send_cmd_mit(target_position=goal, stiffness=20.0, damping=1.0)
        wait_for(lambda: abs(_motor_states(motor)["pos"] - goal) < 0.02, "held at a position")
        motor.disable()
        wait_for(lambda: motor.state.get("status") == "DISABLED", "disabled")
    finally:
        controller.shutdown()


def _motor_states(motor: object) -> dict[str, float]:
    motor.request_motor_feedback()  # type: ignore[attr-defined]
    time.sleep(0.005)
    return dict(motor.get_states())  # type: ignore[attr-defined]


def use_damiao_modes(interface: str, channel: str, node_id: int = 2) -> None:
    """Use damiao-motor to change the mode of an enabled motor.

    The modes of the motor are velocity, position-velocity and force-position.
    """
    controller = DaMiaoController(channel=channel, bustype=interface)
    try:
        motor = controller.add_motor(
            motor_id=node_id, feedback_id=node_id + 0x10, motor_type="4310"
        )
        motor.write_register(10, 3)
        motor.write_register(4, 20.0)
        motor.write_register(5, -20.0)
        motor.enable()
        wait_for(lambda: motor.state.get("status") == "ENABLED", "enabled")
        motor.send_cmd_vel(target_velocity=3.0)
        wait_for(lambda: abs(_motor_states(motor)["vel"] - 3.0) < 0.05, "at a velocity")
        motor.send_cmd_vel(target_velocity=0.0)
        wait_for(lambda: abs(_motor_states(motor)["vel"]) < 0.05, "at rest")
        motor.write_register(10, 2)
        goal = _motor_states(motor)["pos"] - 1.0
        motor.send_cmd_pos_vel(target_position=goal, velocity_limit=4.0)
        wait_for(lambda: abs(_motor_states(motor)["pos"] - goal) < 0.01, "at a position")
        motor.write_register(10, 4)
        motor.send_cmd_force_pos(
            target_position=goal + 1.0, velocity_limit=4.0, torque_limit_ratio=0.05
        )
        wait_for(
            lambda: abs(_motor_states(motor)["pos"] - goal - 1.0) < 0.01, "back with little torque"
        )
        motor.disable()
        wait_for(lambda: motor.state.get("status") == "DISABLED", "disabled")
        motor.write_register(10, 1)
    finally:
        controller.shutdown()


def use_odrive_can(bus: can.BusABC, node_id: int = 1) -> None:
    """Use odrive-can to control an ODrive in closed loop.

    Command a torque and a position, send an emergency stop to the drive, and clear the error that
    the stop causes.
    """
    asyncio.run(_use_odrive(bus, node_id))


async def _use_odrive(bus: can.BusABC, node_id: int) -> None:
    """Control an ODrive with the asynchronous functions of odrive-can.

    The function reads positions from the cyclic encoder message of the drive. The function does not
    request positions with remote frames, because odrive-can could wait forever for the reply.
    """
    drive = ODriveCAN(axis_id=node_id, can_bus=bus)
    positions = [0.0]
    drive.feedback_callback = lambda message, _: positions.append(message.data["Pos_Estimate"])
    await asyncio.wait_for(drive.start(), WAIT_TIMEOUT_S)
    drive.check_alive()
    drive.check_errors()
    await _set_control_mode(drive, "TORQUE_CONTROL", "CLOSED_LOOP_CONTROL")
    start = positions[-1]
    drive.set_input_torque(0.02)
    await _wait_for_async(lambda: positions[-1] > start + 0.5, "turned by a torque")
    await _set_control_mode(drive, "POSITION_CONTROL", "CLOSED_LOOP_CONTROL")
    drive.set_input_pos(start - 1.0)
    await _wait_for_async(lambda: abs(positions[-1] - start + 1.0) < 0.05, "held at a position")
    assert (await drive.get_bus_voltage_current())["Bus_Voltage"] == 24.0
    drive._send_message("Estop")
    await _wait_for_async(
        lambda: _reports_error(drive, "ESTOP_REQUESTED") and drive.axis_state == "IDLE", "stopped"
    )
    drive.clear_errors()
    await _wait_for_async(lambda: not _reports_error(drive, ""), "cleared")
    drive.stop()


def use_odrive_can_modes(bus: can.BusABC, node_id: int = 1) -> None:
    """Use odrive-can to command a velocity, and then a trapezoidal trajectory.

    In addition, the client odrive-can sends the speed and acceleration limits of the trajectory.
    """
    asyncio.run(_use_odrive_modes(bus, node_id))


async def _use_odrive_modes(bus: can.BusABC, node_id: int) -> None:
    drive = ODriveCAN(axis_id=node_id, can_bus=bus)
    positions_and_velocities = [(0.0, 0.0)]
    drive.feedback_callback = lambda message, _: positions_and_velocities.append(
        (message.data["Pos_Estimate"], message.data["Vel_Estimate"])
    )
    await asyncio.wait_for(drive.start(), WAIT_TIMEOUT_S)
    await _set_control_mode(drive, "VELOCITY_CONTROL", "CLOSED_LOOP_CONTROL")
    drive.set_input_vel(2.0)
    await _wait_for_async(
        lambda: abs(positions_and_velocities[-1][1] - 2.0) < 0.05, "two turns per second"
    )
    await _set_control_mode(drive, "POSITION_CONTROL", "CLOSED_LOOP_CONTROL", "TRAP_TRAJ")
    start = positions_and_velocities[-1][0]
    drive.set_traj_vel_limit(1.0)
    drive.set_traj_accel_limits(2.0, 2.0)
    first_index = len(positions_and_velocities)
    drive.set_input_pos(start + 2.0)
    await _wait_for_async(
        lambda: abs(positions_and_velocities[-1][0] - start - 2.0) < 0.01,
        "at the end of the trajectory",
    )
    assert 0.9 < max(velocity for _, velocity in positions_and_velocities[first_index:]) < 1.1
    await _set_control_mode(drive, "TORQUE_CONTROL", "IDLE")
    drive.stop()


async def _set_control_mode(
    drive: ODriveCAN, control_mode: str, final_state: str, input_mode: str = "PASSTHROUGH"
) -> None:
    """Set a drive to the axis state idle, set its control mode, and set the axis state ``final_state``.

    The function does not use the waiting functions of odrive-can, which give up after a second.
    """
    drive.set_axis_state_no_wait("IDLE")
    await _wait_for_async(lambda: drive.axis_state == "IDLE", "idle")
    drive.set_controller_mode(control_mode, input_mode)
    drive.set_axis_state_no_wait(final_state)
    await _wait_for_async(lambda: drive.axis_state == final_state, final_state)


async def _wait_for_async(is_condition_met: Callable[[], bool], expected_event: str) -> None:
    end = time.monotonic() + WAIT_TIMEOUT_S
    while not is_condition_met():
        assert time.monotonic() < end, f"never: {expected_event}"
        await asyncio.sleep(0.01)


def _reports_error(drive: ODriveCAN, error_word: str) -> bool:
    try:
        drive.check_errors()
    except DriveError as error:
        return error_word in str(error)
    return False


@contextmanager
def _canopen_network(interface: str, channel: str) -> Iterator[canopen.Network]:
    network = canopen.Network()
    network.connect(interface=interface, channel=channel)
    try:
        yield network
    finally:
        network.sync.stop()
        network.disconnect()


def use_canopen(interface: str, channel: str, node_id: int = 33) -> None:
    """Use canopen to control the torque of a drive.

    Enable the drive with BaseNode402 and the packaged EDS, command torques by PDO, and disable the
    drive.
    """
    with _canopen_network(interface, channel) as network:
        node = BaseNode402(node_id, str(EDS_PATH))
        network.add_node(node)
        node.nmt.state = "RESET COMMUNICATION"
        wait_for(
            lambda: node.nmt.state == "PRE-OPERATIONAL", "boot-up"
        )  # wait_for_bootup can miss a boot-up message that arrives early
        assert node.sdo[0x1018][1].raw == node.object_dictionary[0x1018][1].default
        node.setup_402_state_machine()
        node.tpdo[1].trans_type = 1
        node.tpdo[1].save()
        network.sync.start(0.01)
        node.nmt.state = "OPERATIONAL"
        node.op_mode = CYCLIC_TORQUE_MODE
        assert node.op_mode == CYCLIC_TORQUE_MODE
        node.state = "OPERATION ENABLED"
        assert node.state == "OPERATION ENABLED"
        _turn_by_pdo(node)
        node.state = "SWITCH ON DISABLED"
        assert node.state == "SWITCH ON DISABLED"


def use_canopen_modes(interface: str, channel: str, node_id: int = 33) -> None:
    """Use canopen to home a drive, and then to select two modes by name.

    The drive is a BaseNode402. The two modes of the drive are profile position and cyclic velocity.
    """
    with _canopen_network(interface, channel) as network:
        node = BaseNode402(node_id, str(EDS_PATH))
        network.add_node(node)
        node.nmt.state = "RESET COMMUNICATION"
        wait_for(lambda: node.nmt.state == "PRE-OPERATIONAL", "boot-up")
        node.setup_402_state_machine()
        node.tpdo[1].trans_type = 1
        node.tpdo[1].save()
        network.sync.start(0.01)
        node.nmt.state = "OPERATIONAL"
        node.sdo["Home offset"].raw = 1000
        assert node.homing(timeout=10)
        assert abs(node.sdo["Position actual value"].raw - 1000) < 10
        node.op_mode = "PROFILED POSITION"
        assert node.op_mode == "PROFILED POSITION"
        node.controlword = 0x0F  # after homing, bit 4 of the control word is still set
        node.state = "OPERATION ENABLED"
        node.sdo["Target position"].raw = 30_000
        wait_for(lambda: node.statusword & 1 << 12 == 0, "a status word of this mode")
        node.controlword = 0x1F
        wait_for(lambda: node.statusword & 1 << 12 != 0, "set-point acknowledged")
        node.controlword = 0x0F
        wait_for(lambda: node.statusword & 1 << 10 != 0, "target reached")
        assert abs(node.sdo["Position actual value"].raw - 30_000) < 200
        node.sdo["Target velocity"].raw = 0
        node.op_mode = "CYCLIC SYNCHRONOUS VELOCITY"
        node.sdo["Target velocity"].raw = -30
        wait_for(lambda: abs(node.sdo["Velocity actual value"].raw + 30) <= 1, "30 turns a minute")
        node.state = "SWITCH ON DISABLED"


def _turn_by_pdo(node: BaseNode402) -> None:
    position = node.tpdo[1]["Position actual value"]
    start, rated = position.raw, node.sdo["Motor rated torque"].raw * 1e-3
    target = node.rpdo[1]["Target torque"]
    target.raw = round(0.02 / rated * 1000)
    node.rpdo[1].transmit()
    wait_for(lambda: position.raw - start > 0x8000, "half a turn")
    assert node.tpdo[1]["Torque actual value"].raw == target.raw
    target.raw = 0
    node.rpdo[1].transmit()
    wait_for(lambda: node.tpdo[1]["Torque actual value"].raw == 0, "no torque")
    assert math.isfinite(node.sdo["Velocity actual value"].raw)
