"""The numbers of one tick, gathered for the log from what the tick knows anyway."""

import math

import numpy as np

from handctl.controller.computed_torque import Command
from handctl.controller.estimator import Estimate, Measured
from handctl.controller.model import HandModel
from handctl.controller.state import State
from handctl.controller.types import Telemetry


def telemetry(
    model: HandModel, state: State, measured: Measured, estimate: Estimate, command: Command, t_ns: int
) -> Telemetry:
    """Gather one tick's numbers.

    Args:
        model: the hand.
        state: after the tick.
        measured: new measurements, NaN where missing.
        estimate: of this instant.
        command: what was commanded, NaN where nothing was.
        t_ns: time of the tick [ns].
    """
    drives = state.drives
    velocity, torque = np.array([[drive.velocity for drive in drives], [drive.torque for drive in drives]])
    missing = np.isnan(measured.travel)
    if np.count_nonzero(missing):
        velocity[missing] = torque[missing] = np.nan
    return Telemetry(
        q=estimate.q,
        dq=estimate.dq,
        q_goal=command.q,
        dq_goal=command.dq,
        joint_torque=command.joint_torque,
        joint_encoder=measured.joints,
        excursion=estimate.excursion,
        excursion_rate=estimate.rate,
        tension=estimate.tension,
        tension_sigma=estimate.sigma,
        tension_raw=measured.tension,
        tension_goal=command.tension,
        stretch_offset=estimate.offset,
        innovation=estimate.innovation,
        nis=estimate.nis,
        external_tension=estimate.external,
        motor_position=measured.travel / model.space.spool,
        motor_velocity=velocity,
        motor_torque=torque,
        motor_torque_goal=command.torque,
        motor_temperature=np.array([drive.temperature for drive in drives]),
        motor_age=np.array([_age(drive.feedback_t_ns, t_ns) for drive in drives]),
        drive_phase=np.array([float(drive.phase) for drive in drives]),
        tip_force=model.all_digits.tip_force(estimate.q, estimate.external),
        contact=np.array(state.progress.contact, dtype=np.float64),
    )


def _age(feedback_t_ns: int, t_ns: int) -> float:
    """Age of a feedback [s]; NaN if there never was one."""
    return (t_ns - feedback_t_ns) / 1e9 if feedback_t_ns >= 0 else math.nan
