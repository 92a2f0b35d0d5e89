"""Linear models of the motion loop and the tension loop of each tendon.

The models of the controller are finite differences of the controller's own code. The model of the
plant is computed from the hand file.

The finite differences call the same code as a tick of the controller. Therefore the linear models
follow every change in the code of the filter or the control law. Each tendon is treated alone, as
in the design of the gains. Friction is neglected, because its force is constant while a tendon
moves. In each tick, the controller uses the readings of the previous tick. The delay of the
readings by one tick represents the time for the transfer over the bus.

The control law is linearised without its limits. A control law at its limits would seem to have no
gain and unlimited margins. At the operating point the goals equal the estimates, and all errors are
zero.
"""

import enum
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm
from scipy.optimize import linprog

from handctl.controller.controller_state import layout_of_state
from handctl.core import state_block as s
from handctl.core import tick_stages
from handctl.core.block_schema import BlockArray, BlockLayout
from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.goal_writer import sample_trajectories, write_goals
from handctl.core.control_law.required_tensions import evaluate_goals, write_motor_torques
from handctl.core.control_law.trajectory import SampledTrajectory
from handctl.core.estimation.filter_prediction import FilterPrediction
from handctl.core.estimation.filter_types import TendonRegime
from handctl.core.hand_constants import HandConstants
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.hand.digit import DigitModel

Matrix = NDArray[np.float64]

CURRENT_LAG_S = 0.3e-3
"""Time constant of the first-order lag between commanded and actual torque of a drive [s].

Source: the current loops of drives have a bandwidth of about 500 Hz.
"""
OPERATING_TENSION_N = 20.0
"""Tension of the operating point, far from slack and from the limits [N]."""
OPERATING_SPEED_M_S = 0.015
"""Tendon speed of the operating point [m/s].

At the tendon speed of the operating point, friction does not depend on the speed.
"""
OPERATING_ANGLE_RAD = 0.6
"""Joint angle of the operating point, between the stops [rad]."""
DIFFERENCE_STEPS = {"travel": 1e-7, "tension": 1e-2, "state": 2.0**-14}
"""Steps of the finite differences: travel [m], tension [N], and states as a fraction of their typical size."""
UNREACHABLE_LIMIT = 1e12
"""Value for the limits of motor torque [N m] and force [N]. No gains lead to a command of this size."""
PLANNED_MOTION_TENSION_N = 1e4
"""Expected tension of a moving digit, chosen far outside of its friction band [N].

With so large an expected tension, the control law predicts the tension at the edge of the friction
band.
"""
MIN_LIMIT_DISTANCE = 0.1
"""Smallest distance of the operating point from the limits of a joint, as a fraction of the joint's range."""
CONSTANT_STATE_TOLERANCE = 1e-9
"""Largest coefficient of other states and inputs in the equation of a state that counts as constant."""


class LoopKind(enum.StrEnum):
    """Kind of a tendon's feedback loop, motion or tension."""

    MOTION = "motion"
    """Motion loop: the digit moves freely along a trajectory."""
    TENSION = "tension"
    """Tension loop: the digit is blocked, and the tendon holds a tension."""


@dataclass(frozen=True, slots=True)
class LinearSystem:
    """Linear system in discrete time, x' = A x + B u and y = C x + D u, where each step is one control period.

    Attributes:
        A: (n, n) state matrix.
        B: (n, m) input matrix.
        C: (p, n) output matrix.
        D: (p, m) feedthrough matrix.
        period: control period [s].
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    period: float

    def frequency_response(self, omega: Matrix) -> NDArray[np.complex128]:
        """Return the frequency response (len(omega),) of a system with one input and one output.

        By the determinant lemma, 1 + C (zI - A)^-1 B = det(zI - A + BC) / det(zI - A). The
        determinant of zI - A is the product of the differences between z and the eigenvalues of A.
        Therefore the eigenvalues of A - BC and of A give the response at all frequencies. Solving a
        system of equations for each frequency would take 20 times as long. For the packaged hands,
        the error of the frequency response is below 1e-9 of 1 + L.

        Args:
            omega: angular frequencies [rad/s].
        """
        # In the z-plane, the frequencies lie on the unit circle.
        z = np.exp(1j * omega * self.period)[:, None]
        poles = np.linalg.eigvals(self.A)
        poles_with_feedback = np.linalg.eigvals(self.A - self.B @ self.C)
        ratio = np.prod((z - poles_with_feedback) / (z - poles), axis=1)
        return np.asarray(ratio - 1.0 + self.D[0, 0])


@dataclass(frozen=True, slots=True)
class PlantFactors:
    """Linear parameters of a plant, as factors for the values in the hand file."""

    stiffness: float = 1.0
    damping: float = 1.0
    mass: float = 1.0
    spring: float = 1.0
    motor_inertia: float = 1.0
    torque_constant: float = 1.0


NOMINAL_FACTORS = PlantFactors()
"""Factors of a plant that equals the hand file."""


def plant_system(
    model: HandModel, tendon: int, kind: LoopKind, factors: PlantFactors = NOMINAL_FACTORS
) -> LinearSystem:
    """Return the linear system of rotor, tendon and digit, sampled at the control rate.

    The input is the commanded motor force [N]. The outputs are the travel [m], the tension [N] and
    the excursion [m].

    Args:
        model: model of the hand.
        tendon: index of the tendon.
        kind: kind of the loop, motion or tension. For a tension loop, the digit is blocked.
        factors: factors by which the values of the hand file are multiplied to get the parameters
            of the plant.

    Returns:
        The system has these states: travel, travel rate, excursion, excursion rate, motor force.
        For a blocked digit, the two states of the excursion are absent.

    Source: two masses on a spring, torque with a first-order lag, zero-order hold.
    """
    tendons = model.tendon_constants
    i = tendon
    m = tendons.motor_mass[i] * factors.motor_inertia
    b = tendons.motor_damping[i] * factors.damping
    k = tendons.stiffness[i] * factors.stiffness
    c = tendons.damping[i] * factors.damping
    tendon_force = np.array([k, c, -k, -c, 0.0])
    A = np.zeros((5, 5))
    B = np.zeros((5, 1))
    A[0, 1] = 1.0
    # By Newton's law, the motor force minus tension and friction accelerates the rotor.
    A[1] = -tendon_force / m
    A[1, 1] -= b / m
    A[1, 4] = 1.0 / m
    # The last state is the motor force, which follows the command as a first-order lag.
    A[4, 4], B[4, 0] = -1.0 / CURRENT_LAG_S, factors.torque_constant / CURRENT_LAG_S
    if kind == LoopKind.MOTION:
        load = tendons.load_mass[i] * factors.mass
        A[2, 3] = 1.0
        # By Newton's law, the tension accelerates the digit. All constants of the digit are
        # converted to the tendon.
        A[3] = tendon_force / load
        A[3, 2] -= tendons.load_stiffness[i] * factors.spring / load
        A[3, 3] -= tendons.load_damping[i] * factors.damping / load
    else:
        kept_states = [0, 1, 4]
        A = A[np.ix_(kept_states, kept_states)]
        B = B[kept_states]
        tendon_force = tendon_force[kept_states]
    n = len(A)
    # For a zero-order hold, the exponential of [[A, B], [0, 0]] contains both discrete matrices.
    discrete_matrices = expm(np.block([[A, B], [np.zeros((1, n + 1))]]) * model.period)
    C = np.zeros((3, n))
    C[0, 0] = 1.0
    C[1] = tendon_force
    if kind == LoopKind.MOTION:
        C[2, 2] = 1.0
    return LinearSystem(
        discrete_matrices[:n, :n], discrete_matrices[:n, n:], C, np.zeros((3, 1)), model.period
    )


def controller_system(model: HandModel, tendon: int, kind: LoopKind) -> LinearSystem:
    """Return the linear system of filter and control law of a tendon.

    The inputs are the measurements in the previous tick. The output is the commanded motor force
    [N].

    The measurements are the travel [m], the tension [N] and the excursion [m].

    Args:
        model: model of the hand.
        tendon: index of the tendon.
        kind: kind of the loop, motion or tension.
    """
    tick, state, reading, scale = _operating_point(model, tendon, kind)
    n = len(state)
    centre = tick(state, reading)
    columns = [
        _central_difference(partial(_tick_with_state, tick, state, reading, j), scale[j])
        for j in range(n)
    ]
    steps = (DIFFERENCE_STEPS["travel"], DIFFERENCE_STEPS["tension"], DIFFERENCE_STEPS["travel"])
    entries = [
        _central_difference(partial(_tick_with_reading, tick, state, reading, j), steps[j])
        for j in range(3)
    ]
    J = np.column_stack(columns)
    E = np.column_stack(entries)
    assert len(centre) == n + 1
    return LinearSystem(J[:n], E[:n], J[n:], E[n:], model.period)


def open_loop(
    model: HandModel, tendon: int, kind: LoopKind, factors: PlantFactors = NOMINAL_FACTORS
) -> LinearSystem:
    """Return the open loop of a tendon, see `connect_in_series`."""
    return connect_in_series(
        plant_system(model, tendon, kind, factors), controller_system(model, tendon, kind)
    )


def connect_in_series(P: LinearSystem, K: LinearSystem) -> LinearSystem:
    """Return the open loop L of a plant P and a controller K. The loop is cut at the motor force.

    The output of the open loop is the force that the controller commands, with the opposite sign.
    Because of the opposite sign, the margins follow from 1 + L.
    """
    K = _without_constants(K)
    p = len(P.A)
    n = len(K.A)
    y = len(P.C)
    A = np.zeros((p + y + n, p + y + n))
    A[:p, :p] = P.A
    A[p : p + y, :p] = P.C  # the rows below store the readings for the next tick
    A[p + y :, p : p + y] = K.B
    A[p + y :, p + y :] = (
        K.A
    )  # apart from the readings, the filter uses the force that was commanded last
    B = np.vstack([P.B, np.zeros((y + n, 1))])
    C = np.hstack([np.zeros((1, p)), K.D, K.C])
    return LinearSystem(A, B, -C, np.zeros((1, 1)), P.period)


def _without_constants(K: LinearSystem) -> LinearSystem:
    """Return a system without its constant states, such as a setpoint.

    Constant states never leave the operating point, and their poles at 1 do not affect the
    stability.
    """
    A = K.A - np.eye(len(K.A))
    B = K.B
    changing_states = np.flatnonzero(
        (np.abs(A).max(axis=1) > CONSTANT_STATE_TOLERANCE)
        | (np.abs(B).max(axis=1) > CONSTANT_STATE_TOLERANCE)
    )
    return LinearSystem(
        K.A[np.ix_(changing_states, changing_states)],
        K.B[changing_states],
        K.C[:, changing_states],
        K.D,
        K.period,
    )


_TickFunction = Callable[[Matrix, Matrix], Matrix]
"""Function that executes one tick of a tendon: from (state, reading) to an array of the next state and the force."""


def _central_difference(matrix_function: Callable[[float], Matrix], step: float) -> Matrix:
    """Return the central difference of a function."""
    return np.asarray((matrix_function(step) - matrix_function(-step)) / (2.0 * step))


def _tick_with_state(
    tick: _TickFunction, state: Matrix, reading: Matrix, j: int, deviation: float
) -> Matrix:
    """Execute a tick after a change of state j, and return the result."""
    moved_state = state.copy()
    moved_state[j] += deviation
    return tick(moved_state, reading)


def _tick_with_reading(
    tick: _TickFunction, state: Matrix, reading: Matrix, j: int, deviation: float
) -> Matrix:
    """Execute a tick after a change of reading j, and return the result."""
    shifted_reading = reading.copy()
    shifted_reading[j] += deviation
    return tick(state, shifted_reading)


FEEDBACK_STATE_ROWS = [
    *range(s.SPOOL_TRAVEL, s.STRETCH_OFFSET + 1),
    s.TENSION_SETPOINT,
    s.TENSION_INTEGRAL,
    s.FILTER_INPUT_FORCE,
    s.PLANNED_TENSION,
    s.PLANNED_TENSION_RATE,
]
"""Rows of the state block with the states of the feedback: first the filter states, then the control law states."""
MEASUREMENT_ROWS = [s.MEASURED_TRAVEL, s.MEASURED_TENSION, s.MEASURED_EXCURSION]
"""Rows of the state block that contain the measurements of a tendon."""
_TYPICAL_STATE_SIZES = 2.0 ** np.array([-17, -7, -17, -7, 0, 0, -17, 0, 0, 0, 0, 0])
"""Typical sizes of the states in `FEEDBACK_STATE_ROWS`, with which the finite differences are scaled.

All sizes are powers of two, so that the finite difference of a state that a tick only copies is
exactly one.
"""


class _LinearController:
    """Filter and linear control law of a hand.

    The filter and the control law read and write a state block, the array that contains the state
    of the controller.

    Attributes:
        model: model of the hand with its gains, without limits and without motor friction.
        layout: layout of the state block.
    """

    def __init__(self, model: HandModel) -> None:
        """Store the model, without limits and without motor friction."""
        unreachable_limits = np.full(model.tendon_count, UNREACHABLE_LIMIT)
        tendon_constants = replace(
            model.tendon_constants, coulomb_friction=np.zeros_like(unreachable_limits)
        )
        self.model = replace(
            model, torque_limit=unreachable_limits, tendon_constants=tendon_constants
        )
        self.layout: BlockLayout = layout_of_state(model, 1)
        # In a digit with more tendons than coordinates, one tension goal is always at the tension
        # floor. Feedback that lowers this tension raises all tensions of the digit instead, so that
        # the control law has a kink at the operating point. The raised tensions make no joint
        # torque, and are no part of the motion loop. The linear law therefore has no floor.
        floor = np.where(model.redundancy.has_surplus, -UNREACHABLE_LIMIT, model.floor)
        self._constants = HandConstants(self.model, {"floor": floor})
        self._constant_args = self._constants.block, self._constants.layout.offsets
        self._prediction = FilterPrediction(self.model, self.layout)

    def run_filter(self, block: BlockArray) -> None:
        """Execute the correction and the prediction of the filter.

        The filter detects no contact, because the mode ARMING is set before the correction, and no
        motor makes torque in this mode.
        """
        self.layout.view(block, "mode")[...] = HandMode.ARMING
        tick_stages.correct_tension_estimate(block, self.layout.offsets, *self._constant_args)
        self._prediction.predict(block)
        tick_stages.conclude_estimate(block, self.layout.offsets, *self._constant_args)

    def run_control_law(self, block: BlockArray) -> None:
        """Compute the torque commands from the goals and the estimates."""
        self.layout.view(block, "mode")[...] = HandMode.ACTIVE
        hand_args = self.model, self.layout, self._constants, block
        write_motor_torques(*hand_args, evaluate_goals(*hand_args))


@functools.lru_cache(maxsize=4)
def _linear_controller(model: HandModel) -> _LinearController:
    """Return the linear controller of a model. All loops of a hand use the same controller."""
    return _LinearController(model)


def _operating_point(
    model: HandModel, tendon: int, kind: LoopKind
) -> tuple[_TickFunction, Matrix, Matrix, Matrix]:
    """Return four things: a tendon's tick function, the state and the readings at the operating point, and step sizes.

    The step sizes belong to the finite differences. Each state and each reading has a step size.
    """
    controller = _linear_controller(model)
    operating_point = _operating_point_state(controller, tendon, kind)

    def run_linear_tick(values: Matrix, reading: Matrix) -> Matrix:
        block = operating_point.copy()
        table = controller.layout.table(block, "tendon")
        table[FEEDBACK_STATE_ROWS, tendon] = values
        table[MEASUREMENT_ROWS, tendon] = reading
        controller.run_filter(block)
        controller.run_control_law(block)
        return np.append(
            table[FEEDBACK_STATE_ROWS, tendon],
            table[s.COMMANDED_TORQUE, tendon] / model.tendon_constants.spool_radius[tendon],
        )

    table = controller.layout.table(operating_point, "tendon")
    return (
        run_linear_tick,
        table[FEEDBACK_STATE_ROWS, tendon].copy(),
        table[MEASUREMENT_ROWS, tendon].copy(),
        _TYPICAL_STATE_SIZES * DIFFERENCE_STEPS["state"],
    )


def _operating_point_state(
    controller: _LinearController, tendon: int, kind: LoopKind
) -> BlockArray:
    """Return the state block at the operating point of a loop.

    Every digit is half closed, and every tendon is taut. For a motion loop, the motor winds the
    tendon up. For a tension loop, the tendon is at rest. All control errors are zero.
    """
    model = controller.model
    layout = controller.layout
    moving = kind == LoopKind.MOTION
    coordinates = [_half_closed_coordinates(digit) for digit in model.digits]
    rates = [
        _winding_rates(model, d, tendon, OPERATING_SPEED_M_S if moving else 0.0)
        for d in range(len(model.digits))
    ]
    q = np.concatenate(
        [
            digit.coupling @ position
            for digit, position in zip(model.digits, coordinates, strict=True)
        ]
    )
    dq = np.concatenate(
        [digit.coupling @ position for digit, position in zip(model.digits, rates, strict=True)]
    )
    block = layout.initial.copy()
    table = layout.table(block, "tendon")
    digits = [digit.with_moment_arms_at(q[digit.joints]) for digit in model.digits]
    table[s.EXCURSION] = np.concatenate(
        [digit.excursion_at_angles(q[digit.joints]) for digit in digits]
    )
    table[s.SPOOL_TRAVEL] = (
        table[s.EXCURSION] + OPERATING_TENSION_N / model.tendon_constants.stiffness
    )
    table[s.SPOOL_SPEED] = table[s.EXCURSION_RATE] = (
        block_diag(*(digit.moment_arms for digit in digits)) @ dq
    )
    table[s.FILTER_INPUT_FORCE] = table[s.MEASURED_TENSION] = OPERATING_TENSION_N
    table[s.MEASURED_TRAVEL] = table[s.SPOOL_TRAVEL]
    is_joint_measured = np.isfinite(_joint_gain(model))
    table[s.MEASURED_EXCURSION] = np.where(is_joint_measured, table[s.EXCURSION], math.nan)
    layout.view(block, "regime")[...] = TendonRegime.FREE if moving else TendonRegime.HELD
    layout.view(block, "stopped")[...] = 0
    layout.view(block, "planned_contact")[...] = not moving
    layout.view(block, "started")[...] = 1
    estimated = block.copy()
    controller.run_filter(estimated)
    reached_values = layout.table(estimated, "tendon")
    table[s.TENSION_SETPOINT] = reached_values[s.TENSION]
    table[s.PLANNED_TENSION] = PLANNED_MOTION_TENSION_N if moving else OPERATING_TENSION_N
    goals = tuple(_hold_goal(tendons) for tendons in model.digit_tendons)
    if moving:
        goals = tuple(
            _move_goal(
                digit,
                position,
                rate,
                reached_values[s.EXCURSION, digit.tendons],
                reached_values[s.SPOOL_SPEED, digit.tendons],
                tendon - digit.tendons.start,
            )
            for digit, position, rate in zip(model.digits, coordinates, rates, strict=True)
        )
    write_goals(model, layout, block, goals)
    sample_trajectories(model, layout, block, goals, 0.0)
    return block


def _half_closed_coordinates(digit: DigitModel) -> Matrix:
    """Return coordinates (n_c,) at which all joints of a digit are well inside their ranges [rad].

    If the coupling and the joint limits allow the angle `OPERATING_ANGLE_RAD`, all joints have this
    angle. Otherwise the returned coordinates are those of the point that is farthest from all joint
    limits.
    """
    low = digit.joint_min
    high = digit.joint_max
    position: Matrix = digit.joints_to_coordinates @ np.full(digit.joint_count, OPERATING_ANGLE_RAD)
    joints = digit.coupling @ position
    margin = MIN_LIMIT_DISTANCE * (high - low)
    if np.all(joints >= low + margin) and np.all(joints <= high - margin):
        return position
    count = digit.coupling.shape[1]
    joint_range = (high - low)[:, None]
    solution = linprog(
        np.append(np.zeros(count), -1.0),
        A_ub=np.block([[digit.coupling, joint_range], [-digit.coupling, joint_range]]),
        b_ub=np.concatenate([high, -low]),
        bounds=[(None, None)] * count + [(None, 0.5)],
    )
    return position if solution.x is None else np.asarray(solution.x[:count])


def _winding_rates(model: HandModel, d: int, tendon: int, speed: float) -> Matrix:
    """Return the coordinate rates (n_c,) at which a digit winds up one tendon with a given speed [m/s].

    The index ``tendon`` is an index in the hand. If the tendon does not belong to digit ``d``, all
    tendons of this digit are wound up at the given speed.
    """
    digit = model.digits[d]
    arms = digit.with_moment_arms_at(
        digit.coupling @ _half_closed_coordinates(digit)
    ).reduced_moment_arms
    i = tendon - digit.tendons.start
    if 0 <= i < len(arms):
        return np.asarray(arms[i] * speed / (arms[i] @ arms[i]))
    return np.asarray(np.linalg.pinv(arms) @ np.full(len(arms), speed))


def _joint_gain(model: HandModel) -> Matrix:
    """Return a vector (N,) with 1 or NaN for each tendon.

    The value of a tendon is 1 if joint encoders measure the excursion of the tendon.
    """
    is_joint_measured = [
        bool(np.any(blocks[TendonRegime.FREE].K[:, 2])) for blocks in model.filter_design.blocks
    ]
    return np.where(is_joint_measured, 1.0, math.nan)


def _hold_goal(tendons: slice) -> DigitGoal:
    """Return a goal that keeps the tension of the operating point."""
    n = tendons.stop - tendons.start
    return DigitGoal(
        GoalKind.TENSION,
        tension=np.full(n, OPERATING_TENSION_N),
        rate=0.0,
        force_limit=UNREACHABLE_LIMIT,
    )


def _move_goal(
    digit: DigitModel,
    position: Matrix,
    goal_rate: Matrix,
    reached_excursion: Matrix,
    speed: Matrix,
    i: int,
) -> DigitGoal:
    """Return a motion goal equal to the estimated excursion [m] and speed [m/s] of tendon i of a digit."""
    q = digit.coupling @ position
    arms = digit.with_moment_arms_at(q).reduced_moment_arms
    if 0 <= i < len(arms):
        direction = arms[i] / (arms[i] @ arms[i])
        position = position + direction * (reached_excursion[i] - digit.excursion_at_angles(q)[i])
        goal_rate = goal_rate + direction * (speed[i] - arms[i] @ goal_rate)
    return DigitGoal(
        GoalKind.MOTION, SampledTrajectory(position, goal_rate, np.zeros_like(position))
    )
