"""Computed torque of a tendon-driven digit, and its tension loop.

Motion: the wanted acceleration, feedback included, gives the joint torque by inverse dynamics, the torque gives tendon
tensions, and the motor makes the tension plus its own inertia and friction:

    a = theta_d'' + K_v (theta_d' - theta') + K_p (theta_d - theta)
    f = allocate(M theta_d'' + h(theta, theta'))        f_0 = f / efficiency
    u = f_0 + m_m R_r a + b_m v + friction - disturbance + K_f (f_0 - f_hat)

The rotor is some twenty times heavier than the finger it drives, so the feedback acceleration goes to the rotor's
inertia. Hold: state feedback on tension error and cable speed, with a slow integral; where a way is expected, its speed
and the rotor's share of it are fed forward. Source: LQR of ``motion_design``.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.controller.allocation import allocate
from handctl.controller.estimator import Estimate
from handctl.controller.goal import DigitGoal, Kind
from handctl.controller.model import HandModel
from handctl.controller.statics import tendon_efficiency
from handctl.controller.types import Vector
from handctl.hand.dynamics import DigitModel, required_torque

FRICTION_SPEED = 2.5e-3
"""Cable speed at which motor friction is taken as fully developed [m/s]: 0.5 rad/s at a 5 mm spool."""
INTEGRAL_LIMIT_N = 8.0
"""Anti-windup: the tension integral never asks for more than this [N]."""


@dataclass(frozen=True, slots=True)
class LawState:
    """What the law carries from tick to tick, (N,) each.

    Attributes:
        setpoint: present tension set-point of the tension loop [N].
        integral: its integral part [N].
        force: motor force at the cable that was commanded, friction taken off [N]: the filter's input.
    """

    setpoint: Vector
    integral: Vector
    force: Vector

    @staticmethod
    def initial(tendons: int) -> "LawState":
        """Nothing commanded."""
        return LawState(np.zeros(tendons), np.zeros(tendons), np.zeros(tendons))


@dataclass(frozen=True, slots=True)
class Command:
    """What the law decided.

    Attributes:
        torque: (N,) motor torque [N m].
        tension: (N,) tension goal at the load cells [N].
        joint_torque: (J,) [N m].
        q, dq: (J,) goal [rad], [rad/s]; NaN for a digit in the tension loop.
    """

    torque: Vector
    tension: Vector
    joint_torque: Vector
    q: Vector
    dq: Vector


def step(
    model: HandModel, state: LawState, estimate: Estimate, goals: tuple[DigitGoal, ...], t: float
) -> tuple[LawState, Command]:
    """One tick of the law for all digits.

    Args:
        model: the hand.
        state: from the last tick.
        estimate: of this instant.
        goals: per digit.
        t: time [s].
    """
    motion, moving = _motion(model, estimate, goals, t)
    hold, held = _hold(model, state, estimate, goals, t)
    force = np.where(moving, motion.force, np.where(held, hold.force, 0.0))
    limit = model.torque_limit / model.space.spool
    asked = np.clip(force, -UNWIND_SHARE * limit, limit)
    tension = np.where(moving, motion.tension, np.where(held, hold.setpoint, np.nan))
    load = np.where(moving, motion.load, np.where(held, hold.setpoint, 0.0))
    law = LawState(
        setpoint=np.where(held, hold.setpoint, estimate.tension),
        integral=np.where(held, hold.integral, 0.0),
        force=asked - _motor_friction(model, estimate, asked),
    )
    return law, Command(asked * model.space.spool, tension, load @ model.hand.moment_arms, motion.q, motion.dq)


def _motor_friction(model: HandModel, estimate: Estimate, asked: Vector) -> Vector:
    """(N,) what Coulomb friction takes on average of the force asked in the coming period [N].

    By the implicit midpoint rule: friction can stop a rotor within a period, but not turn it around.
    """
    half = 0.5 * model.period / model.space.motor_mass
    coasting = estimate.speed + half * (asked - estimate.tension)
    return model.space.coulomb * np.tanh(coasting / (FRICTION_SPEED + half * model.space.coulomb))


UNWIND_SHARE = 0.3
"""Share of the torque limit that may be used to pay out: enough to brake the rotor, little to throw rope off."""


class _Motion(NamedTuple):
    """What computed torque asks, (N,) each; of no meaning for tendons that do not move. q, dq: (J,), NaN there."""

    force: Vector
    tension: Vector
    load: Vector
    q: Vector
    dq: Vector


def _motion(
    model: HandModel, estimate: Estimate, goals: tuple[DigitGoal, ...], t: float
) -> tuple[_Motion, NDArray[np.bool_]]:
    """Computed torque along the trajectories, and whose (N,)."""
    n, joints = model.tendon_count, len(model.hand.joints)
    moving, load = np.zeros(n, dtype=bool), np.zeros(n)
    way, known = np.zeros((3, joints)), np.zeros(joints, dtype=bool)
    for digit, tendons, goal in zip(model.digits, model.digit_tendons, goals, strict=True):
        if goal.kind != Kind.MOTION or goal.trajectory is None:
            continue
        way[:, digit.joints] = np.array(goal.trajectory.at(t - goal.since)) @ digit.coupling.T
        load[tendons] = _load(model, digit, tendons, required_torque(digit, *way[:, digit.joints].tolist()))
        moving[tendons] = known[digit.joints] = True
    if not known.any():
        nothing = np.full(joints, np.nan)
        return _Motion(load, load, load, nothing, nothing), moving
    excursion, rate, acceleration = way @ model.hand.moment_arms.T
    space, gains, design = model.space, model.gains.motion, model.motion
    feedback = design.stiffness * (excursion - estimate.excursion) + design.damping * (rate - estimate.speed)
    tension = np.clip(load / tendon_efficiency(model, way[0], rate), model.floor, model.ceiling)
    force = (
        tension
        + (space.motor_mass + space.load_mass) * feedback
        + space.motor_mass * acceleration
        + space.motor_damping * estimate.speed
        - gains.disturbance_rejection * estimate.motor_disturbance
        + gains.tension_feedback * (tension - estimate.tension)
        + space.coulomb * np.tanh(rate / FRICTION_SPEED)
    )
    q, dq = np.where(known, way[:2], np.nan)
    return _Motion(force, tension, load, q, dq), moving


def _load(model: HandModel, digit: DigitModel, tendons: slice, torque: tuple[float, ...]) -> Vector:
    """(n_t,) tensions at a digit's joints that make a joint torque (n,), as nearly as their bounds allow [N]."""
    arms, floor, ceiling = digit.reduced_moment_arms, model.floor[tendons], model.ceiling[tendons]
    tension = digit.torque_to_tension @ torque
    if arms.shape[0] == arms.shape[1] and (tension >= floor).all() and (tension <= ceiling).all():
        return tension
    return allocate(arms, digit.coupling.T @ torque, floor, ceiling)[0]


class _Hold(NamedTuple):
    """What the tension loop asks, (N,) each; of no meaning for tendons that it does not have."""

    force: Vector
    setpoint: Vector
    integral: Vector


def _hold(
    model: HandModel, state: LawState, estimate: Estimate, goals: tuple[DigitGoal, ...], t: float
) -> tuple[_Hold, NDArray[np.bool_]]:
    """Tension loop, and of which tendons (N,)."""
    n = model.tendon_count
    held, target, rate, limit = np.zeros(n, dtype=bool), np.zeros(n), np.zeros(n), np.zeros(n)
    way = np.zeros((2, n))
    for digit, tendons, goal in zip(model.digits, model.digit_tendons, goals, strict=True):
        if goal.kind == Kind.TENSION and goal.tension is not None:
            held[tendons], target[tendons] = True, goal.tension
            rate[tendons], limit[tendons] = goal.rate, goal.force_limit
            if goal.trajectory is not None:
                way[:, tendons] = np.array(goal.trajectory.at(t - goal.since)[1:]) @ digit.reduced_moment_arms.T
    if not held.any():
        return _Hold(target, target, target), held
    gains, design, space = model.gains.tension, model.motion, model.space
    (speed, acceleration), step_limit = way, rate * model.period
    target = np.clip(target, 0.0, model.ceiling)
    setpoint = state.setpoint + np.clip(target - state.setpoint, -step_limit, step_limit)
    error = setpoint - estimate.tension
    integral = state.integral + gains.integral_per_s * model.period * error
    integral = np.clip(np.where(estimate.slack, 0.0, integral), -INTEGRAL_LIMIT_N, INTEGRAL_LIMIT_N)
    force = (
        setpoint
        + design.tension * error
        - design.tension_speed * (estimate.speed - speed)
        + space.coulomb * np.tanh(speed / FRICTION_SPEED)
        + space.motor_mass * acceleration
        + space.motor_damping * speed
        + integral
        - model.gains.motion.disturbance_rejection * estimate.motor_disturbance
    )
    return _Hold(np.clip(force, -limit, limit), setpoint, integral), held
