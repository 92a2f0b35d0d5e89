"""Joint angles of digits with fewer tendons than joints, with their standard deviation.

Excursions fix the joint angles of a digit up to the null space of its moment arms. A free digit takes its coupling,
q = B theta. In contact it does not: the object turns the joints against each other, by the torque of the contact times
the compliance that the springs leave in the null space, N (N^T K N)^-1 N^T. The torque's size is measured (tension that
nothing explains), its place on the digit is not. The estimate is the mean over places: the middle of each link, the
tip, and all joints alike. What these places differ by is the standard deviation, together with

- the tension that the model errs by anyway, at each of these places,
- capstan friction, which changes its sign with the direction of motion,
- the free digit's own error: springs and gravity that do not fit its coupling,
- the excursion's error.

Joint encoders, where there are any, are fused with that as a prior (Kalman update with the prior's full covariance).
Digits with as many tendons as joints have no null space: their angles are those of the excursions.
"""

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, null_space

from handctl.controller.estimator import Estimate
from handctl.controller.model import HandModel
from handctl.controller.types import Vector
from handctl.drives.sensors.node import JOINT_STEP_RAD
from handctl.hand.digit import DigitModel

MODEL_ERROR_N = 0.5
"""Tension that the model errs by in free motion, standard deviation [N]: friction and springs as told."""
MODEL_ERROR = 0.15
"""The same as a fraction of the unexplained tension."""
STRETCH_ERROR = 0.03
"""Error of the tendons' stiffness, as a fraction: it turns stretch into excursion."""
FRICTION_FRACTION = 0.5
"""Standard deviation of what friction turns the joints by, as a fraction of what fully developed friction would."""
LEVER_LEAST_M2 = 1e-8
"""Smallest square of a lever [m^2]: a place without any (all joints alike) turns nothing."""
SPRING_LEAST = 1e-3
"""Smallest spring stiffness in the null space [N m/rad]; beyond it the joints' ranges limit the deviation anyway."""
READING_LIMIT_S = 0.1
"""Age from which on a joint encoder's reading is not used [s]."""
ADVANCE_ERROR = 1.0
"""Error of the rate by which a reading is advanced to the present, as a fraction: the rate is the free digit's."""
TURN_LEAST_RAD = 1e-9
"""Turn below which a joint's range limits nothing [rad]."""
RELEASE_S = 0.15
"""Time constant in which the effect of a contact fades: friction holds the joints where they are for a while [s]."""
UPDATE_S, SMOOTH_S = 8e-3, 20e-3
"""Period of the estimate in the null space, and time constant of its turn [s]."""


class Readings(NamedTuple):
    """Latest joint encoder readings, (J,) each.

    Attributes:
        angle: [rad]; NaN without encoder.
        age: time since the reading [s]; inf without encoder.
    """

    angle: Vector
    age: Vector

    @staticmethod
    def of(joints: int, latest: list[tuple[int, float, int]], t_ns: int) -> "Readings":
        """Gather readings.

        Args:
            joints: J.
            latest: joint index, angle [rad] and time of reception [ns] of each.
            t_ns: present time [ns].
        """
        angle, age = np.full(joints, math.nan), np.full(joints, math.inf)
        for index, value, heard_ns in latest:
            angle[index] = value
            age[index] = (t_ns - heard_ns) / 1e9
        return Readings(angle, age)


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Constants of a hand with J joints, N tendons and H places of contact per digit.

    Attributes:
        free: whether any digit has a null space.
        reads: whether any joint of such a digit has an encoder.
        every: ticks from one estimate in the null space to the next.
        share: of a new turn in the smoothed one. kept: fraction of a contact that is left after a tick.
        tendon_digits: (N,) index of each tendon's digit.
        compliance: (J, J), joint angles per joint torque in the null space [rad/(N m)].
        ahead: (H, J, J), angles from each link to the one that is touched, from joint angles.
        reach: (H, J, J), distance along each link that a force at the place acts over, per joint [m].
        spread: (J, J), B B^T, joint torques in the digits' coordinates and back.
        torque: (J, N), spread times R^T: joint torque of tensions in the digits' coordinates [m].
        weight: (H, J), probability of each place.
        members: (J, J), 1 where two joints are of one digit.
        loose: (J,), whether a joint's digit has a null space.
        low, high: (J,) joint range [rad].
        starts: first joint of each digit. digit_of: (J,) index of each joint's digit.
        rubbed: (N, J), moment arms times capstan coefficient [m].
        path: (N, J, J), joint angles that a tendon has wrapped up to each joint: 1 where it passes.
        noise: (J,) variance of a joint encoder's reading [rad^2].
        excursion_noise: (N,) variance of an excursion beside that of the stretch [m^2].
    """

    free: bool
    reads: bool
    every: int
    share: float
    kept: float
    tendon_digits: list[int]
    compliance: Vector
    ahead: Vector
    reach: Vector
    spread: Vector
    torque: Vector
    weight: Vector
    members: Vector
    loose: NDArray[np.bool_]
    low: Vector
    high: Vector
    starts: list[int]
    digit_of: list[int]
    rubbed: Vector
    path: Vector
    noise: Vector
    excursion_noise: Vector


class Posture(NamedTuple):
    """Joint angles beside those of the free digit; what a tick hands to the next.

    Attributes:
        pressed: (D,) tension of contact [N]: rises at once, falls within ``RELEASE_S``.
        turn: (J,) joint angles by which contact turns the digits [rad].
        sigma: (J,) standard deviation of that [rad].
    """

    pressed: Vector
    turn: Vector
    sigma: Vector

    @staticmethod
    @functools.lru_cache(maxsize=16)
    def initial(model: HandModel) -> "Posture":
        """Nothing known: each joint anywhere in its range."""
        return Posture(np.zeros(len(model.digits)), np.zeros(len(model.hand.joints)), range_sigma(model))


class Angles(NamedTuple):
    """Estimated joint angles, (J,) each.

    Attributes:
        q: [rad].
        sigma: standard deviation [rad].
    """

    q: Vector
    sigma: Vector


def step(
    model: HandModel,
    before: Posture,
    estimate: Estimate,
    touched: Vector,
    k: int,
    readings: Readings | None = None,
) -> tuple[Posture, Angles]:
    """Estimate the joint angles of one tick.

    Args:
        model: the hand.
        before: from the last tick.
        estimate: of this instant, with the free digits' angles.
        touched: (D,) tension that nothing explains, smoothed [N].
        k: number of the tick.
        readings: of joint encoders; None for a hand without.
    """
    known, free = places(model), estimate.q
    stretch = (estimate.tension * STRETCH_ERROR) ** 2 + estimate.sigma**2
    spread = model.excursion_to_joints * np.sqrt(known.excursion_noise + stretch / model.space.stiffness**2)
    by_excursion = (spread * spread).sum(axis=1)
    if not known.free:
        return before, Angles(free, np.sqrt(by_excursion))
    state = before._replace(pressed=np.maximum(touched, before.pressed * known.kept))
    columns = None
    if k % known.every == 0:
        columns, turn = _columns(model, known, state, estimate)
        state = state._replace(turn=turn, sigma=np.sqrt((columns * columns).sum(axis=0)))
    sigma = np.minimum(np.sqrt(state.sigma**2 + by_excursion), range_sigma(model))
    angles = Angles(free + state.turn, sigma)
    if columns is None or readings is None or not known.reads:
        return state, angles
    return state, _fused(known, angles, np.concatenate((columns, spread.T)), readings, estimate.dq)


def _columns(model: HandModel, known: Places, state: Posture, estimate: Estimate) -> tuple[Vector, Vector]:
    """Deviations (C, J) [rad] whose squares add up to the covariance in the null space, and the turn (J,) [rad].

    The levers are those at the last estimate, which makes the ticks the iterations of a fixed point.
    """
    free, external = estimate.q, state.pressed[known.tendon_digits]
    turns, doubt = _turned(known, free, free + state.turn, external)
    turn = state.turn + known.share * ((known.weight * turns).sum(axis=0) - state.turn)
    columns = np.concatenate((doubt, _free_errors(model, known, free, estimate.tension)))
    room = _room(known, free, np.concatenate((columns, -columns)))
    columns = columns * np.maximum(room[: len(columns)], room[len(columns) :])
    return np.concatenate((np.sqrt(known.weight) * (turns - turn), columns)), turn


def tip_force_sigma(model: HandModel, angles: Angles, external: Vector, tension_sigma: Vector) -> Vector:
    """Standard deviation of tip-equivalent forces, (D,) [N], by the angles' and the tensions' deviations.

    Args:
        model: the hand.
        angles: of the joints.
        external: (N,) tension that nothing explains [N].
        tension_sigma: (N,) standard deviation of the tension [N].
    """
    digits = model.all_digits
    tried = np.vstack((angles.q, angles.q + np.diag(angles.sigma)))
    lever = np.cos(tried.dot(digits.ahead.T)).dot(digits.reach)
    square = (lever * lever).dot(digits.members.T)
    force = (lever * external.dot(digits.arms)).dot(digits.members.T) / square
    error = np.sqrt(tension_sigma**2 + MODEL_ERROR_N**2 + (MODEL_ERROR * external) ** 2)
    by_tension = (lever[0] * digits.arms * error[:, None]).dot(digits.members.T) / square[0]
    return np.asarray(np.sqrt(((force[1:] - force[0]) ** 2).sum(axis=0) + (by_tension * by_tension).sum(axis=0)))


def _turned(known: Places, free: Vector, q: Vector, external: Vector) -> tuple[Vector, Vector]:
    """Joint angles by which a contact at each place turns a digit, and by which the tension's error does.

    Args:
        known: constants of the hand.
        free: (J,) angles of the free digit [rad].
        q: (J,) angles at which levers are taken [rad].
        external: (N,) tension of contact [N].

    Returns:
        (H, J) [rad] each.
    """
    torque = known.torque.dot(external)
    error = known.torque.dot(np.hypot(MODEL_ERROR_N, MODEL_ERROR * external))
    lever = np.matmul(known.reach, np.cos(known.ahead.dot(q))[:, :, None])[:, :, 0]
    unit = lever / np.maximum((lever * lever.dot(known.spread)).dot(known.members), LEVER_LEAST_M2)
    turns = -((lever * torque).dot(known.members) * unit).dot(known.compliance)
    doubt = np.sqrt(known.weight) * ((lever * error).dot(known.members) * unit).dot(known.compliance)
    return turns * _room(known, free, turns), doubt


def _free_errors(model: HandModel, known: Places, free: Vector, tension: Vector) -> Vector:
    """(2, J) joint angles by which friction, and springs and gravity beside the coupling, turn a free digit [rad]."""
    wrapped = model.wrap[:, None] + known.path.dot(free)
    friction = FRICTION_FRACTION * tension.dot(known.rubbed * wrapped)
    return np.asarray(np.stack((friction, model.all_digits.static_torque(free))).dot(known.compliance))


def _room(known: Places, q: Vector, turns: Vector) -> Vector:
    """(C, J) fraction, 0 to 1, of turns (C, J) [rad] that the joints' ranges leave at q (J,); the same for a digit.

    A digit's turn is shortened as a whole, so that its excursion stays.
    """
    room = np.where(turns > 0.0, known.high - q, q - known.low)
    fraction = np.maximum(room, 0.0) / np.maximum(np.abs(turns), TURN_LEAST_RAD)
    least = np.asarray(np.minimum.reduceat(fraction, known.starts, axis=1))
    return np.asarray(np.minimum(least[:, known.digit_of], 1.0))


def _fused(known: Places, prior: Angles, columns: Vector, readings: Readings, rate: Vector) -> Angles:
    """Correct a prior by joint encoders.

    Args:
        known: constants of the hand.
        prior: of excursions and contact.
        columns: (C, J) deviations whose squares add up to the prior's covariance [rad].
        readings: of the joint encoders.
        rate: (J,) joint rates [rad/s].
    """
    read = np.flatnonzero(known.loose & (readings.age < READING_LIMIT_S))
    if not len(read):
        return prior
    moved = rate * np.where(readings.age < READING_LIMIT_S, readings.age, 0.0)
    covariance = columns.T.dot(columns) * known.members
    noise = (known.noise + (ADVANCE_ERROR * moved) ** 2)[read]
    gain = np.linalg.solve(covariance[np.ix_(read, read)] + np.diag(noise), covariance[read]).T
    q = prior.q + gain.dot((readings.angle + moved - prior.q)[read])
    variance = np.maximum(np.diagonal(covariance) - (gain * covariance[:, read]).sum(axis=1), 0.0)
    return Angles(q, np.where(known.loose, np.sqrt(variance), prior.sigma))


@functools.lru_cache(maxsize=16)
def range_sigma(model: HandModel) -> Vector:
    """(J,) standard deviation of an angle that may be anywhere in its range [rad]."""
    span = np.concatenate([digit.joint_max - digit.joint_min for digit in model.digits])
    return np.asarray(span / math.sqrt(12.0))


@functools.lru_cache(maxsize=16)
def places(model: HandModel) -> Places:
    """Constants of a hand."""
    digits, hand, arms = model.digits, model.hand, model.hand.moment_arms
    sizes = [digit.joint_count for digit in digits]
    compliance = block_diag(*(_compliance(digit) for digit in digits))
    spread = block_diag(*(digit.coupling @ digit.coupling.T for digit in digits))
    ahead, reach, weight = (np.stack(parts) for parts in zip(*_every_place(digits), strict=True))
    read = np.array([joint in hand.sensor_node.joints for joint in hand.joints])
    covered = ~((arms != 0.0) & ~read).any(axis=1)
    reads = bool((compliance.any(axis=1) & read).any())
    every = 1 if reads else max(1, round(UPDATE_S / model.period))
    noise = hand.sensor_node.joint_noise_rad**2 + JOINT_STEP_RAD**2 / 12.0
    return Places(
        free=bool(compliance.any()),
        reads=reads,
        every=every,
        share=-math.expm1(-every * model.period / SMOOTH_S),
        kept=math.exp(-model.period / RELEASE_S),
        tendon_digits=list(model.digit_of),
        compliance=compliance,
        ahead=ahead,
        reach=reach,
        spread=spread,
        torque=spread @ arms.T,
        weight=weight,
        members=block_diag(*(np.ones((size, size)) for size in sizes)),
        loose=compliance.any(axis=1) & read,
        low=np.concatenate([digit.joint_min for digit in digits]),
        high=np.concatenate([digit.joint_max for digit in digits]),
        starts=[digit.joints.start for digit in digits],
        digit_of=[d for d, size in enumerate(sizes) for _ in range(size)],
        rubbed=arms * model.friction[:, None],
        path=model.pulleys[:, None, :] * np.tri(arms.shape[1]),
        noise=np.full(arms.shape[1], noise),
        excursion_noise=np.where(covered, noise * (arms**2).sum(axis=1), (2.0 * model.gains.filter.offset_m) ** 2),
    )


def _compliance(digit: DigitModel) -> Vector:
    """(n, n) joint angles per joint torque at constant excursion, N (N^T K N)^-1 N^T [rad/(N m)]."""
    free = null_space(digit.moment_arms)
    if not free.shape[1]:
        return np.zeros((digit.joint_count, digit.joint_count))
    stiffness = np.diag(np.maximum(digit.spring_stiffness, SPRING_LEAST))
    return np.asarray(free @ np.linalg.solve(free.T @ stiffness @ free, free.T))


def _every_place(digits: tuple[DigitModel, ...]) -> list[tuple[Vector, Vector, Vector]]:
    """For each place: (J, J) angles ahead, (J, J) distances [m] and (J,) probability; the last place is none."""
    most = max(digit.joint_count for digit in digits)
    found = []
    for place in range(most + 2):
        parts = [_place(digit, place, place == most + 1) for digit in digits]
        ahead, reach = (block_diag(*(part[i] for part in parts)) for i in (0, 1))
        found.append((ahead, reach, np.concatenate([part[2] for part in parts])))
    return found


def _place(digit: DigitModel, place: int, alike: bool) -> tuple[Vector, Vector, Vector]:
    """One place on a digit: the middle of a link, the tip after the last one, or all joints alike."""
    n = digit.joint_count
    ahead, reach = np.zeros((n, n)), np.zeros((n, n))
    if place > n and not alike:
        return ahead, reach, np.zeros(n)
    if not alike:
        touched = min(place, n - 1)
        lengths = np.array(digit.lengths)
        lengths[touched] *= 1.0 if place == n else 0.5
        for link in range(touched + 1):
            ahead[link, link + 1 : touched + 1] = 1.0
            reach[: link + 1, link] = lengths[link]
    return ahead, reach, np.full(n, 1.0 / (n + 2))
