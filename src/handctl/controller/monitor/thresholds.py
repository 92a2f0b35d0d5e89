"""Thresholds of safety for one hand: what its drives, its sensors and its model allow."""

from collections.abc import Sequence

import numpy as np

from handctl.core.model import HandModel
from handctl.drives.contract import Drive
from handctl.drives.sensors.node import SensorNode
from handctl.safety.detectors.residuals import Rotor
from handctl.safety.signals import LEAST_FRAMES, LEAST_SILENT, LEAST_STALLED, SILENT_S, STALLED_S, Limits, ticks_for
from handctl.safety.watch import JUMP_MARGIN, Watcher

JOINT_RATE_RAD_S = 60.0
"""Faster than any joint of a hand. Source: spool speed of the packaged hands over their smallest moment arm."""
NOISE_TIMES, NOISE_STEPS = 9.0, 6.0
"""A noise burst has so many times the variance of: drive torque on the bare rotor, and so many counts of rounding."""


def make_watcher(model: HandModel, drives: tuple[Drive, ...], sensors: SensorNode) -> Watcher:
    """The watcher of a hand."""
    hand, space = model.hand, model.space
    rates = [hand.motor_of(name).velocity_range_rad_s for name in hand.tendon_names]
    arms = np.abs(hand.moment_arms)
    limits = Limits(
        tendons=hand.tendon_names,
        tension_trip=tuple(tendon.tension_trip_N for tendon in hand.tendon),
        tension_rail=sensors.tension_rail,
        tension_low=sensors.tension_low,
        drive_limit=tuple(tendon.drive_limit_N for tendon in hand.tendon),
        motors=tuple(drive.name for drive in drives),
        silent_ticks=ticks_for(SILENT_S, model.period, LEAST_SILENT),
        stalled_ticks=ticks_for(STALLED_S, model.period, LEAST_STALLED),
        noise_most=_noise_most(model),
        frames_most=frames_most(drives, sensors),
    )
    motor_period = np.array([max(model.period, drive.feedback_period_s) for drive in drives])
    joint_period = hand.sensor_node.joint_decimation * model.period
    return Watcher(
        limits=limits,
        joints=hand.joints,
        rotor=Rotor(space.motor_mass, space.motor_damping, space.coulomb, model.period, motor_period, joint_period),
        stiffness=space.stiffness,
        spool=space.spool,
        arms=arms.sum(axis=1),
        spool_to_joints=model.excursion_to_joints,
        step_most=(
            JUMP_MARGIN * model.period * np.array(rates),
            np.full(len(hand.joints), JUMP_MARGIN * model.period * JOINT_RATE_RAD_S),
        ),
    )


def frames_most(drives: Sequence[Drive], sensors: SensorNode) -> int:
    """Frames in one tick that are more than these nodes can have sent: twice what they answer, but never few."""
    return max(LEAST_FRAMES, sum(len(drive.exchange) for drive in drives) + 2 * len(sensors.node_ids))


def _noise_most(model: HandModel) -> float:
    """Mean squared jerk of a motor's position that only noise makes [rad^2]: the drive's torque both ways, rounding."""
    space, period = model.space, model.period
    torque = float((model.torque_limit / space.spool / space.motor_mass / space.spool).max())
    rounding = NOISE_STEPS * float((space.encoder_step / space.spool).max()) ** 2
    return NOISE_TIMES * ((0.1 * torque * period**2) ** 2 + rounding)
