"""Turning a shaft a little and bringing it to rest, by torques below a limit; its inertia is measured on the way.

A free shaft of 1e-4 kg m2 is fast: a brake whose gain does not know the inertia swings it up, because what is seen of
the velocity is some 30 ms old.
"""

import math
from typing import NamedTuple

from handctl.drives.contract import Phase, Want
from handctl.runtime.diagnostics.drive_rig import PERIOD_NS, DriveRig

PERIOD_S = PERIOD_NS * 1e-9
MOVED_RAD, RAMP_S = 0.05, 1.0
COAST_TICKS = 12
"""After a push: until the velocity that is seen is all of what the push has made."""
STILL_RAD_S, BRAKE_S = 0.1, 4.0
SLOWING_S = 0.2
"""Time constant of the brake: far longer than what is seen of the velocity is old."""


class Push(NamedTuple):
    """How a shaft answered a ramp of torque.

    Attributes:
        moved: angle [rad], in the sense of the torque; what it would have coasted anyway is taken off.
        torque: the last one [N m]. told: by the drive then [N m].
        enabled: whether the drive was to the end.
    """

    moved: float
    torque: float
    told: float
    enabled: bool


def push(rig: DriveRig, sign: int, limit: float) -> Push:
    """Raise the torque until the shaft has moved by MOVED_RAD either way, or to the limit; then let it coast.

    Args:
        rig: of a drive that is enabled.
        sign: of the torque.
        limit: largest torque [N m].
    """
    start, coasting, impulse = rig.state.position, rig.velocity, 0.0
    ticks = round(RAMP_S / PERIOD_S)
    moved = torque = 0.0
    for i in range(ticks):
        torque = sign * limit * (i + 1) / ticks
        rig.tick(Want.ENABLE, torque)
        impulse += torque * PERIOD_S
        if rig.state.phase != Phase.ENABLED:
            return Push(moved, torque, rig.state.torque, False)
        travel, anyway = sign * (rig.state.position - start), abs(coasting) * (i + 1) * PERIOD_S
        moved = math.copysign(max(0.0, abs(travel) - anyway), travel) if math.isfinite(anyway) else travel
        if abs(moved) > MOVED_RAD:
            break
    told = rig.state.torque
    rig.keep(Want.ENABLE, COAST_TICKS * PERIOD_S)
    gained = rig.velocity - (coasting if math.isfinite(coasting) else 0.0)
    if impulse * gained > 0.0:
        rig.inertia = impulse / gained
    return Push(moved, torque, told, True)


def brake(rig: DriveRig, limit: float) -> bool:
    """Bring the shaft to rest; whether it is. Without a measured inertia it can only be waited for.

    Args:
        rig: of a drive that is enabled.
        limit: largest torque [N m].
    """
    gain = rig.inertia / SLOWING_S if math.isfinite(rig.inertia) else 0.0
    still = 0
    for _ in range(round(BRAKE_S / PERIOD_S)):
        speed = rig.velocity
        still = still + 1 if abs(speed) < STILL_RAD_S else 0
        if still > COAST_TICKS:
            return True
        rig.tick(Want.ENABLE, max(-limit, min(limit, -gain * speed)) if math.isfinite(speed) else 0.0)
    return not abs(rig.velocity) > STILL_RAD_S
