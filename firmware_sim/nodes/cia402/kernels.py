"""Kernels for the cyclic frames of a CiA 402 drive.

The kernels accept a drive as an array row or as a Python object. Source: fact sheet cia402.

The standard RPDO (little-endian) has the control word in bytes 0..1 and the target torque in bytes
2..3, in thousandths of the rated torque. The standard TPDO, sent after SYNC, has the status word in
bytes 0..1, the position in bytes 2..5 and the torque in bytes 6..7.
"""

import ctypes
from typing import Any

from firmware_sim.compiled import kernel_helper
from firmware_sim.nodes.cia402.power_stage import ENABLED_STATE, PowerStruct, status_word

OPERATIONAL_STATE = 0x05
"""NMT state: operational."""
CYCLIC_TORQUE_MODE = 10
"""Number of the mode cyclic synchronous torque (0x6060).

The module ``motion_modes`` has the other modes.
"""
THERMAL_PERIOD_NS = 100_000_000
"""Period of the update of the drive's temperatures [ns]."""
TURN_RAD = 6.283185307179586
"""A full turn [rad]."""
CYCLIC_OBJECTS = (
    (0x6040, 0), (0x6041, 0), (0x6061, 0), (0x6064, 0), (0x606C, 0), (0x6071, 0), (0x6072, 0), (0x6077, 0), (0x6078, 0),
    (0x60B2, 0), (0x1016, 1), (0x1017, 0), (0x6080, 0),
)  # fmt: skip
"""Objects that come first in the list of an object dictionary's values.

Because of the fixed order, kernels know the indices of the listed objects.
"""
(CONTROL_WORD, STATUS_WORD, MODE_SHOWN, POSITION, VELOCITY, TARGET_TORQUE, MAX_TORQUE, TORQUE, CURRENT,
 TORQUE_OFFSET, MASTER, HEARTBEAT_PERIOD_MS, MAX_SPEED) = range(len(CYCLIC_OBJECTS))  # fmt: skip
"""Indices of the values of ``CYCLIC_OBJECTS`` in the list of an object dictionary's values."""
MAX_OBJECT_COUNT = 192
"""Maximum number of object values in the array row of a drive."""
SPEED_LIMIT_BAND = 0.1
"""Range of speed in which the torque falls to zero, as a fraction of the speed limit.

The range of speed is an assumption.
"""
_MAX_INT16 = (1 << 15) - 1
"""Maximum value of an object with a signed data type of two bytes."""
_MAX_INT32 = (1 << 31) - 1
"""Maximum value of an object with a signed data type of four bytes."""


class Cia402Struct(ctypes.Structure):
    """Memory layout of the state of a simulated drive, for compiled kernels.

    The class ``node.Cia402Node`` explains the fields.

    ``motor_number`` is the index of the drive's rotor in the array of rotors. ``bus`` is the index
    of the drive's bus in the list of the hand's buses.
    """

    _fields_ = [
        *(
            (name, ctypes.c_double)
            for name in ("offset", "direction", "gear", "rated", "peak", "counts")
        ),
        *(
            (name, ctypes.c_int64)
            for name in ("nmt", "node_id", "motor_number", "bus", "syncs", "frame_pending")
        ),
        *(
            (name, ctypes.c_int64)
            for name in ("watchdog_fed_ns", "heartbeat_ns", "wake_ns", "thermal_ns")
        ),
        *(
            (name, ctypes.c_int64)
            for name in ("sync_id", "master_id", "rpdo_id", "tpdo_id", "tpdo_kind")
        ),
        *((name, ctypes.c_int64) for name in ("motion_due_ns", "mode_bits")),
        ("power_stage", PowerStruct),
        ("values", ctypes.c_int64 * MAX_OBJECT_COUNT),
    ]


@kernel_helper
def _clamp_to_range(value: int, limit: int) -> int:
    """Limit a value to the range of a signed integer whose maximum is ``limit``."""
    return min(limit, max(-limit - 1, value))


@kernel_helper
def update_measured_objects(
    node: Any, power: Any, angle: float, velocity: float, torque: float
) -> None:
    """Write measured values to the object dictionary of a drive.

    Args:
        node: simulated drive, as an array row or as a Python object.
        power: power stage of the drive.
        angle: spool angle that the encoder measures [rad].
        velocity: angular velocity of the spool [rad/s].
        torque: torque of the motor, converted to the spool [N m].
    """
    values = node.values
    sign = node.direction
    gear = node.gear
    shaft = sign * gear * angle + node.offset
    word = status_word(power)
    if node.mode_bits >= 0:
        # Bits 10 to 13 of the status word depend on the mode of operation.
        word = word & ~0x3C00 | node.mode_bits
    values[STATUS_WORD] = word
    # The unit of the position object is the encoder count at the motor shaft.
    values[POSITION] = _clamp_to_range(round(shaft / TURN_RAD * node.counts), _MAX_INT32)
    # In the simulated drive, object 0x606C (velocity) has the unit revolutions per minute.
    values[VELOCITY] = _clamp_to_range(round(sign * gear * velocity / TURN_RAD * 60.0), _MAX_INT32)
    values[TORQUE] = values[CURRENT] = _clamp_to_range(
        round(sign * torque / gear / node.rated * 1000.0), _MAX_INT16
    )


@kernel_helper
def apply_torque(node: Any, servo: Any) -> None:
    """Apply the target torque, the torque limit (0x6072) and the speed limit (0x6080) to an enabled drive's servo."""
    values = node.values
    thousandths = values[TARGET_TORQUE] + values[TORQUE_OFFSET]
    limit = values[MAX_TORQUE]
    servo.limit = node.peak
    # The factor below converts thousandths of the rated torque at the shaft to N m at the spool.
    servo.torque = (
        node.direction * node.gear * node.rated / 1000.0 * min(limit, max(-limit, thousandths))
    )
    # The factor below converts revolutions per minute at the shaft to rad/s at the spool.
    servo.speed_limit = values[MAX_SPEED] * TURN_RAD / 60.0 / node.gear
    servo.speed_gain = 0.0
    if servo.speed_limit > 0.0:
        servo.speed_gain = node.peak / (SPEED_LIMIT_BAND * servo.speed_limit)


@kernel_helper
def is_in_torque_mode(node: Any, power: Any) -> bool:
    """Return True if the drive follows torque commands, because it is enabled and in torque mode."""
    return bool(power.state == ENABLED_STATE and node.values[MODE_SHOWN] == CYCLIC_TORQUE_MODE)


@kernel_helper
def heartbeat_timeout_ns(node: Any) -> int:
    """Return the timeout of the master's heartbeat [ns], or 0 if the drive does not supervise the master."""
    # Object 0x1016 contains the node number of the master in bits 23..16 and the time [ms] in bits
    # 15..0.
    return int(node.values[MASTER] & 0xFFFF) * 1_000_000


@kernel_helper
def heartbeat_due(node: Any, t_ns: int) -> bool:
    """Return True if the drive must send its heartbeat now."""
    period_ns = node.values[HEARTBEAT_PERIOD_MS] * 1_000_000
    return bool(period_ns > 0 and t_ns - node.heartbeat_ns >= period_ns)


@kernel_helper
def watchdog_expired(node: Any, t_ns: int) -> bool:
    """Return True if the master's heartbeat has timed out."""
    return bool(
        node.watchdog_fed_ns >= 0
        and heartbeat_timeout_ns(node) > 0
        and t_ns >= node.watchdog_fed_ns + heartbeat_timeout_ns(node)
    )


@kernel_helper
def schedule_wake(node: Any, t_ns: int, has_frame_to_send: bool) -> None:
    """Set the time at which a drive must wake next.

    The drive wakes to update its temperatures or a motion, to send its heartbeat, or to check the
    timeout of the master.

    Args:
        node: simulated drive, as an array row or as a Python object.
        t_ns: present time [ns].
        has_frame_to_send: True if a frame of the drive waits to be sent at once.
    """
    wake_ns = (
        t_ns if has_frame_to_send or node.thermal_ns < 0 else node.thermal_ns + THERMAL_PERIOD_NS
    )
    period_ns = node.values[HEARTBEAT_PERIOD_MS] * 1_000_000
    if period_ns > 0:
        wake_ns = min(wake_ns, node.heartbeat_ns + period_ns)
    if node.watchdog_fed_ns >= 0 and heartbeat_timeout_ns(node) > 0:
        wake_ns = min(wake_ns, node.watchdog_fed_ns + heartbeat_timeout_ns(node))
    if node.motion_due_ns > 0:
        wake_ns = min(wake_ns, node.motion_due_ns)
    node.wake_ns = wake_ns
    node.frame_pending = has_frame_to_send
