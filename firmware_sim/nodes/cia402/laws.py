"""What a CiA 402 drive does with the frames of every tick; laws of a row or of an object. Source: facts, cia402."""

import ctypes
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.nodes.cia402.power import ENABLED, PowerRow, status

OPERATIONAL = 0x05
CST = 10
"""Mode of operation: cyclic synchronous torque."""
WARM_NS = 100_000_000
TURN = 6.283185307179586
HOT = (
    (0x6040, 0), (0x6041, 0), (0x6061, 0), (0x6064, 0), (0x606C, 0), (0x6071, 0), (0x6072, 0), (0x6077, 0), (0x6078, 0),
    (0x60B2, 0), (0x1016, 1), (0x1017, 0),
)  # fmt: skip
"""Objects that come first among the values of a dictionary, so that laws know their places."""
(CONTROL_WORD, STATUS_WORD, MODE_SHOWN, POSITION, VELOCITY, TARGET_TORQUE, MAX_TORQUE, TORQUE, CURRENT,
 TORQUE_OFFSET, MASTER, HEARTBEAT_MS) = range(len(HOT))  # fmt: skip
ROOM = 128
"""Values that there is room for in a row."""
_INT16, _INT32 = (1 << 15) - 1, (1 << 31) - 1


class Cia402Row(ctypes.Structure):
    """See ``node.Cia402Node``; ``motor_number``: of its rotor; ``bus``: its index in the hand."""

    _fields_ = [
        *((name, ctypes.c_double) for name in ("offset", "direction", "gear", "rated", "peak", "counts")),
        *((name, ctypes.c_int64) for name in ("nmt", "node_id", "motor_number", "bus", "syncs", "at_once")),
        *((name, ctypes.c_int64) for name in ("fed_ns", "beat_ns", "wake_ns", "warmed_ns")),
        *((name, ctypes.c_int64) for name in ("sync_id", "master_id", "rpdo_id", "tpdo_id", "tpdo_kind")),
        ("power_stage", PowerRow),
        ("values", ctypes.c_int64 * ROOM),
    ]


@inner
def _saturated(value: int, most: int) -> int:
    """Return what a signed object of the dictionary can hold."""
    return min(most, max(-most - 1, value))


@inner
def measure(node: Any, power: Any, angle: float, velocity: float, torque: float) -> None:
    """Renew what is measured.

    Args: node: row or object. power: its power stage. angle, velocity, torque: of the motor [rad], [rad/s], [N m].
    """
    values, sign, gear = node.values, node.direction, node.gear
    shaft = sign * gear * angle + node.offset
    values[STATUS_WORD] = status(power)
    values[POSITION] = _saturated(round(shaft / TURN * node.counts), _INT32)
    values[VELOCITY] = _saturated(round(sign * gear * velocity / TURN * 60.0), _INT32)
    values[TORQUE] = values[CURRENT] = _saturated(round(sign * torque / gear / node.rated * 1000.0), _INT16)


@inner
def follow(node: Any, servo: Any) -> None:
    """Make the torque that an enabled drive is commanded."""
    values = node.values
    thousandths, most = values[TARGET_TORQUE] + values[TORQUE_OFFSET], values[MAX_TORQUE]
    servo.limit = node.peak
    servo.torque = node.direction * node.gear * node.rated / 1000.0 * min(most, max(-most, thousandths))


@inner
def follows(node: Any, power: Any) -> bool:
    """Return whether power stage and mode allow torque."""
    return bool(power.state == ENABLED and node.values[MODE_SHOWN] == CST)


@inner
def patience_ns(node: Any) -> int:
    """Return how long the master may be silent [ns]; 0 if it is not watched."""
    return int(node.values[MASTER] & 0xFFFF) * 1_000_000


@inner
def beats(node: Any, t_ns: int) -> bool:
    """Return whether its heartbeat is due."""
    period_ns = node.values[HEARTBEAT_MS] * 1_000_000
    return bool(period_ns > 0 and t_ns - node.beat_ns >= period_ns)


@inner
def starves(node: Any, t_ns: int) -> bool:
    """Return whether the master was silent for too long."""
    return bool(node.fed_ns >= 0 and patience_ns(node) > 0 and t_ns >= node.fed_ns + patience_ns(node))


@inner
def schedule(node: Any, t_ns: int, at_once: bool) -> None:
    """Note when time must pass for a drive next: temperature, heartbeat, silence of the master.

    Args: node: row or object. t_ns: the present [ns]. at_once: whether it has something to send now.
    """
    wake_ns = t_ns if at_once or node.warmed_ns < 0 else node.warmed_ns + WARM_NS
    period_ns = node.values[HEARTBEAT_MS] * 1_000_000
    if period_ns > 0:
        wake_ns = min(wake_ns, node.beat_ns + period_ns)
    if node.fed_ns >= 0 and patience_ns(node) > 0:
        wake_ns = min(wake_ns, node.fed_ns + patience_ns(node))
    node.wake_ns, node.at_once = wake_ns, at_once
