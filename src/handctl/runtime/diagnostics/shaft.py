"""Torque-step test of a shaft: turn it a little and bring it to rest, by torques below a limit.

The test also measures the inertia of the shaft. A free shaft of 1e-4 kg m2 is fast. A brake with a gain
that ignores the inertia would make it oscillate, because the measured velocity is some 30 ms old.
"""

import math
from typing import NamedTuple

from handctl.drives.contract import Phase, Want
from handctl.runtime.diagnostics.drive_rig import PERIOD_NS, DriveRig

PERIOD_S = PERIOD_NS * 1e-9
"""Period of a tick [s]."""
MOVED_RAD, RAMP_S = 0.05, 1.0
"""Angle that counts as a motion [rad], and duration of the ramp to the torque limit [s]."""
COAST_TICKS = 12
"""Ticks after a push until the measured velocity shows the whole effect of the push."""
STILL_RAD_S, BRAKE_S = 0.1, 4.0
"""Largest velocity of a shaft at rest [rad/s], and longest duration of braking [s]."""
SLOWING_S = 0.2
"""Time constant of the brake, far longer than the delay of the measured velocity [s]."""


class Push(NamedTuple):
    """Response of a shaft to a torque ramp.

    Attributes:
        moved: angle in the direction of the torque, less the angle that the shaft would have coasted [rad].
        torque: last command [N m].
        told: torque that the drive reported then [N m].
        enabled: the drive was enabled to the end.
    """

    moved: float
    torque: float
    told: float
    enabled: bool


def push(rig: DriveRig, sign: int, limit: float) -> Push:
    """Raise the torque until the shaft has moved by MOVED_RAD in either direction, or to the limit. Then coast.

    Args:
        rig: of an enabled drive.
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
    if impulse * gained > 0.0:  # angular impulse [N m s] over the change of velocity
        rig.inertia = impulse / gained
    return Push(moved, torque, told, True)


def brake(rig: DriveRig, limit: float) -> bool:
    """Bring the shaft to rest and return True if it rests.

    Without a measured inertia the function waits until friction has stopped the shaft.

    Args:
        rig: of an enabled drive.
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
