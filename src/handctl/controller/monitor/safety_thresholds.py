"""Thresholds of the safety monitor for a hand, computed from the drives, the sensors and the model of the hand."""

from collections.abc import Sequence

import numpy as np

from handctl.core.hand_constants import HandConstants, low_pass_fractions, servo_constants
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import Vector
from handctl.drives.contract import Drive
from handctl.drives.sensors.contract import SensorInterface
from handctl.drives.signals import SignalCoding, SignalQuantity
from handctl.safety.faults.node import POSITION_NOISE_FACTOR
from handctl.safety.safety_limits import (
    MAX_SILENCE_S,
    MAX_STALL_S,
    MIN_FLOOD_FRAMES,
    MIN_SILENT_TICKS,
    MIN_STALLED_TICKS,
    SafetyLimits,
    tick_count_for_time,
)

POSITION_STEP_FACTOR = 1.5
"""Largest plausible step of a position in a tick, as a multiple of the top speed times the control period."""
JOINT_RATE_RAD_S = 60.0
"""Joint speed that no joint can reach [rad/s].

Source: tendon speed at the spools of the packaged hands, divided by the smallest moment arm.
"""
ROUNDING_NOISE_COUNTS = 6.0
"""Mean squared jerk of a motor position that rounding of the encoder causes [squared encoder counts]."""
TYPICAL_ACCELERATION_FRACTION = 0.1
"""RMS acceleration of a healthy motor over 100 ms, as a fraction of the bare rotor's acceleration at full torque.

A motor in a hand accelerates its rotor and a digit, and does not make its full torque for long. In
the reference logs of the hands jamia and jamia11, the fraction of the bare rotor's acceleration is
at most 0.02.
"""


def safety_limits(
    model: HandModel, drives: tuple[Drive, ...], sensors: SensorInterface
) -> SafetyLimits:
    """Return the safety thresholds of a hand."""
    hand = model.hand
    return SafetyLimits(
        tendons=hand.tendon_names,
        motors=tuple(drive.name for drive in drives),
        joints=hand.joints,
        tension_trip=tuple(
            tendon.tension_trip_N - margin
            for tendon, margin in zip(hand.tendon, model.margin_without_cell.tolist(), strict=True)
        ),
        drive_limit=tuple(tendon.drive_limit_N for tendon in hand.tendon),
        tension_rail=sensors.tension_rail,
        tension_low=sensors.tension_low,
        silent_ticks=tick_count_for_time(MAX_SILENCE_S, model.period, MIN_SILENT_TICKS),
        stalled_ticks=tick_count_for_time(MAX_STALL_S, model.period, MIN_STALLED_TICKS),
        max_position_noise=_noise_limit(model),
        max_frames_per_tick=max_frames_per_tick(drives, sensors),
    )


def compiled_constants(
    model: HandModel,
    drives: tuple[Drive, ...],
    sensors: SensorInterface,
    limits: SafetyLimits,
    tare_tensions: Vector,
    motor_zeros: Vector,
) -> HandConstants:
    """Return the constants of a hand for the compiled code.

    Args:
        model: model of the hand.
        drives: drives of the hand.
        sensors: sensor node of the hand.
        limits: safety thresholds.
        tare_tensions: (N,) tare of each load cell [N].
        motor_zeros: (N,) zero angle of each motor [rad].
    """
    hand = model.hand
    period = model.period
    motor_period = np.array([max(period, drive.feedback_period_s) for drive in drives])
    joint_period = hand.sensor_node.joint_decimation * period
    silent_ticks = tick_count_for_time(MAX_SILENCE_S, joint_period, MIN_SILENT_TICKS) * joint_period
    rates = np.array(
        [hand.motor_of_tendon(name).velocity_range_rad_s for name in hand.tendon_names]
    )
    return HandConstants(model, {
        "tare": tare_tensions,
        "zero": motor_zeros,
        "step_limit": POSITION_STEP_FACTOR * period * rates,
        "joint_step_limit": POSITION_STEP_FACTOR * period * JOINT_RATE_RAD_S * hand.display_units.scale,
        "residual_fraction": low_pass_fractions(model, motor_period, joint_period),
        "motor_period": motor_period,
        "joint_period": joint_period,
        "tension_trip": limits.tension_trip,
        "drive_limit": limits.drive_limit,
        "torque_step": [torque_resolution(drive) for drive in drives] / model.tendon_constants.spool_radius,
        **servo_resolutions(model, drives),
        "noise_limit": limits.max_position_noise,
        "temperature_soft": limits.temperature_soft,
        "temperature_hard": limits.temperature_hard,
        "tension_rail": limits.tension_rail,
        "tension_low": limits.tension_low,
        "cell_low": sensors.cell_range[0],
        "cell_high": sensors.cell_range[1],
        "cyclic_ns": [round(drive.feedback_period_s * 1e9) for drive in drives],
        "answers_once": [drive.sends_one_reply_per_command for drive in drives],
        "cell_group": [sensors.group_of_tendon(n) for n in range(model.tendon_count)],
        "joint_group": [sensors.group_of_joint(j) for j in range(len(hand.joints))],
        "mute_ns": round(silent_ticks * 1e9),
        "silent_ticks": limits.silent_ticks,
        "one_silent_ticks": limits.silent_ticks_of_single_motor,
        "stalled_ticks": limits.stalled_ticks,
        "frames_limit": limits.max_frames_per_tick,
        "tension_groups": sensors.tension_frames,
    })  # fmt: skip


def servo_resolutions(model: HandModel, drives: tuple[Drive, ...]) -> dict[str, object]:
    """Return the constants that describe how the frames of each drive encode the values of its position loop.

    For kp [N m/rad] and kd [N m s/rad], the constants are the value of one count, and the largest
    value that a frame can contain. The constant ``servo_rounding`` is a change of the motor force
    [N]. The position loop computes this change if the measured position and speed change by one
    count each. The constant ``servo_moves`` of a drive is True if the drive itself changes the
    commanded position between two commands, at the commanded velocity. If the commands of a drive
    contain no kp and kd, the function returns 1 as the value of one count of kp and kd. The
    feedback of a drive consists of its position and its speed. A drive rounds its position and its
    speed to counts of the protocol. If a count of the encoder is larger than a count of the
    protocol, the drive rounds the position to counts of the encoder.
    """
    gain = np.ones(len(drives)) if model.torque_gain is None else model.torque_gain
    loop = servo_constants(model)
    steps = np.ones((2, len(drives)))
    largest = np.full((2, len(drives)), np.inf)
    torque = np.zeros(len(drives))
    inputs = {SignalQuantity.POSITION: "servo_stiffness", SignalQuantity.VELOCITY: "servo_damping"}
    for n, drive in enumerate(drives):
        if drive.cyclic_messages.position is None:
            continue
        for signal in drive.cyclic_messages.position.signals:
            if signal.quantity in (SignalQuantity.STIFFNESS, SignalQuantity.DAMPING):
                steps[signal.quantity - SignalQuantity.STIFFNESS, n] = signal.step * gain[n]
                largest[signal.quantity - SignalQuantity.STIFFNESS, n] = (
                    signal.value_limits[1] * gain[n]
                )
        for signal in (
            signal for message in drive.cyclic_messages.feedback for signal in message.signals
        ):
            if signal.quantity in inputs:
                # A floating-point number has finer steps than the encoder that measures the
                # position.
                encoder = (
                    model.tendon_constants.encoder_step[n] / model.tendon_constants.spool_radius[n]
                )
                step = (
                    max(signal.step, encoder)
                    if signal.quantity == SignalQuantity.POSITION
                    else signal.step
                )
                torque[n] += step * loop[inputs[signal.quantity]][n]
    return {
        "servo_kp_max": largest[0],
        "servo_kd_max": largest[1],
        "servo_moves": [drive.cyclic_messages.integrates_velocity for drive in drives],
        "servo_kp_step": steps[0],
        "servo_kd_step": steps[1],
        "servo_rounding": torque / model.tendon_constants.spool_radius,
    }


def torque_resolution(drive: Drive) -> float:
    """Return the resolution of a drive's torque [N m at the spool].

    The resolution is the torque of one count in the feedback, or of one count in the command if
    this count is larger. If the drive sends and receives the torque as a floating-point number, the
    result is 0.
    """
    messages = (*drive.cyclic_messages.feedback, *drive.cyclic_messages.commands)
    signals = [
        signal
        for message in messages
        for signal in message.signals
        if signal.quantity == SignalQuantity.TORQUE
    ]
    return max(
        (abs(signal.scale) for signal in signals if signal.coding != SignalCoding.FLOAT),
        default=0.0,
    )


def max_frames_per_tick(drives: Sequence[Drive], sensors: SensorInterface) -> int:
    """Return the number of frames per tick above which the bus counts as flooded.

    The limit is twice the number of replies of all nodes in a tick, but at least
    ``MIN_FLOOD_FRAMES``.
    """
    return max(
        MIN_FLOOD_FRAMES,
        sum(len(drive.frames_per_tick) for drive in drives) + 2 * len(sensors.node_ids),
    )


def _noise_limit(model: HandModel) -> float:
    """Return the upper limit of the mean squared jerk of a healthy motor's position [rad^2].

    A position step is the change of the position in one tick. The jerk of a position is the change
    of its position step from one tick to the next. The jerk equals the acceleration times the
    squared control period. The limit includes the jerk of a real motion and the rounding of the
    encoder.
    """
    tendons = model.tendon_constants
    period = model.period
    # Acceleration of a rotor without load at full torque [rad/s^2]. The torque divided by the spool
    # radius is the force on the tendon. The force divided by the mass is the acceleration along the
    # tendon. The acceleration along the tendon divided by the spool radius is the angular
    # acceleration of the rotor.
    acceleration = float(
        (
            model.torque_limit / tendons.spool_radius / tendons.motor_mass / tendons.spool_radius
        ).max()
    )
    rounding_noise = (
        ROUNDING_NOISE_COUNTS * float((tendons.encoder_step / tendons.spool_radius).max()) ** 2
    )
    return POSITION_NOISE_FACTOR * (
        (TYPICAL_ACCELERATION_FRACTION * acceleration * period**2) ** 2 + rounding_noise
    )
