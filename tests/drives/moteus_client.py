"""Use the vendor's Python client for moteus controllers.

The client commands a simulated drive of ``python -m firmware_sim drive moteus`` on any bus.
"""

import asyncio
import math
from typing import Any

import moteus  # type: ignore[import-untyped,unused-ignore]
from moteus.pythoncan_device import PythonCanDevice  # type: ignore[import-untyped,unused-ignore]

MOTION_TURNS = 0.1
MAX_STEP_ATTEMPTS = 400
RETRY_INTERVAL_S = 0.005
CLIENT_TIMEOUT_S = 60.0
VALUE_RESOLUTIONS = (moteus.INT8, moteus.INT16, moteus.INT32, moteus.F32)


def use_moteus(interface: str, channel: str, node_id: int = 2) -> None:
    """Use moteus to query, configure and control a drive.

    Query registers in every number type, configure the drive, command torque and position, and stop
    the drive.
    """
    asyncio.run(asyncio.wait_for(_use_transport(interface, channel, node_id), CLIENT_TIMEOUT_S))


async def _use_transport(interface: str, channel: str, node_id: int) -> None:
    device = PythonCanDevice(interface=interface, channel=channel, fd=True)
    transport = moteus.Transport([device])
    try:
        await _use_controller(
            moteus.Controller(id=node_id, transport=transport), transport, node_id
        )
    finally:
        transport.close()


async def _step_until(make_step: Any, is_condition_met: Any, expected_event: str) -> Any:
    for _ in range(MAX_STEP_ATTEMPTS):
        result = await make_step()
        if is_condition_met(result.values):
            return result.values
        await asyncio.sleep(RETRY_INTERVAL_S)
    raise AssertionError(f"never: {expected_event}; {result.values}")


async def _use_controller(controller: Any, transport: Any, node_id: int) -> None:
    register, mode = moteus.Register, moteus.Mode
    for resolution in VALUE_RESOLUTIONS:
        query = moteus.QueryResolution()
        query.position = query.velocity = query.torque = query.temperature = resolution
        values = (await controller.query(query_override=query)).values
        assert values[register.MODE] == mode.STOPPED
        assert values[register.FAULT] == 0
        assert math.isclose(values[register.TEMPERATURE], 25.0, abs_tol=0.5)
        assert math.isclose(values[register.POSITION], 0.0, abs_tol=0.01)
    identity = {register.FIRMWARE_VERSION: moteus.INT32, register.MULTIPLEX_ID: moteus.INT32}
    for identity_register in identity:
        assert (await controller.custom_query({identity_register: moteus.INT32})).values[
            identity_register
        ] != 0
    stream = moteus.Stream(controller, use_flow_control=False)
    assert await stream.command(b"conf get servo.timeout_mode", allow_any_response=True) == b"12"
    for limit_name, value in (("position_min", "nan"), ("position_max", "nan")):
        await stream.command(f"conf set servopos.{limit_name} {value}".encode())
        shown_value = await stream.command(
            f"conf get servopos.{limit_name}".encode(), allow_any_response=True
        )
        assert shown_value == b"nan"
    await stream.command(b"conf set servo.timeout_mode 0")

    async def command_torque() -> Any:
        return await controller.set_position(
            position=math.nan, kp_scale=0.0, kd_scale=0.0, ilimit_scale=0.0, feedforward_torque=0.05,
            maximum_torque=0.1, watchdog_timeout=1.0, query=True,
        )  # fmt: skip

    moving_values = await _step_until(
        command_torque,
        lambda reply_values: reply_values[register.POSITION] > MOTION_TURNS,
        "turned by a torque",
    )
    assert moving_values[register.MODE] == mode.POSITION
    assert math.isclose(moving_values[register.TORQUE], 0.05, abs_tol=0.02)
    goal = moving_values[register.POSITION] - MOTION_TURNS

    async def hold() -> Any:
        return await controller.set_position(
            position=goal, velocity=0.0, maximum_torque=0.5, query=True
        )

    holding_values = await _step_until(
        hold, lambda reply_values: abs(reply_values[register.VELOCITY]) < 0.05, "stands"
    )
    for _ in range(MAX_STEP_ATTEMPTS):
        holding_values = (await hold()).values
        if (
            abs(holding_values[register.POSITION] - goal) < 0.02
            and abs(holding_values[register.VELOCITY]) < 0.05
        ):
            break
        await asyncio.sleep(RETRY_INTERVAL_S)
    assert abs(holding_values[register.POSITION] - goal) < 0.02, "held at a position"
    await controller.set_position(position=math.nan, watchdog_timeout=0.05, query=True)
    await asyncio.sleep(0.2)
    late_state = await _step_until(
        controller.query,
        lambda reply_values: reply_values[register.MODE] == mode.TIMEOUT,
        "the watchdog",
    )
    assert late_state[register.MODE] == mode.TIMEOUT
    assert (await hold()).values[register.MODE] == mode.TIMEOUT, "only the stop command leaves it"
    await controller.set_stop(query=True)
    await _step_until(
        controller.query,
        lambda reply_values: reply_values[register.MODE] == mode.STOPPED,
        "stopped",
    )
