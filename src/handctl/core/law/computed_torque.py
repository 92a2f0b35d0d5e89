"""Computed torque of a tendon-driven digit, and its tension loop.

Motion: the plan gives the joint torque by inverse dynamics, the torque gives tendon tensions, and the motor makes the
tension plus what its own inertia and friction need, and what corrects the way:

    f = allocate(M theta_d'' + h(theta_d, theta_d'))    f_0 = f / efficiency
    u = f_0 + (m_m + m_l) (k (s_d - s) + d (s_d' - v)) + c_i m_m s_d'' + c_f (b_m v + friction(s_d'))
        - c_d disturbance + K_f (f_0 - f_hat)

with excursions s = R_r theta, the cable's speed v at the spool, which damps the rotor and not the digit behind its
rope, and shares c of the gains. The rotor is some twenty times heavier than the finger m_l that it drives; the feedback
is to accelerate both. Hold: state feedback on tension error and cable speed, with a slow integral; where a way is
expected, its speed and the rotor's share of it are fed forward. Source: LQR of ``motion_design``.
"""

import math
from typing import NamedTuple

import numpy as np

from handctl.choose import chosen, nothing, only, zeros
from handctl.compiled import kernel
from handctl.core.estimation.estimator import Estimate
from handctl.core.estimation.statics import winding_efficiency
from handctl.core.law.allocation import bounded
from handctl.core.law.friction_band import look_ahead
from handctl.core.law.goal import DigitGoal
from handctl.core.law.goal_table import GoalTable, goal_table
from handctl.core.law.law_constants import MOTOR_FRICTION_SPEED, constants
from handctl.core.model import HandModel
from handctl.core.types import Vector
from handctl.hand.tendons import ROPE_FRICTION_SPEED

INTEGRAL_LIMIT_N = 8.0
"""Anti-windup: the tension integral never asks for more than this [N]."""


class LawState(NamedTuple):
    """What the law carries from tick to tick, (N,) each.

    Attributes:
        setpoint: present tension set-point of the tension loop [N].
        integral: its integral part [N].
        force: motor force at the cable that was commanded, friction taken off [N]: the filter's input.
        planned: tension that a moving digit will have a period from now [N]; 0 where nothing moves.
        rate: at which that changes until then [N/s]: the filter's other input.
        trim: motor force that still makes up for a change of gains [N]; None long after one.
        held: largest tension while safety holds [N]; None while it does not.
        friction_state: how far friction is developed, 1 winding, -1 paying out; NaN where nothing moves.
    """

    setpoint: Vector
    integral: Vector
    force: Vector
    planned: Vector
    rate: Vector
    trim: Vector | None = None
    held: Vector | None = None
    friction_state: Vector | None = None

    @staticmethod
    def initial(tendons: int) -> "LawState":
        """Nothing commanded."""
        return LawState.idle(np.zeros(tendons))

    @staticmethod
    def idle(tension: Vector) -> "LawState":
        """Nothing commanded while the ropes carry a tension (N,) [N]."""
        none = zeros(len(tension))
        return LawState(tension, none, none, none, none)


class Command(NamedTuple):
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

    @staticmethod
    def idle(model: HandModel) -> "Command":
        """Nothing."""
        n, joints = model.tendon_count, len(model.hand.joints)
        return Command(zeros(n), nothing(n), zeros(joints), nothing(joints), nothing(joints))


class Envelope(NamedTuple):
    """What bounds the motor forces while the hand relaxes.

    Attributes:
        ceiling: (N,) largest motor force at the cable [N]. The smallest is 0.
        open_loop: whether the ceiling itself is commanded, whatever is measured.
    """

    ceiling: Vector
    open_loop: bool

    def bound(self, force: Vector) -> Vector:
        """Return (N,) motor force within the envelope, for the one that the loop asks for [N]."""
        return self.ceiling if self.open_loop else _within(force, 0.0, self.ceiling)


def step(
    model: HandModel,
    state: LawState,
    estimate: Estimate,
    goals: tuple[DigitGoal, ...],
    t: float,
    most: Vector | None = None,
    held: Vector | None = None,
    envelope: Envelope | None = None,
) -> tuple[LawState, Command]:
    """One tick of the law for all digits.

    Args:
        model: the hand.
        state: from the last tick.
        estimate: of this instant.
        goals: per digit.
        t: time [s].
        most: (N,) tension that must not be exceeded now, besides the hand's own limits [N].
        held: (N,) the same while safety holds [N]; the place on the way is the goal then, its speed is not.
        envelope: of a hand that relaxes.
    """
    most = held if most is None else most if held is None else np.minimum(most, held)
    table = goal_table(model, goals)
    motion = _motion(model, estimate, table, t, most, held is not None)
    hold = _hold(model, state, estimate, table, t, most)
    force = table.chosen(motion.force, hold.force, 0.0)
    if state.trim is not None:
        force = force + table.chosen(state.trim, state.trim, 0.0)
    known = constants(model)
    asked = _within(force, known.unwind, known.limit)
    if most is not None:
        asked = np.minimum(asked, most + model.space.coulomb)
    if envelope is not None:
        asked = envelope.bound(asked)
    tension = table.chosen(motion.tension, hold.setpoint, np.nan)
    load = table.chosen(motion.load, hold.setpoint, 0.0)
    acting = asked - _motor_friction(model, estimate, asked)
    planned = (motion.load, motion.rate, motion.efficiency)
    ahead = look_ahead(model, state.planned, estimate, acting, *planned, table.moving)
    law = LawState(
        chosen(table.held, hold.setpoint, estimate.tension) if table.holds else estimate.tension,
        only(table.held, hold.integral),
        acting,
        ahead.planned,
        ahead.rate,
        None if state.trim is None else _faded(state.trim, model.period),
        held,
        ahead.friction_state,
    )
    return law, Command(asked * model.space.spool, tension, load.dot(model.hand.moment_arms), motion.q, motion.dq)


TRIM_TIME_S = 0.2
"""In which what makes up for a change of gains fades by a factor e [s]: slower than both loops, so that they follow."""
TRIM_LEAST_N = 1e-3
"""Trim below this is nothing [N]: a fiftieth of a torque count of the finest drive."""


def _faded(trim: Vector, period: float) -> Vector | None:
    """The trim of the next tick."""
    faded = trim * np.exp(-period / TRIM_TIME_S)
    return faded if float(np.abs(faded).max()) > TRIM_LEAST_N else None


def _motor_friction(model: HandModel, estimate: Estimate, asked: Vector) -> Vector:
    """(N,) what Coulomb friction takes on average of the force asked in the coming period [N].

    By the implicit midpoint rule: friction can stop a rotor within a period, but not turn it around.
    """
    known = constants(model)
    return _friction_of(asked, estimate.speed, estimate.tension, known.half, known.stopping, model.space.coulomb)


@kernel(*["vector"] * 6)
def _friction_of(
    asked: Vector, speed: Vector, tension: Vector, half: Vector, stopping: Vector, coulomb: Vector
) -> Vector:
    """Return (N,) friction of the motors [N]; see ``_motor_friction`` and ``Constants``."""
    friction = np.empty(len(asked))
    for n in range(len(asked)):
        coasting = speed[n] + half[n] * (asked[n] - tension[n])
        friction[n] = coulomb[n] * math.tanh(coasting / stopping[n])
    return friction


class _Motion(NamedTuple):
    """What computed torque asks, (N,) each; of no meaning for tendons that do not move. q, dq: (J,), NaN there.

    Attributes: efficiency: share of a tension that reaches the joints while the rope winds.
    """

    force: Vector
    tension: Vector
    load: Vector
    rate: Vector
    efficiency: Vector
    q: Vector
    dq: Vector


def _motion(
    model: HandModel, estimate: Estimate, table: GoalTable, t: float, most: Vector | None, frozen: bool
) -> _Motion:
    """Computed torque along the trajectories."""
    if not table.moves:
        return _Motion(*(table.target,) * 5, table.nothing, table.nothing)
    way = _way(model, table, t)
    if frozen:
        way[1:] = 0.0
    load = _load(model, table, way)
    excursion, rate, acceleration = way.dot(model.hand.moment_arms.T)
    known, gains, design = constants(model), model.gains.motion, model.motion
    feedback = design.stiffness * (excursion - estimate.excursion) + design.damping * (rate - estimate.speed)
    efficiency = winding_efficiency(model, way[0])
    passed = known.frictionless + known.friction * efficiency ** np.tanh(rate / ROPE_FRICTION_SPEED)
    ceiling = model.ceiling if most is None else np.minimum(model.ceiling, most)
    tension = _within(load / passed, model.floor, ceiling)
    force = (
        tension
        + known.mass * feedback
        + known.inertia * acceleration
        - known.rejection * estimate.motor_disturbance
        + gains.tension_feedback * (tension - estimate.tension)
        + known.damping * estimate.speed
        + known.coulomb * np.tanh(rate / MOTOR_FRICTION_SPEED)
    )
    q, dq = way[:2] if table.all_moving else np.where(table.known, way[:2], np.nan)
    return _Motion(force, tension, load, rate, efficiency, q, dq)


def _way(model: HandModel, table: GoalTable, t: float) -> Vector:
    """(3, J) angles [rad], rates [rad/s] and accelerations [rad/s^2] on the trajectories; zero for other digits."""
    coupling = model.all_digits.coupling
    if table.together:
        trajectory, since = table.together
        return np.asarray(trajectory.at(t - since).dot(coupling.T))
    way = np.zeros((3, coupling.shape[1]))
    for move in table.moves:
        way[:, move.coordinates] = move.trajectory.at(t - move.since)
    return np.asarray(way.dot(coupling.T))


def _load(model: HandModel, table: GoalTable, way: Vector) -> Vector:
    """(N,) tensions at the joints that make the motion's joint torques, as nearly as their bounds allow [N]."""
    q, dq, ddq = way.tolist()
    asked = [0.0] * len(q)
    for move in table.moves:
        own = move.digit.joints
        asked[own] = model.inverse(move.digit, q[own], dq[own], ddq[own])
    torque = np.array(asked)
    load: Vector = model.torque_to_tension.dot(torque)
    good = table.exact & (load >= model.floor) & (load <= model.ceiling)
    if np.count_nonzero(good) == len(good):
        return load
    if table.alone:
        return _within(load, model.floor, model.ceiling)
    fine = good.tolist()
    for move in table.moves:
        digit, tendons = move.digit, move.digit.tendons
        if False in fine[tendons]:
            wanted = torque[digit.joints].dot(digit.coupling)
            low, high = model.floor[tendons], model.ceiling[tendons]
            load[tendons] = bounded(digit.reduced_moment_arms, wanted, low, high, load[tendons])
    return load


def _within(values: Vector, low: Vector | float, high: Vector) -> Vector:
    """The values between two bounds; ``numpy.clip`` takes twice as long for a few."""
    return np.minimum(np.maximum(values, low), high)


class _Hold(NamedTuple):
    """What the tension loop asks, (N,) each; of no meaning for tendons that it does not have."""

    force: Vector
    setpoint: Vector
    integral: Vector


def _hold(
    model: HandModel, state: LawState, estimate: Estimate, table: GoalTable, t: float, most: Vector | None
) -> _Hold:
    """Tension loop."""
    if not table.holds:
        return _Hold(table.target, table.target, table.target)
    gains, design = model.gains.tension, model.motion
    target = table.target if most is None else np.minimum(table.target, most)
    setpoint = state.setpoint + _within(target - state.setpoint, -table.step, table.step)
    error = setpoint - estimate.tension
    integral = state.integral + gains.integral_per_s * model.period * error
    integral = np.minimum(np.maximum(integral, -INTEGRAL_LIMIT_N), INTEGRAL_LIMIT_N)
    np.putmask(integral, estimate.slack, 0.0)
    force = (
        setpoint
        + design.tension * error
        - design.tension_speed * estimate.speed
        + integral
        - constants(model).rejection * estimate.motor_disturbance
    )
    if np.count_nonzero(estimate.slack):  # no tension feeds back yet, and a small one does not turn a rotor at rest
        force = force + only(estimate.slack & (setpoint > 0.0), model.space.coulomb)
    if table.expected:
        force = force + _expected(model, table, t)
    return _Hold(_within(force, -table.limit, table.limit), setpoint, integral)


def _expected(model: HandModel, table: GoalTable, t: float) -> Vector:
    """(N,) motor force that held tendons need on the way on which they are expected [N]; zero for the others."""
    way = np.zeros((2, model.tendon_count))
    for digit, _, trajectory, since in table.expected:
        way[:, digit.tendons] = trajectory.at(t - since)[1:] @ digit.reduced_moment_arms.T
    space, (speed, acceleration) = model.space, way
    own = space.coulomb * np.tanh(speed / MOTOR_FRICTION_SPEED) + space.motor_mass * acceleration
    return np.asarray(own + (model.motion.tension_speed + space.motor_damping) * speed)
