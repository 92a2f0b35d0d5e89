"""The numbers of one tick, gathered for the log from what the tick knows anyway."""

import math

import numpy as np

from handctl.controller.monitor.motors import Motors
from handctl.core.estimation.estimator import Estimate, Measured
from handctl.core.estimation.posture import tip_forces
from handctl.core.law.computed_torque import Command
from handctl.core.model import HandModel
from handctl.core.types import Telemetry


def telemetry(
    model: HandModel,
    motors: Motors,
    contact: tuple[bool, ...],
    measured: Measured,
    estimate: Estimate,
    command: Command,
    t_ns: int,
) -> Telemetry:
    """Gather one tick's numbers.

    Args:
        model: the hand.
        motors: after the tick.
        contact: of each digit, after the tick.
        measured: new measurements, NaN where missing.
        estimate: of this instant.
        command: what was commanded, NaN where nothing was.
        t_ns: time of the tick [ns].
    """
    age = [(t_ns - heard) / 1e9 if heard >= 0 else math.nan for heard in motors.feedback_t_ns]
    told = np.array((motors.velocity, motors.torque, motors.temperature, age, motors.phase), dtype=np.float64)
    velocity, torque, temperature, ages, phase = told
    digits = model.all_digits
    force, force_sigma = tip_forces(
        estimate.q, estimate.q_sigma, estimate.external, estimate.sigma,
        digits.ahead, digits.reach, digits.members, digits.arms,
    )  # fmt: skip
    missing = measured.travel != measured.travel
    if np.count_nonzero(missing):
        velocity[missing] = torque[missing] = np.nan
    return Telemetry(
        estimate.q,
        estimate.dq,
        command.q,
        command.dq,
        command.joint_torque,
        measured.joints,
        estimate.excursion,
        estimate.rate,
        estimate.tension,
        estimate.sigma,
        measured.tension,
        command.tension,
        estimate.offset,
        estimate.innovation,
        estimate.nis,
        estimate.external,
        measured.position,
        velocity,
        torque,
        command.torque,
        temperature,
        ages,
        phase,
        force,
        np.array(contact, dtype=np.float64),
        estimate.q_sigma,
        force_sigma,
    )
