"""What an ODrive does with the messages of every tick: laws of a row or an object. Source: facts, odrive_cansimple."""

import ctypes
import math
from typing import Any

from firmware_sim.compiled import inner

IDLE, CLOSED_LOOP = 1, 8
TORQUE_CONTROL = 1
PASSTHROUGH, TORQUE_RAMP = 1, 6
WARM_PERIOD_NS = 100_000_000
TURN = 2.0 * math.pi


class OdriveRow(ctypes.Structure):
    """See ``node.OdriveNode``; ``motor_number``: of its rotor; ``bus``: its index in the hand."""

    _fields_ = [
        *((name, ctypes.c_double) for name in ("offset", "direction", "gear", "torque_constant", "peak")),
        *((name, ctypes.c_double) for name in ("setpoint", "torque_min", "torque_max", "current_limit")),
        *((name, ctypes.c_int64) for name in ("state", "active", "reason", "result", "control_mode", "input_mode")),
        *(
            (name, ctypes.c_int64)
            for name in ("old", "node_id", "motor_number", "bus", "fed_ns", "wake_ns", "warmed_ns")
        ),
        *((name, ctypes.c_int64) for name in ("timeout_ns", "heartbeat_due_ns", "encoder_due_ns")),
        *((name, ctypes.c_int64) for name in ("heartbeat_period_ns", "encoder_period_ns")),
    ]


@inner
def make_torque(node: Any, servo: Any, torque: float, t_ns: int) -> None:
    """Take a setpoint [N m at the shaft], a finite one, and follow it in torque control."""
    node.fed_ns, node.setpoint = t_ns, torque
    follows = node.input_mode == PASSTHROUGH or node.input_mode == TORQUE_RAMP
    if node.state != CLOSED_LOOP or node.control_mode != TORQUE_CONTROL or not follows:
        return
    limit = node.current_limit * node.torque_constant
    servo.limit = limit if limit < node.peak else node.peak
    # comparisons in the order of Python's min(high, max(low, torque)): limits may be NaN
    torque = torque if torque > node.torque_min else node.torque_min
    torque = torque if torque < node.torque_max else node.torque_max
    servo.torque = node.direction * node.gear * torque


@inner
def turns(node: Any, angle: float) -> float:
    """Return the position [turn] at an angle of the spool by the encoder [rad]."""
    return float((node.direction * node.gear * angle + node.offset) / TURN)


@inner
def turns_per_s(node: Any, velocity: float) -> float:
    """Return the velocity [turn/s] at a velocity of the spool [rad/s]."""
    return float(node.direction * node.gear * velocity / TURN)


@inner
def starves(node: Any, t_ns: int) -> bool:
    """Return whether the watchdog fires."""
    return bool(node.state == CLOSED_LOOP and node.timeout_ns > 0 and t_ns >= node.fed_ns + node.timeout_ns)


@inner
def schedule(node: Any) -> None:
    """Note when time must pass for a drive next: temperatures, cyclic messages, watchdog."""
    wake_ns = min(node.warmed_ns + WARM_PERIOD_NS, node.heartbeat_due_ns, node.encoder_due_ns)
    if node.state == CLOSED_LOOP and node.timeout_ns > 0:
        wake_ns = min(wake_ns, node.fed_ns + node.timeout_ns)
    node.wake_ns = wake_ns


@inner
def next_due(due_ns: int, t_ns: int, period_ns: int) -> int:
    """Return when a cyclic message is due after it was sent now."""
    return max(due_ns, t_ns - 1) + period_ns
