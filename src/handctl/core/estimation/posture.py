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

from handctl.compiled import inner, kernel, square
from handctl.core.estimation.estimator import Estimate
from handctl.core.model import HandModel
from handctl.core.types import Vector
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
        starts: (D + 1,) first joint of each digit, and J.
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
    tendon_digits: NDArray[np.int64]
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
    starts: NDArray[np.int64]
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
    spread, by_excursion = _by_excursion(
        estimate.tension, estimate.sigma, model.space.stiffness, known.excursion_noise, model.excursion_to_joints
    )
    if not known.free:
        return before, Angles(free, np.sqrt(by_excursion))
    state, columns = before._replace(pressed=np.maximum(touched, before.pressed * known.kept)), None
    if k % known.every == 0:
        columns, state = _columns(model, known, state, estimate)
    angles = Angles(*_angles(free, state.turn, state.sigma, by_excursion, range_sigma(model)))
    if columns is None or readings is None or not known.reads:
        return state, angles
    return state, _fused(known, angles, np.concatenate((columns, spread.T)), readings, estimate.dq)


def _columns(model: HandModel, known: Places, state: Posture, estimate: Estimate) -> tuple[Vector, Posture]:
    """Deviations (C, J) [rad] whose squares add up to the covariance in the null space, and the turn after this tick.

    The levers are those at the last estimate, which makes the ticks the iterations of a fixed point.
    """
    free = estimate.q
    external = state.pressed[known.tendon_digits]
    turns, doubt = _turned(
        free, free + state.turn, known.torque, external, known.ahead, known.reach, known.spread, known.compliance,
        known.starts, known.low, known.high,
    )  # fmt: skip
    static = model.all_digits.static_torque(free)
    errors = _free_errors(free, estimate.tension, known.rubbed, model.wrap, known.path, static, known.compliance)
    columns, turn, sigma = _combined(
        free, state.turn, turns, doubt, errors, known.weight, known.share, known.starts, known.low, known.high
    )
    return columns, state._replace(turn=turn, sigma=sigma)


@kernel("vector", "vector", "vector", "vector", "matrix")
def _by_excursion(
    tension: Vector, sigma: Vector, stiffness: Vector, noise: Vector, excursion_to_joints: Vector
) -> tuple[Vector, Vector]:
    """Return (J, N) deviations of the joint angles by each tendon's excursion [rad], and their squares' sums (J,)."""
    joints, tendons = excursion_to_joints.shape
    spread, total = np.zeros((joints, tendons)), np.zeros(joints)
    for n in range(tendons):
        stretch = square(tension[n] * STRETCH_ERROR) + square(sigma[n])
        excursion = math.sqrt(noise[n] + stretch / square(stiffness[n]))
        for j in range(joints):
            spread[j, n] = excursion_to_joints[j, n] * excursion
            total[j] += square(spread[j, n])
    return spread, total


@kernel("vector", "vector", "vector", "vector", "vector")
def _angles(
    free: Vector, turn: Vector, turn_sigma: Vector, by_excursion: Vector, most: Vector
) -> tuple[Vector, Vector]:
    """Return (J,) joint angles and their standard deviations [rad], at most those of a joint anywhere in its range."""
    sigma = np.empty(len(free))
    for j in range(len(free)):
        sigma[j] = min(math.sqrt(square(turn_sigma[j]) + by_excursion[j]), most[j])
    return free + turn, sigma


@kernel("vector", "vector", "matrix", "vector", "cube", "cube", "matrix", "matrix", "counts", "vector", "vector")
def _turned(
    free: Vector,
    q: Vector,
    torque_of: Vector,
    external: Vector,
    ahead: Vector,
    reach: Vector,
    spread: Vector,
    compliance: Vector,
    starts: NDArray[np.int64],
    low: Vector,
    high: Vector,
) -> tuple[Vector, Vector]:
    """Joint angles by which a contact at each place turns a digit, and by which the tension's error does.

    Args:
        free: (J,) angles of the free digit [rad].
        q: (J,) angles at which levers are taken [rad].
        torque_of: (J, N) torques in the digits' coordinates, of tensions [m].
        external: (N,) tension of contact [N].
        ahead, reach, spread, compliance, starts, low, high: see ``Places``.

    Returns:
        (H, J) [rad] each.
    """
    count, joints = ahead.shape[0], len(q)
    turns, doubt = np.zeros((count, joints)), np.zeros((count, joints))
    torque, error = np.zeros(joints), np.zeros(joints)
    for j in range(joints):
        for n in range(len(external)):
            torque[j] += torque_of[j, n] * external[n]
            error[j] += torque_of[j, n] * math.sqrt(square(MODEL_ERROR_N) + square(MODEL_ERROR * external[n]))
    for place in range(count):
        lever = _levers(q, ahead[place], reach[place].T)
        for digit in range(len(starts) - 1):
            first, end = starts[digit], starts[digit + 1]
            size, work, work_error = 0.0, 0.0, 0.0
            for j in range(first, end):
                work += lever[j] * torque[j]
                work_error += lever[j] * error[j]
                for other in range(first, end):
                    size += lever[j] * spread[j, other] * lever[other]
            size = max(size, LEVER_LEAST_M2)
            # Tension that nothing explains is positive where the object pushes the digit open.
            turns[place, first:end] = -work / size * _given_way(lever, compliance, first, end)
            doubt[place, first:end] = work_error / size * _given_way(lever, compliance, first, end)
            _shorten(turns[place], free, first, end, low, high)
    return turns, doubt


@inner
def _levers(q: Vector, ahead: Vector, reach: Vector) -> Vector:
    """Return levers of a force on each digit about C joints or coordinates, (C,) [m], at joint angles q (J,) [rad].

    Args:
        q: joint angles. ahead: (J, J) angles from each link to the one that is touched.
        reach: (J, C) distance along each link that the force acts over [m].
    """
    levers = np.zeros(reach.shape[1])
    for link in range(len(q)):
        angle = 0.0
        for j in range(len(q)):
            angle += ahead[link, j] * q[j]
        for c in range(len(levers)):
            levers[c] += math.cos(angle) * reach[link, c]
    return levers


@inner
def _given_way(lever: Vector, compliance: Vector, first: int, end: int) -> Vector:
    """Return by what a digit's joints turn under a force of 1 N at a place with levers (J,) [m], [rad/N]."""
    turn = np.zeros(end - first)
    for j in range(first, end):
        for other in range(first, end):
            turn[j - first] += lever[other] * compliance[other, j]
    return turn


@inner
def _room(turn: Vector, sign: float, q: Vector, first: int, end: int, low: Vector, high: Vector) -> float:
    """Return the fraction, 0 to 1, of a digit's turn (J,) [rad] that its joints' ranges leave at q (J,)."""
    least = 1.0
    for j in range(first, end):
        way = sign * turn[j]
        room = max(high[j] - q[j] if way > 0.0 else q[j] - low[j], 0.0)
        least = min(least, room / max(abs(way), TURN_LEAST_RAD))
    return least


@inner
def _shorten(turn: Vector, q: Vector, first: int, end: int, low: Vector, high: Vector) -> None:
    """Shorten a digit's turn to what its joints' ranges leave: as a whole, so that its excursion stays."""
    room = _room(turn, 1.0, q, first, end, low, high)
    for j in range(first, end):
        turn[j] *= room


@kernel("vector", "vector", "matrix", "vector", "cube", "vector", "matrix")
def _free_errors(
    free: Vector, tension: Vector, rubbed: Vector, wrap: Vector, path: Vector, static: Vector, compliance: Vector
) -> Vector:
    """Joint angles by which friction, and springs and gravity beside the coupling, turn a free digit, (2, J) [rad].

    Args:
        free: (J,) angles of the free digit [rad]. tension: (N,) [N].
        rubbed, path, compliance: see ``Places``.
        wrap: (N,) angle that each tendon has wrapped before the first joint [rad].
        static: (J,) torques of gravity and springs [N m].
    """
    joints = len(free)
    torque, turn = np.zeros((2, joints)), np.zeros((2, joints))
    for j in range(joints):
        torque[1, j] = static[j]
        for n in range(len(tension)):
            if rubbed[n, j] != 0.0:
                wrapped = wrap[n]
                for other in range(joints):
                    wrapped += path[n, j, other] * free[other]
                torque[0, j] += FRICTION_FRACTION * tension[n] * rubbed[n, j] * wrapped
    for row in range(2):
        for j in range(joints):
            for other in range(joints):
                turn[row, j] += torque[row, other] * compliance[other, j]
    return turn


@kernel("vector", "vector", "matrix", "matrix", "matrix", "matrix", "real", "counts", "vector", "vector")
def _combined(
    free: Vector,
    before: Vector,
    turns: Vector,
    doubt: Vector,
    errors: Vector,
    weight: Vector,
    share: float,
    starts: NDArray[np.int64],
    low: Vector,
    high: Vector,
) -> tuple[Vector, Vector, Vector]:
    """Combine the places of contact and the free digit's errors.

    Args:
        free: (J,) angles of the free digit [rad].
        before: (J,) turn of the last tick [rad].
        turns, doubt: (H, J) turns for each place, and their deviation [rad].
        errors: (2, J) of the free digit [rad].
        weight, share, starts, low, high: see ``Places``.

    Returns:
        (2 H + 2, J) deviations [rad], (J,) mean turn [rad], smoothed, and (J,) its standard deviation [rad].
    """
    count, joints = turns.shape
    columns, turn, sigma = np.empty((2 * count + 2, joints)), np.empty(joints), np.zeros(joints)
    for j in range(joints):
        mean = 0.0
        for place in range(count):
            mean += weight[place, j] * turns[place, j]
        turn[j] = before[j] + share * (mean - before[j])
        for place in range(count):
            root = math.sqrt(weight[place, j])
            columns[place, j] = root * (turns[place, j] - turn[j])
            columns[count + place, j] = root * doubt[place, j]
        columns[2 * count, j], columns[2 * count + 1, j] = errors[0, j], errors[1, j]
    for row in range(count, 2 * count + 2):
        for digit in range(len(starts) - 1):
            first, end = starts[digit], starts[digit + 1]
            forth = _room(columns[row], 1.0, free, first, end, low, high)
            back = _room(columns[row], -1.0, free, first, end, low, high)
            for j in range(first, end):
                columns[row, j] *= max(forth, back)
    for row in range(2 * count + 2):
        for j in range(joints):
            sigma[j] += square(columns[row, j])
    return columns, turn, np.sqrt(sigma)


@kernel("vector", "vector", "vector", "vector", "matrix", "matrix", "matrix", "matrix")
def tip_forces(
    q: Vector,
    q_sigma: Vector,
    external: Vector,
    tension_sigma: Vector,
    ahead: Vector,
    reach: Vector,
    members: Vector,
    arms: Vector,
) -> tuple[Vector, Vector]:
    """Return tip-equivalent forces of all digits, and their standard deviations by those of angles and tensions.

    See ``tip.tip_force``.

    Args:
        q, q_sigma: (J,) joint angles and their standard deviations [rad].
        external: (N,) tension balanced by contact [N]. tension_sigma: (N,) standard deviation of the tensions [N].
        ahead, reach, members, arms: see ``AllDigits``.

    Returns:
        (D,) forces and (D,) standard deviations [N].
    """
    digits, coordinates = members.shape
    torque, variance = np.zeros(coordinates), np.zeros(digits)
    for c in range(coordinates):
        for n in range(len(external)):
            torque[c] += external[n] * arms[n, c]
    lever, tried = _levers(q, ahead, reach), q.copy()
    size = _pressed(lever, lever, members)
    force = _pressed(lever, torque, members) / size
    for j in range(len(q)):
        tried[j] = q[j] + q_sigma[j]
        turned = _levers(tried, ahead, reach)
        change = _pressed(turned, torque, members) / _pressed(turned, turned, members) - force
        variance += change * change
        tried[j] = q[j]
    for n in range(len(external)):
        error = math.sqrt(square(tension_sigma[n]) + square(MODEL_ERROR_N) + square(MODEL_ERROR * external[n]))
        change = _pressed(lever, arms[n], members) * error / size
        variance += change * change
    return force, np.sqrt(variance)


@inner
def _pressed(lever: Vector, torque: Vector, members: Vector) -> Vector:
    """Return the sums of lever times torque (C,) over each digit's coordinates, (D,)."""
    sums = np.zeros(len(members))
    for d in range(len(members)):
        for c in range(len(lever)):
            sums[d] += members[d, c] * lever[c] * torque[c]
    return sums


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
        tendon_digits=np.array(model.digit_of, dtype=np.int64),
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
        starts=np.cumsum([0, *sizes]),
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
