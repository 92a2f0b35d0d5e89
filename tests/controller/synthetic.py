"""Synthetic estimates, measurements and states of a hand, for tests of the code that uses the filter.

``State`` holds all numbers of a tick. ``Estimate`` and ``Readings`` are the parts of it that tests make up: ``written``
puts an estimate into a state, and ``estimate_of`` takes it out again.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from handctl.compiled import kernel
from handctl.controller.state import State
from handctl.controller.tick import Controller
from handctl.core import block as s
from handctl.core import stages
from handctl.core.block import state_tables
from handctl.core.constants import ConstantTables, constant_tables
from handctl.core.estimation import kalman
from handctl.core.estimation.filter_stack import STATES, S, V, W, X
from handctl.core.estimation.statics import winding_efficiency
from handctl.core.model import HandModel
from handctl.core.schema import Block, Places
from handctl.core.types import Mode
from handctl.programs.live import LiveProgram
from tests.controller.bench import controller

SLACK = 2


class Readings(NamedTuple):
    """Measurements of one tick, (N,) each; NaN where missing.

    Attributes:
        travel: encoder, at the spool [m]. tension: load cell, tared [N]. excursion: by joint encoders [m].
        joints: (J,) joint encoders [rad]. saturated: tendons whose load cell is at an end of its range.
    """

    travel: np.ndarray
    tension: np.ndarray
    excursion: np.ndarray
    joints: np.ndarray
    saturated: tuple[int, ...] = ()


class Estimate(NamedTuple):
    """Present estimate with the names that programs use, see ``handctl.core.estimate.Estimate``."""

    tension: np.ndarray
    sigma: np.ndarray
    travel: np.ndarray
    speed: np.ndarray
    excursion: np.ndarray
    rate: np.ndarray
    disturbance: np.ndarray
    external: np.ndarray
    offset: np.ndarray
    cell_error: np.ndarray
    innovation: np.ndarray
    nis: np.ndarray
    slack: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    q_sigma: np.ndarray
    contact_force: np.ndarray
    grip_opening: np.ndarray
    grip: np.ndarray


FIELDS = {"rate": "excursion_rate", "offset": "stretch_offset", "contact_force": "grown"}
"""Names of fields of the block that are others than those of an estimate."""
DERIVED = ("slack", "grip_opening", "grip")


@functools.cache
def controller_of(model: HandModel) -> Controller:
    """Return a controller of the hand that waits for requests, made once."""
    return controller(model, LiveProgram())


@functools.cache
def _blank(model: HandModel) -> State:
    state = controller_of(model).initial()
    state.mode = Mode.ACTIVE
    state.set_whole(s.FILTER_STARTED, 1)
    for name in ("regime", "kind", "kind_before", "stopped"):
        state.view(name)[...] = 0
    return state


def interpreted(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the Python function behind a kernel, for functions that only kernels may call."""
    return getattr(function, "py_func", function)


def active_state(model: HandModel) -> State:
    """Return a state of an active hand with a running filter: every tendon taut and free, off its stop."""
    return _blank(model).copy()


def constants(model: HandModel) -> tuple[Block, Places]:
    """Return the last two arguments of every stage: the constants of the hand and their layout."""
    return controller_of(model)._constants


def constant_tables_of(model: HandModel) -> ConstantTables:
    """Return the constants by table, for interpreted functions."""
    return interpreted(constant_tables)(*constants(model))


def state_with_estimate(model: HandModel, estimate: Estimate) -> State:
    """Return a state of an active hand with a given estimate."""
    state = active_state(model)
    for name, value in estimate._asdict().items():
        if name not in DERIVED:
            state.view(FIELDS.get(name, name))[...] = value
    state.view("regime")[estimate.slack] = SLACK
    return state


def estimate_of(state: State) -> Estimate:
    """Return the estimate in a state, as copies."""
    seen = state.estimate
    own = {name: state.view("cell_error") if name == "cell_error" else getattr(seen, name) for name in Estimate._fields}
    return Estimate(**{name: np.array(value) for name, value in own.items()})


class LoadStatics(NamedTuple):
    """Known forces along the tendons, (N,) [N]: spring and gravity loads, and the tension after friction.

    Attributes:
        resistance: tension that springs and gravity balance.
        eager: of the tension, friction by the speed at the spool taken off.
        pull: the same, by what is known of friction where it is.
    """

    resistance: np.ndarray
    eager: np.ndarray
    pull: np.ndarray


@kernel("block", "layout", "constants", "layout")
def _load_forces(block: Block, at: Places, of: Block, of_at: Places) -> np.ndarray:
    return kalman._load_forces(state_tables(block, at), constant_tables(of, of_at))


def load_statics(
    model: HandModel, table: np.ndarray, tension: np.ndarray, friction_state: np.ndarray | None = None
) -> LoadStatics:
    """Return the known forces that the filter assumes for states (N, 7) with given tensions [N].

    The offset of the tendons is chosen so that they do; nothing else of it matters here.
    """
    state, space = active_state(model), model.space
    state.tendon[s.TRAVEL : s.TRAVEL + STATES] = table.T
    damped = space.damping * (table[:, V] - table[:, W])
    state.view("stretch_offset")[...] = table[:, X] - table[:, S] - (tension - damped) / space.stiffness
    if friction_state is not None:
        state.view("friction_state")[...] = friction_state
    return LoadStatics(*_load_forces(state.block, state.layout.places, *constants(model)))


@kernel("constants", "layout", "vector", "count")
def _efficiency(of: Block, of_at: Places, q: np.ndarray, tendons: int) -> np.ndarray:
    result = np.empty(tendons)
    for n in range(tendons):
        result[n] = winding_efficiency(constant_tables(of, of_at), n, q)
    return result


def efficiency(model: HandModel, q: np.ndarray) -> np.ndarray:
    """Return the fraction of each tension (N,) that acts at the joints while winding, at joint angles (J,) [rad]."""
    return np.asarray(_efficiency(*constants(model), np.asarray(q, dtype=np.float64), model.tendon_count))


def exact_estimate(model: HandModel, x: np.ndarray) -> Estimate:
    """Return an estimate that equals a state (N, 7) exactly, with taut tendons and free digits."""
    n = model.tendon_count
    q, dq = np.zeros(len(model.hand.joints)), np.zeros(len(model.hand.joints))
    for digit, tendons in zip(model.digits, model.digit_tendons, strict=True):
        q[digit.joints] = digit.excursion_to_joints @ x[tendons, S]
        dq[digit.joints] = digit.excursion_to_joints @ x[tendons, W]
    space = model.space
    tension = space.stiffness * (x[:, X] - x[:, S]) + space.damping * (x[:, V] - x[:, W])
    nothing = np.zeros(n)
    return Estimate(
        tension=np.maximum(tension, 0.0),
        sigma=nothing,
        travel=x[:, X].copy(),
        speed=x[:, V].copy(),
        excursion=x[:, S].copy(),
        rate=x[:, W].copy(),
        disturbance=nothing,
        external=nothing,
        offset=nothing,
        cell_error=nothing,
        innovation=nothing,
        nis=nothing,
        slack=np.zeros(n, dtype=bool),
        q=q,
        dq=dq,
        q_sigma=np.full(len(q), np.nan),
        contact_force=np.zeros(len(model.digits)),
        grip_opening=nothing,
        grip=nothing,
    )


def balanced_state(model: HandModel, closed: float) -> np.ndarray:
    """Return a state (N, 7) in balance with springs and weight, with all coordinates at ``closed`` [rad]."""
    x = np.zeros((model.tendon_count, STATES))
    for digit, tendons in zip(model.digits, model.digit_tendons, strict=True):
        x[tendons, S] = digit.reduced_moment_arms @ np.full(digit.coupling.shape[1], closed)
    x[:, X] = x[:, S] + load_statics(model, x, np.zeros(len(x))).resistance / model.space.stiffness
    return x


def estimate_under_tension(
    model: HandModel, tension: float | np.ndarray, closed: float = 0.0
) -> Estimate:
    """Return an estimate of a hand at rest with a given tension in its tendons."""
    return exact_estimate(model, balanced_state(model, closed))._replace(
        tension=np.full(model.tendon_count, 1.0) * tension
    )


def slack(model: HandModel) -> Estimate:
    """Return an estimate of a hand with slack tendons."""
    return estimate_under_tension(model, 0.0)._replace(
        slack=np.ones(model.tendon_count, dtype=bool)
    )


def empty_readings(model: HandModel) -> Readings:
    """Return the readings of a tick without frames."""
    n, joints = model.tendon_count, len(model.hand.joints)
    return Readings(np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan), np.full(joints, np.nan))


def detect_contacts(model: HandModel, state: State, estimate: Estimate) -> Estimate:
    """Return the estimate after contact detection of a tick. The state stores the contacts and the closing digits.

    Args:
        model: the hand. state: of the tick before, in which this one is written. estimate: of this tick.
    """
    for name, value in estimate._asdict().items():
        if name not in (*DERIVED, "grown"):
            state.view(FIELDS.get(name, name))[...] = value
    state.view("regime")[...] = state.view("kind")[...] = np.where(estimate.slack, SLACK, 0)
    borne = estimate.tension - model.space.damping * (estimate.speed - estimate.rate)
    state.view("stretch_offset")[...] = estimate.travel - estimate.excursion - borne / model.space.stiffness
    stages.conclude_estimate(state.block, state.layout.places, *constants(model))
    seen = state.estimate
    return estimate._replace(
        contact_force=seen.contact_force.copy(), grip_opening=seen.grip_opening, grip=seen.grip.copy()
    )
