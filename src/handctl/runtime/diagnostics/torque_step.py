"""Torque-step test.

The shaft of a drive is turned a little and brought to rest, with torques below a limit.

The test also measures the inertia of the shaft. A shaft without a load accelerates fast, because
its inertia can be as small as 1e-4 kg m2. The measured velocity of the shaft is about 30 ms old. If
the gain of the braking torque were fixed, a shaft of low inertia would oscillate. Therefore the
gain of the braking torque depends on the inertia.
"""

import math
from typing import NamedTuple

from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.runtime.diagnostics.drive_rig import PERIOD_NS, DriveRig

PERIOD_S = PERIOD_NS * 1e-9
"""Period of a tick [s]."""
MIN_MOTION_RAD = 0.05
"""Smallest angle that counts as a motion of the shaft [rad]."""
TORQUE_RAMP_S = 1.0
"""Duration of the torque ramp from zero to the limit [s]."""
COASTING_TICKS = 12
"""Number of ticks after which the measured velocity shows the whole effect of a torque pulse."""
MAX_REST_VELOCITY_RAD_S = 0.1
"""Largest measured velocity at which a shaft counts as at rest [rad/s]."""
MAX_BRAKE_S = 4.0
"""Longest time for which a shaft is braked [s]."""
BRAKE_TIME_CONSTANT_S = 0.2
"""Time constant with which the brake reduces the velocity [s].

The time constant is far longer than the delay of the measured velocity.
"""


class TorqueStep(NamedTuple):
    """Response of a shaft to a torque ramp.

    Attributes:
        moved_rad: angle by which the shaft turned in the direction of the torque [rad]. The angle
            by which the shaft would have coasted without the torque is subtracted.
        commanded_torque_N_m: last commanded torque [N m].
        reported_torque_N_m: torque reported by the drive at the end of the ramp [N m].
        enabled: True if the drive was enabled until the end of the test.
    """

    moved_rad: float
    commanded_torque_N_m: float
    reported_torque_N_m: float
    enabled: bool


def apply_torque_step(rig: DriveRig, motion_sign: int, torque_limit: float) -> TorqueStep:
    """Raise the torque until the shaft has moved by MIN_MOTION_RAD, or until the torque reaches its limit.

    After the torque ramp, let the shaft coast.

    Args:
        rig: rig with an enabled drive.
        motion_sign: sign of the torque.
        torque_limit: largest torque [N m].
    """
    start = rig.state.position
    initial_velocity = rig.velocity_rad_s
    torque_impulse = 0.0
    ticks = round(TORQUE_RAMP_S / PERIOD_S)
    position_change = torque = 0.0
    start_ns = rig.t_ns
    for i in range(ticks):
        last_torque = torque
        torque = motion_sign * torque_limit * (i + 1) / ticks
        rig.run_tick(DriveTarget.ENABLE, torque)
        # During the ticks that the host has missed, the drive keeps its last torque.
        torque_impulse += (last_torque * rig.missed_ticks + torque) * PERIOD_S
        if rig.state.phase != DrivePhase.ENABLED:
            return TorqueStep(position_change, torque, rig.state.torque, False)
        travel = motion_sign * (rig.state.position - start)
        coasted_distance = abs(initial_velocity) * (rig.t_ns - start_ns) * 1e-9
        position_change = (
            math.copysign(max(0.0, abs(travel) - coasted_distance), travel)
            if math.isfinite(coasted_distance)
            else travel
        )
        if abs(position_change) > MIN_MOTION_RAD:
            break
    reported_torque = rig.state.torque
    rig.run_for(DriveTarget.ENABLE, COASTING_TICKS * PERIOD_S)
    speed_change = rig.velocity_rad_s - (
        initial_velocity if math.isfinite(initial_velocity) else 0.0
    )
    if (
        torque_impulse * speed_change > 0.0
    ):  # the inertia is the integral of the torque over time [N m s], divided by the change of velocity
        rig.inertia = torque_impulse / speed_change
    return TorqueStep(position_change, torque, reported_torque, True)


def brake_shaft(rig: DriveRig, torque_limit: float) -> bool:
    """Brake the shaft, and return True if the shaft is at rest.

    If the inertia has not been measured, wait until friction has stopped the shaft.

    Args:
        rig: rig with an enabled drive.
        torque_limit: largest torque [N m].
    """
    gain = rig.inertia / BRAKE_TIME_CONSTANT_S if math.isfinite(rig.inertia) else 0.0
    ticks_at_rest = 0
    for _ in range(round(MAX_BRAKE_S / PERIOD_S)):
        speed = rig.velocity_rad_s
        ticks_at_rest = ticks_at_rest + 1 if abs(speed) < MAX_REST_VELOCITY_RAD_S else 0
        if ticks_at_rest > COASTING_TICKS:
            return True
        rig.run_tick(
            DriveTarget.ENABLE,
            max(-torque_limit, min(torque_limit, -gain * speed)) if math.isfinite(speed) else 0.0,
        )
    return not abs(rig.velocity_rad_s) > MAX_REST_VELOCITY_RAD_S
