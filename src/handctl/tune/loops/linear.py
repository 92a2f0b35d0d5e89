"""Both loops as linear systems: the controller differentiated where it runs, the plant from the hand file.

The controller's matrices are finite differences of the very stages that a tick calls, so whatever changes in the
filter or the law changes here too. Each tendon is taken by itself, as the gains are designed. Friction is left out: in
motion it is saturated and has no slope. The delay is the bus's: a tick acts on samples of the tick before.

The linear law is differentiated, not the limits around it. A force at its limit has no slope, and the loop of a
saturated law looks as if it had no gain and every margin. So the motor's limits are taken away, and the goals are put
where the estimate of the operating point is, which makes every feedback error there zero.
"""

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import linprog

from handctl.controller.state import layout_of
from handctl.core import block as s
from handctl.core import stages
from handctl.core.estimation.filter_stack import Regime
from handctl.core.estimation.prediction import predict
from handctl.core.hand_constants import HandConstants
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.law.goals import sample, write_goals
from handctl.core.law.loads import write_loads
from handctl.core.law.trajectory import Sample
from handctl.core.model import HandModel
from handctl.core.schema import Block, Layout
from handctl.core.types import Mode
from handctl.hand.digit import DigitModel

Matrix = NDArray[np.float64]

CURRENT_LAG_S = 0.3e-3
"""First-order lag of a drive's torque. Source: current loops of some 500 Hz, as all three protocols' drives have."""
TENSION_N = 20.0
"""Operating point: tension, far from slack and from the limits."""
SPEED_M_S = 0.015
"""Operating point: cable speed at which friction is saturated."""
ANGLE_RAD = 0.6
"""Operating point: joint angle, between the stops."""
STEP = {"travel": 1e-7, "tension": 1e-2, "state": 2.0**-14}
"""Steps of the differences [m], [N], and as a share of what a state usually is."""
UNLIMITED = 1e12
"""Motor torque [N m] and force [N] that no gains ask for: the linear law has no limits."""
DEVELOPED_N = 1e4
"""Expected tension of a moving digit, far beyond its friction band: the expectation is at the band's edge."""
INSIDE = 0.1
"""Distance of the operating point from a joint's limits, as a share of its range, at least."""
CONSTANT = 1e-9
"""Largest coefficient by which anything else changes a state that is a constant."""


class LoopKind(enum.StrEnum):
    """Which feedback loop of a tendon."""

    MOTION = "motion"
    """The digit moves freely along a trajectory."""
    TENSION = "tension"
    """The digit is blocked and the tendon holds a tension."""


@dataclass(frozen=True, slots=True)
class System:
    """A discrete linear system x' = A x + B u, y = C x + D u, over one control period.

    Attributes:
        A: (n, n). B: (n, m). C: (p, n). D: (p, m).
        period: [s].
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    period: float

    def response(self, omega: Matrix) -> NDArray[np.complex128]:
        """Frequency response (len(omega), p, m) at angular frequencies [rad/s]."""
        z = np.exp(1j * omega * self.period)
        inverse = np.linalg.solve(z[:, None, None] * np.eye(len(self.A)) - self.A, self.B.astype(complex))
        return np.asarray(self.C @ inverse + self.D)


@dataclass(frozen=True, slots=True)
class PlantFactors:
    """How a real plant differs from its hand file: factors on what the linear plant is made of."""

    stiffness: float = 1.0
    damping: float = 1.0
    mass: float = 1.0
    spring: float = 1.0
    motor_inertia: float = 1.0
    torque_constant: float = 1.0


NOMINAL = PlantFactors()
"""As the hand file says."""


def plant(model: HandModel, tendon: int, kind: LoopKind, factors: PlantFactors = NOMINAL) -> System:
    """Rotor, rope and digit of one tendon, sampled: motor force [N] to travel [m], tension [N] and excursion [m].

    Args:
        model: the hand.
        tendon: index.
        kind: of loop; in TENSION the digit is blocked.
        factors: what is different from the hand file.

    Source: two masses on a rope; torque with a first-order lag; zero-order hold.
    """
    space, i = model.space, tendon
    m, b = space.motor_mass[i] * factors.motor_inertia, space.motor_damping[i] * factors.damping
    k, c = space.stiffness[i] * factors.stiffness, space.damping[i] * factors.damping
    rope = np.array([k, c, -k, -c, 0.0])
    A, B = np.zeros((5, 5)), np.zeros((5, 1))
    A[0, 1] = 1.0
    A[1] = -rope / m
    A[1, 1] -= b / m
    A[1, 4] = 1.0 / m
    A[4, 4], B[4, 0] = -1.0 / CURRENT_LAG_S, factors.torque_constant / CURRENT_LAG_S
    if kind == LoopKind.MOTION:
        load = space.load_mass[i] * factors.mass
        A[2, 3] = 1.0
        A[3] = rope / load
        A[3, 2] -= space.load_stiffness[i] * factors.spring / load
        A[3, 3] -= space.load_damping[i] * factors.damping / load
    else:
        keep = [0, 1, 4]
        A, B, rope = A[np.ix_(keep, keep)], B[keep], rope[keep]
    n = len(A)
    held = expm(np.block([[A, B], [np.zeros((1, n + 1))]]) * model.period)
    C = np.zeros((3, n))
    C[0, 0], C[1] = 1.0, rope
    if kind == LoopKind.MOTION:
        C[2, 2] = 1.0
    return System(held[:n, :n], held[:n, n:], C, np.zeros((3, 1)), model.period)


def controller(model: HandModel, tendon: int, kind: LoopKind) -> System:
    """Filter and law of one tendon: travel [m], tension [N], excursion [m] of the tick before to motor force [N].

    Args:
        model: the hand.
        tendon: index.
        kind: of loop.
    """
    tick, state, reading, scale = _operating_point(model, tendon, kind)
    n, centre = len(state), tick(state, reading)
    columns = [_slope(partial(_at, tick, state, reading, j), scale[j]) for j in range(n)]
    steps = (STEP["travel"], STEP["tension"], STEP["travel"])
    entries = [_slope(partial(_with, tick, state, reading, j), steps[j]) for j in range(3)]
    J, E = np.column_stack(columns), np.column_stack(entries)
    assert len(centre) == n + 1
    return System(J[:n], E[:n], J[n:], E[n:], model.period)


def loop(model: HandModel, tendon: int, kind: LoopKind, factors: PlantFactors = NOMINAL) -> System:
    """The loop of one tendon; see ``joined``."""
    return joined(plant(model, tendon, kind, factors), controller(model, tendon, kind))


def joined(P: System, K: System) -> System:
    """The loop of a plant and a controller, broken at the motor's force: what comes back for a force that goes in.

    Negative feedback is taken out of it, so that margins are read from 1 + L.
    """
    K = _without_constants(K)
    p, n, y = len(P.A), len(K.A), len(P.C)
    A = np.zeros((p + y + n, p + y + n))
    A[:p, :p] = P.A
    A[p : p + y, :p] = P.C  # the samples that the next tick acts on
    A[p + y :, p : p + y] = K.B
    A[p + y :, p + y :] = K.A  # the filter hears of the force that its own law commands
    B = np.vstack([P.B, np.zeros((y + n, 1))])
    C = np.hstack([np.zeros((1, p)), K.D, K.C])
    return System(A, B, -C, np.zeros((1, 1)), P.period)


def _without_constants(K: System) -> System:
    """Return a system without the states that nothing changes, such as a set-point.

    Their deviation is zero for ever, and their poles at one say nothing about stability.
    """
    A, B = K.A - np.eye(len(K.A)), K.B
    kept = np.flatnonzero((np.abs(A).max(axis=1) > CONSTANT) | (np.abs(B).max(axis=1) > CONSTANT))
    return System(K.A[np.ix_(kept, kept)], K.B[kept], K.C[:, kept], K.D, K.period)


_Tick = Callable[[Matrix, Matrix], Matrix]
"""(state, reading) to (next state, force): one tick of one tendon as a function of flat vectors."""


def _slope(function: Callable[[float], Matrix], step: float) -> Matrix:
    """Central difference."""
    return np.asarray((function(step) - function(-step)) / (2.0 * step))


def _at(tick: _Tick, state: Matrix, reading: Matrix, j: int, step: float) -> Matrix:
    moved = state.copy()
    moved[j] += step
    return tick(moved, reading)


def _with(tick: _Tick, state: Matrix, reading: Matrix, j: int, step: float) -> Matrix:
    moved = reading.copy()
    moved[j] += step
    return tick(state, moved)


ROWS = [*range(s.TRAVEL, s.STRETCH_OFFSET + 1), s.SETPOINT, s.INTEGRAL, s.FORCE, s.PLANNED, s.RATE]
"""Rows of a tendon that take part in the feedback: what the filter carries from tick to tick, then the law."""
READ = [s.MEASURED_TRAVEL, s.MEASURED_TENSION, s.MEASURED_EXCURSION]
"""Rows of its measurements."""
_USUAL = 2.0 ** np.array([-17, -7, -17, -7, 0, 0, -17, 0, 0, 0, 0, 0])
"""Size of the states in ``ROWS``, by which the differences are scaled.

Powers of two: the difference of a state that is only copied is then exactly one.
"""


class _Bench:
    """Filter and linear law of a hand on a block of its state.

    Attributes:
        model: the hand; the law has its gains, and neither limits nor friction of the motors.
        layout: of the block.
    """

    def __init__(self, model: HandModel) -> None:
        unlimited = np.full(model.tendon_count, UNLIMITED)
        space = replace(model.space, coulomb=np.zeros_like(unlimited))
        self.model = replace(model, torque_limit=unlimited, space=space)
        self.layout: Layout = layout_of(model, 1)
        self._constants = HandConstants(self.model, {})
        self._known = self._constants.block, self._constants.layout.places

    def estimate(self, block: Block) -> None:
        """Take in the measurements and predict; no torque acts yet, so that no touch is felt."""
        self.layout.view(block, "mode")[...] = Mode.ARMING
        stages.correct(block, self.layout.places, *self._known)
        predict(self.model, self.layout, block)
        stages.conclude(block, self.layout.places, *self._known)

    def act(self, block: Block) -> None:
        """Command the torques that the goals and the estimate require."""
        self.layout.view(block, "mode")[...] = Mode.ACTIVE
        write_loads(self.model, self.layout, self._constants, block)
        stages.act(block, self.layout.places, *self._known, 0.0, 0, 1)


def _operating_point(model: HandModel, tendon: int, kind: LoopKind) -> tuple[_Tick, Matrix, Matrix, Matrix]:
    """The tick of one tendon about a point, that point's state and reading, and the step of each state."""
    bench = _Bench(model)
    point = _point(bench, tendon, kind)

    def tick(values: Matrix, reading: Matrix) -> Matrix:
        block = point.copy()
        table = bench.layout.table(block, "tendon")
        table[ROWS, tendon], table[READ, tendon] = values, reading
        bench.estimate(block)
        bench.act(block)
        return np.append(table[ROWS, tendon], table[s.TORQUE, tendon] / model.space.spool[tendon])

    table = bench.layout.table(point, "tendon")
    return tick, table[ROWS, tendon].copy(), table[READ, tendon].copy(), _USUAL * STEP["state"]


def _point(bench: _Bench, tendon: int, kind: LoopKind) -> Block:
    """Every digit half closed, every tendon taut, one of them winding (motion) or at rest (tension), without error."""
    model, layout, moving = bench.model, bench.layout, kind == LoopKind.MOTION
    coordinates = [_half_closed(digit) for digit in model.digits]
    rates = [_winding(model, d, tendon, SPEED_M_S if moving else 0.0) for d in range(len(model.digits))]
    q = np.concatenate([digit.coupling @ own for digit, own in zip(model.digits, coordinates, strict=True)])
    dq = np.concatenate([digit.coupling @ own for digit, own in zip(model.digits, rates, strict=True)])
    block = layout.initial.copy()
    table = layout.table(block, "tendon")
    table[s.EXCURSION] = model.hand.moment_arms @ q
    table[s.TRAVEL] = table[s.EXCURSION] + TENSION_N / model.space.stiffness
    table[s.SPEED] = table[s.EXCURSION_RATE] = model.hand.moment_arms @ dq
    table[s.FORCE] = table[s.MEASURED_TENSION] = TENSION_N
    table[s.MEASURED_TRAVEL] = table[s.TRAVEL]
    seen = np.isfinite(_joint_gain(model))
    table[s.MEASURED_EXCURSION] = np.where(seen, model.hand.moment_arms @ q, math.nan)
    layout.view(block, "regime")[...] = Regime.FREE if moving else Regime.HELD
    layout.view(block, "stopped")[...] = 0
    layout.view(block, "planned_contact")[...] = not moving
    layout.view(block, "started")[...] = 1
    estimated = block.copy()
    bench.estimate(estimated)
    reached = layout.table(estimated, "tendon")
    table[s.SETPOINT], table[s.PLANNED] = reached[s.TENSION], DEVELOPED_N if moving else TENSION_N
    goals = tuple(_hold(tendons) for tendons in model.digit_tendons)
    if moving:
        goals = tuple(
            _move(
                digit,
                own,
                rate,
                reached[s.EXCURSION, digit.tendons],
                reached[s.SPEED, digit.tendons],
                tendon - digit.tendons.start,
            )
            for digit, own, rate in zip(model.digits, coordinates, rates, strict=True)
        )
    write_goals(model, layout, block, goals)
    sample(model, layout, block, goals, 0.0)
    return block


def _half_closed(digit: DigitModel) -> Matrix:
    """(n_c,) coordinates of a digit at which all its joints are inside their ranges [rad].

    All joints at ``ANGLE_RAD`` where the coupling has such a point, else the point farthest from all limits.
    """
    low, high = digit.joint_min, digit.joint_max
    own: Matrix = digit.joints_to_coordinates @ np.full(digit.joint_count, ANGLE_RAD)
    joints, margin = digit.coupling @ own, INSIDE * (high - low)
    if np.all(joints >= low + margin) and np.all(joints <= high - margin):
        return own
    count, span = digit.coupling.shape[1], (high - low)[:, None]
    found = linprog(
        np.append(np.zeros(count), -1.0),
        A_ub=np.block([[digit.coupling, span], [-digit.coupling, span]]),
        b_ub=np.concatenate([high, -low]),
        bounds=[(None, None)] * count + [(None, 0.5)],
    )
    return own if found.x is None else np.asarray(found.x[:count])


def _winding(model: HandModel, d: int, tendon: int, speed: float) -> Matrix:
    """(n_c,) rates of a digit's coordinates at which its tendons wind, the one asked for at a speed [m/s]."""
    digit = model.digits[d]
    arms, i = digit.reduced_moment_arms, tendon - digit.tendons.start
    if 0 <= i < len(arms):
        return np.asarray(arms[i] * speed / (arms[i] @ arms[i]))
    return np.asarray(np.linalg.pinv(arms) @ np.full(len(arms), speed))


def _joint_gain(model: HandModel) -> Matrix:
    """(N,) 1 where joint encoders give a tendon's excursion, NaN where they do not."""
    seen = [bool(np.any(blocks[Regime.FREE].K[:, 2])) for blocks in model.filter.blocks]
    return np.where(seen, 1.0, math.nan)


def _hold(tendons: slice) -> DigitGoal:
    n = tendons.stop - tendons.start
    return DigitGoal(Kind.TENSION, tension=np.full(n, TENSION_N), rate=0.0, force_limit=UNLIMITED)


def _move(digit: DigitModel, own: Matrix, rate: Matrix, reached: Matrix, wound: Matrix, i: int) -> DigitGoal:
    """A way that is, for the digit's tendon i, where its estimate is: excursion [m] and cable speed [m/s]."""
    arms = digit.reduced_moment_arms
    if 0 <= i < len(arms):
        towards = arms[i] / (arms[i] @ arms[i])
        own, rate = own + towards * (reached[i] - arms[i] @ own), rate + towards * (wound[i] - arms[i] @ rate)
    return DigitGoal(Kind.MOTION, Sample(own, rate, np.zeros_like(own)))
