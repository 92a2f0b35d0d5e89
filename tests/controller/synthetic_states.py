"""Generate estimates, measurements and controller states of a hand, as inputs for tests.

Tests use the generated estimates instead of results of the tension filter.

``ControllerState`` is the complete state of a controller between two ticks. ``SyntheticEstimate``
and ``SensorReadings`` are the parts of a controller's state that a test generates.
``state_with_estimate`` writes an estimate into a controller's state, and ``estimate_from_state``
reads the estimate from a controller's state.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from handctl.compiled import kernel
from handctl.controller.controller_state import ControllerState
from handctl.controller.tick import Controller
from handctl.core import state_block as s
from handctl.core import tick_stages
from handctl.core.block_schema import BlockArray, TableOffsets
from handctl.core.constants import ConstantTables, constant_tables
from handctl.core.estimation import kalman
from handctl.core.estimation.filter_types import STATE_COUNT, S, V, W, X
from handctl.core.estimation.statics import winding_efficiency
from handctl.core.hand_model import HandModel
from handctl.core.state_block import state_tables
from handctl.core.tick_types import HandMode
from handctl.programs.live_session import LiveProgram
from tests.controller.controller_bench import uncommissioned_controller

SLACK_REGIME = 2


class SensorReadings(NamedTuple):
    """Measurements of one tick. A missing measurement is NaN.

    Each array whose shape is not stated has one value for each tendon.

    Attributes:
        travel: spool travel, from the motor encoder [m].
        tension: load-cell reading minus the tare of the load cell [N].
        excursion: tendon excursion, from the joint encoders [m].
        joints: (joints,) joint angles, read by the joint encoders [rad].
        saturated_tendons: tendons whose load cell is at an end of its range.
    """

    travel: np.ndarray
    tension: np.ndarray
    excursion: np.ndarray
    joints: np.ndarray
    saturated_tendons: tuple[int, ...] = ()


class SyntheticEstimate(NamedTuple):
    """Estimate of the present state of a hand.

    The attributes of this class have the same names as the attributes of
    ``handctl.core.hand_estimate.HandEstimate``.
    """

    tension: np.ndarray
    tension_sigma: np.ndarray
    travel: np.ndarray
    tendon_speed: np.ndarray
    excursion: np.ndarray
    excursion_rate: np.ndarray
    motor_disturbance: np.ndarray
    external_tension: np.ndarray
    stretch_offset: np.ndarray
    cell_error: np.ndarray
    innovation: np.ndarray
    nis: np.ndarray
    is_slack: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    q_sigma: np.ndarray
    contact_force: np.ndarray
    grip_opening: np.ndarray
    grip_travel: np.ndarray

    def largest_grip_opening(
        self, closing_sign: np.ndarray, held_tension: np.ndarray
    ) -> tuple[int, float]:
        """Return the index and the grip opening [m] of the tendon whose grip has opened furthest.

        Tendons that hold no tension are left out.
        """
        openings = np.where(np.isnan(held_tension), 0.0, closing_sign * self.grip_opening).clip(0.0)
        worst_tendon = int(openings.argmax())
        return worst_tendon, float(openings[worst_tendon])


STATE_FIELD_BY_ATTRIBUTE = {
    "tension_sigma": "sigma",
    "tendon_speed": "speed", "motor_disturbance": "disturbance",
    "external_tension": "external",
    "contact_force": "grown",
}  # fmt: skip
"""Field of the state block for each attribute of an estimate that has another name in the block."""
DERIVED_ATTRIBUTES = ("is_slack", "grip_opening", "grip_travel")


@functools.cache
def controller_of(model: HandModel) -> Controller:
    """Return a controller that waits for requests.

    The first call for a hand model constructs the controller, and later calls return the same
    controller.
    """
    return uncommissioned_controller(model, LiveProgram())


@functools.cache
def _active_state_template(model: HandModel) -> ControllerState:
    state = controller_of(model).initial_state()
    state.mode = HandMode.ACTIVE
    state.run_integers[s.FILTER_STARTED] = 1
    for name in ("regime", "kind", "kind_before", "stopped"):
        state.view(name)[...] = 0
    return state


def uncompiled_function(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Return the Python function from which a kernel was compiled.

    Tests call the Python function directly, because only other kernels can call the compiled
    kernel.
    """
    return getattr(kernel, "py_func", kernel)


def active_state(model: HandModel) -> ControllerState:
    """Return the state of an active hand with a running filter.

    In the returned state, every tendon is taut. No digit touches an object, and no digit rests at
    its mechanical stop.
    """
    return _active_state_template(model).copy()


NO_TELEMETRY = np.empty(0, np.int64), np.empty(0)
"""Last arguments of ``tick_stages.store_commands`` for a test that reads no telemetry."""


def constant_args_of(model: HandModel) -> tuple[BlockArray, TableOffsets]:
    """Return the constants of a hand model, and the memory layout of these constants.

    In every stage of a tick, these two arguments follow the state block and its layout.
    """
    return controller_of(model).derived_constants.kernel_args[1:]


def constant_tables_of(model: HandModel) -> ConstantTables:
    """Return the tables that contain the constants of a hand.

    The functions that ``uncompiled_function`` returns get the constants of a hand as tables.
    """
    return uncompiled_function(constant_tables)(*constant_args_of(model))


def state_with_estimate(model: HandModel, estimate: SyntheticEstimate) -> ControllerState:
    """Write a given estimate into the state of an active hand, and return this state."""
    state = active_state(model)
    for name, value in estimate._asdict().items():
        if name not in DERIVED_ATTRIBUTES:
            state.view(STATE_FIELD_BY_ATTRIBUTE.get(name, name))[...] = value
    state.view("regime")[estimate.is_slack] = SLACK_REGIME
    return state


def estimate_from_state(state: ControllerState) -> SyntheticEstimate:
    """Return copies of the estimates that a controller's state contains."""
    estimate = state.estimate
    estimate_values = {
        name: state.view("cell_error") if name == "cell_error" else getattr(estimate, name)
        for name in SyntheticEstimate._fields
    }
    return SyntheticEstimate(**{name: np.array(value) for name, value in estimate_values.items()})


class StaticTendonForces(NamedTuple):
    """Forces along each tendon [N] that follow from the model of the filter, as arrays (tendons,).

    Attributes:
        resistance: tension that balances springs and gravity.
        driving_force: tension minus friction, if the direction of friction always follows from the tendon
            speed at the spool.
        force_at_joints: tension minus friction. The friction follows from ``friction_state`` if
            this value is known, and from the tendon speed at the spool if it is unknown.
    """

    resistance: np.ndarray
    driving_force: np.ndarray
    force_at_joints: np.ndarray


@kernel("block", "layout", "constants", "layout")
def _tendon_load_forces(
    block: BlockArray,
    state_offsets: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
) -> np.ndarray:
    return kalman._resistance_and_pull_forces(
        state_tables(block, state_offsets), constant_tables(constants, constant_offsets)
    )


def static_tendon_forces(
    model: HandModel,
    table: np.ndarray,
    tension: np.ndarray,
    friction_state: np.ndarray | None = None,
) -> StaticTendonForces:
    """Return the forces that the filter computes for filter states (tendons, 7) and given tensions [N].

    The function chooses the stretch offset of each tendon so that the tendon has its given tension.
    """
    state, space = active_state(model), model.tendon_constants
    state.tendon[s.SPOOL_TRAVEL : s.SPOOL_TRAVEL + STATE_COUNT] = table.T
    damping_force = space.damping * (table[:, V] - table[:, W])
    state.view("stretch_offset")[...] = (
        table[:, X] - table[:, S] - (tension - damping_force) / space.stiffness
    )
    if friction_state is not None:
        state.view("friction_state")[...] = friction_state
    return StaticTendonForces(
        *_tendon_load_forces(state.block, state.layout.offsets, *constant_args_of(model))
    )


@kernel("constants", "layout", "vector", "count")
def _winding_efficiency(
    constants: BlockArray, constant_offsets: TableOffsets, q: np.ndarray, tendon_count: int
) -> np.ndarray:
    result = np.empty(tendon_count)
    for n in range(tendon_count):
        result[n] = winding_efficiency(constant_tables(constants, constant_offsets), n, q)
    return result


def winding_efficiency_of(model: HandModel, q: np.ndarray) -> np.ndarray:
    """Return the fraction of each tendon's tension that reaches the joints at the angles ``q`` [rad].

    Friction takes the rest of each tension. The returned fractions are valid while the motors wind
    up the tendons.
    """
    return np.asarray(
        _winding_efficiency(
            *constant_args_of(model), np.asarray(q, dtype=np.float64), model.tendon_count
        )
    )


def estimate_from_states(model: HandModel, x: np.ndarray) -> SyntheticEstimate:
    """Return an estimate that corresponds exactly to filter states (tendons, 7).

    In the returned estimate, all tendons are taut and no digit touches an object.
    """
    n = model.tendon_count
    q, dq = np.zeros(len(model.hand.joints)), np.zeros(len(model.hand.joints))
    for digit, tendons in zip(model.digits, model.digit_tendons, strict=True):
        q[digit.joints] = digit.excursion_to_joints @ x[tendons, S]
        dq[digit.joints] = digit.excursion_to_joints @ x[tendons, W]
    space = model.tendon_constants
    tension = space.stiffness * (x[:, X] - x[:, S]) + space.damping * (x[:, V] - x[:, W])
    zeros = np.zeros(n)
    return SyntheticEstimate(
        tension=np.maximum(tension, 0.0),
        tension_sigma=zeros,
        travel=x[:, X].copy(),
        tendon_speed=x[:, V].copy(),
        excursion=x[:, S].copy(),
        excursion_rate=x[:, W].copy(),
        motor_disturbance=zeros,
        external_tension=zeros,
        stretch_offset=zeros,
        cell_error=zeros,
        innovation=zeros,
        nis=zeros,
        is_slack=np.zeros(n, dtype=bool),
        q=q,
        dq=dq,
        q_sigma=np.full(len(q), np.nan),
        contact_force=np.zeros(len(model.digits)),
        grip_opening=zeros,
        grip_travel=zeros,
    )


def balanced_state(model: HandModel, joint_angle: float) -> np.ndarray:
    """Return filter states (tendons, 7) in which the tensions balance springs and weight.

    In the returned filter states, all joints are at ``joint_angle`` [rad].
    """
    x = np.zeros((model.tendon_count, STATE_COUNT))
    for digit, tendons in zip(model.digits, model.digit_tendons, strict=True):
        x[tendons, S] = digit.reduced_moment_arms @ np.full(digit.coupling.shape[1], joint_angle)
    x[:, X] = (
        x[:, S]
        + static_tendon_forces(model, x, np.zeros(len(x))).resistance
        / model.tendon_constants.stiffness
    )
    return x


def estimate_under_tension(
    model: HandModel, tension: float | np.ndarray, joint_angle: float = 0.0
) -> SyntheticEstimate:
    """Return the estimate of a hand at rest whose tendons have given tensions."""
    return estimate_from_states(model, balanced_state(model, joint_angle))._replace(
        tension=np.full(model.tendon_count, 1.0) * tension
    )


def slack_hand_estimate(model: HandModel) -> SyntheticEstimate:
    """Return the estimate of a hand whose tendons are all slack."""
    return estimate_under_tension(model, 0.0)._replace(
        is_slack=np.ones(model.tendon_count, dtype=bool)
    )


def empty_readings(model: HandModel) -> SensorReadings:
    """Return the readings of a tick in which no frame arrived."""
    n, joints = model.tendon_count, len(model.hand.joints)
    return SensorReadings(
        np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan), np.full(joints, np.nan)
    )


def detect_contacts(
    model: HandModel, state: ControllerState, estimate: SyntheticEstimate
) -> SyntheticEstimate:
    """Detect contacts, write the contacts into the state, and return the estimate including the contact forces.

    The field ``closing`` of the given state must mark the digits that close.

    Args:
        model: model of the hand.
        state: state of the last tick. The function writes the values of the present tick into this
            state.
        estimate: estimate of the present tick.
    """
    for name, value in estimate._asdict().items():
        if name not in (*DERIVED_ATTRIBUTES, "grown"):
            state.view(STATE_FIELD_BY_ATTRIBUTE.get(name, name))[...] = value
    state.view("regime")[...] = state.view("kind")[...] = np.where(
        estimate.is_slack, SLACK_REGIME, 0
    )
    elastic_tension = estimate.tension - model.tendon_constants.damping * (
        estimate.tendon_speed - estimate.excursion_rate
    )
    state.view("stretch_offset")[...] = (
        estimate.travel - estimate.excursion - elastic_tension / model.tendon_constants.stiffness
    )
    tick_stages.conclude_estimate(state.block, state.layout.offsets, *constant_args_of(model))
    hand_estimate = state.estimate
    return estimate._replace(
        contact_force=hand_estimate.contact_force.copy(),
        grip_opening=hand_estimate.grip_opening,
        grip_travel=hand_estimate.grip_travel.copy(),
    )
