"""Kernels for the cyclic messages of an ODrive. The kernels accept a drive as an array row or as a Python object.

Source: fact sheet odrive_cansimple.
"""

import ctypes
import math
from typing import Any

from firmware_sim.compiled import kernel_helper

IDLE_STATE = 1
"""Axis state: idle. The motor has no torque."""
CLOSED_LOOP = 8
"""Axis state: closed-loop control."""
TORQUE_CONTROL = 1
"""Control mode: torque control."""
PASSTHROUGH_MODE = 1
"""Input mode: the drive follows the setpoint as received."""
TORQUE_RAMP = 6
"""Input mode: the torque follows the setpoint with a ramp."""
THERMAL_PERIOD_NS = 100_000_000
"""Period of the update of the drive's temperatures [ns]."""
TURN_RAD = 2.0 * math.pi
"""A full turn [rad]."""


class OdriveStruct(ctypes.Structure):
    """Memory layout of the state of a simulated axis, for compiled kernels.

    The class ``node.OdriveNode`` explains the fields.

    ``motor_number`` is the index of the drive's rotor in the array of rotors. ``bus`` is the index
    of the drive's bus in the list of the hand's buses.
    """

    _fields_ = [
        *(
            (name, ctypes.c_double)
            for name in ("offset", "direction", "gear", "torque_constant", "peak")
        ),
        *(
            (name, ctypes.c_double)
            for name in ("setpoint", "torque_min", "torque_max", "current_limit")
        ),
        *((name, ctypes.c_double) for name in ("velocity_limit", "velocity_gain")),
        *(
            (name, ctypes.c_int64)
            for name in (
                "state",
                "active_errors",
                "disarm_reason",
                "result",
                "control_mode",
                "input_mode",
            )
        ),
        *(
            (name, ctypes.c_int64)
            for name in (
                "legacy",
                "node_id",
                "motor_number",
                "bus",
                "watchdog_fed_ns",
                "wake_ns",
                "thermal_ns",
            )
        ),
        *((name, ctypes.c_int64) for name in ("timeout_ns", "heartbeat_due_ns", "encoder_due_ns")),
        *((name, ctypes.c_int64) for name in ("busy_until_ns", "motion_due_ns")),
        *((name, ctypes.c_int64) for name in ("heartbeat_period_ns", "encoder_period_ns")),
    ]


@kernel_helper
def set_torque(node: Any, servo: Any, torque: float, t_ns: int) -> None:
    """Set a torque setpoint [N m at the shaft].

    In torque control without a ramp, the drive follows the setpoint at once.

    The torque setpoint restarts the watchdog in every control mode.
    """
    node.watchdog_fed_ns = t_ns
    node.setpoint = torque
    # In every mode other than torque control without a ramp, the drive follows the setpoint at the
    # next update of the mode, see ``motion_modes``.
    if (
        node.state != CLOSED_LOOP
        or node.control_mode != TORQUE_CONTROL
        or node.input_mode != PASSTHROUGH_MODE
    ):
        return
    follow_torque(node, servo, torque)


@kernel_helper
def follow_torque(node: Any, servo: Any, torque: float) -> None:
    """Follow a torque setpoint [N m at the shaft] within the limits of the drive."""
    limit = node.current_limit * node.torque_constant
    servo.limit = limit if limit < node.peak else node.peak
    # The torque limits can be NaN. So the comparisons must be exactly those of Python's min(high,
    # max(low, torque)).
    torque = torque if torque > node.torque_min else node.torque_min
    torque = torque if torque < node.torque_max else node.torque_max
    servo.torque = node.direction * node.gear * torque
    trip_at_speed_limit(node, servo)


@kernel_helper
def trip_at_speed_limit(node: Any, servo: Any) -> None:
    """Set the speed limit of the servo, and the gain with which the limit acts.

    The speed limit and its gain act in every control mode of an ODrive.

    In torque control, the drive brakes if the speed is above the speed limit
    (``enable_torque_mode_vel_limit``, on by default). In velocity control, the drive limits the
    velocity setpoint. In torque control and in velocity control, the torque is at most the velocity
    gain times (speed limit - velocity). Source: ODrive firmware 0.5.6, ``controller.cpp``,
    limitVel.
    """
    servo.speed_limit = node.velocity_limit * TURN_RAD / node.gear
    servo.speed_gain = node.velocity_gain / TURN_RAD * node.gear * node.gear


@kernel_helper
def position_in_turns(node: Any, angle: float) -> float:
    """Convert the measured spool angle [rad] to the position that the drive reports [turn]."""
    return float((node.direction * node.gear * angle + node.offset) / TURN_RAD)


@kernel_helper
def velocity_in_turns_per_s(node: Any, velocity: float) -> float:
    """Convert the angular velocity of the spool [rad/s] to the velocity that the drive reports [turn/s]."""
    return float(node.direction * node.gear * velocity / TURN_RAD)


@kernel_helper
def watchdog_expired(node: Any, t_ns: int) -> bool:
    """Return True if the drive's watchdog fires now."""
    return bool(
        node.state == CLOSED_LOOP
        and node.timeout_ns > 0
        and t_ns >= node.watchdog_fed_ns + node.timeout_ns
    )


@kernel_helper
def schedule_wake(node: Any) -> None:
    """Set the time at which a drive must wake next.

    The drive wakes for the update of the temperatures, a cyclic message, the watchdog, the end of a
    calibration, or a motion.
    """
    wake_ns = min(node.thermal_ns + THERMAL_PERIOD_NS, node.heartbeat_due_ns, node.encoder_due_ns)
    if node.state == CLOSED_LOOP and node.timeout_ns > 0:
        wake_ns = min(wake_ns, node.watchdog_fed_ns + node.timeout_ns)
    if node.busy_until_ns > 0:
        wake_ns = min(wake_ns, node.busy_until_ns)
    if node.motion_due_ns > 0:
        wake_ns = min(wake_ns, node.motion_due_ns)
    node.wake_ns = wake_ns


@kernel_helper
def next_period_ns(due_ns: int, t_ns: int, period_ns: int) -> int:
    """Return the time at which a cyclic message that has just been sent is due again [ns].

    Args:
        due_ns: time when the sent message was due [ns].
        t_ns: present time [ns].
        period_ns: period of the message [ns].
    """
    return max(due_ns, t_ns - 1) + period_ns
