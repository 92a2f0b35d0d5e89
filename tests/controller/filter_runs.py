"""States, sensors and single ticks for tests of the tension filter.

``FilterState`` is the filter's part of a controller's state, ``step`` runs the stages of one tick on it.
"""

from typing import NamedTuple

import numpy as np

from handctl.controller.state import State
from handctl.core import block as s
from handctl.core import stages
from handctl.core.estimation.filter_stack import STATES, Regime, S, X
from handctl.core.estimation.prediction import predict_filter_states
from handctl.core.model import HandModel
from handctl.core.types import Mode
from tests.controller.synthetic import Estimate, Readings, active_state, constants, empty_readings, estimate_of


class FilterState(NamedTuple):
    """State of the filter between two ticks, per tendon.

    Attributes:
        x: (7N,) the seven states, tendon after tendon.
        regimes: of ``Regime``. stopped: on the open stop. turning: evidence for leaving or entering slack.
        measured: the tendon's length is known. surprise: last load-cell innovation by its standard deviation.
        nis, lately: normalised innovation squared, averaged. doubtful: the model does not fit.
        wary: time for which it is still doubted [s].
        covariance: (N, 7, 7) while measurements are missing; None where it is the steady one.
        started: whether every sensor was read.
    """

    x: np.ndarray
    regimes: tuple[int, ...]
    stopped: tuple[bool, ...]
    turning: tuple[int, ...]
    measured: tuple[bool, ...]
    surprise: np.ndarray
    nis: np.ndarray
    doubtful: tuple[bool, ...]
    lately: np.ndarray
    wary: np.ndarray
    covariance: np.ndarray | None = None
    started: bool = True

    @staticmethod
    def of(x: np.ndarray, regime: Regime, stopped: bool) -> "FilterState":
        """Return every tendon in one regime, with states (7N,)."""
        n = len(x) // STATES
        none = np.zeros(n)
        no = (False,) * n
        usual = np.full(n, 2.0)
        return FilterState(x, (int(regime),) * n, (stopped,) * n, (0,) * n, no, none, usual, no, usual, none)

    @staticmethod
    def initial(n: int) -> "FilterState":
        """Return the filter state before any sensor was read."""
        return FilterState.of(np.zeros(STATES * n), Regime.SLACK, stopped=True)._replace(started=False)


ROWS = {
    "regimes": "regime", "stopped": "stopped", "turning": "turning", "measured": "length_known",
    "surprise": "surprise", "nis": "nis_mean", "doubtful": "doubtful", "lately": "nis_lately", "wary": "wary",
}  # fmt: skip
"""Fields of the block that a filter's state is made of, beside its seven states and the covariance."""


def write_filter_state(state: State, filtered: FilterState) -> None:
    """Write a filter state into the state of a controller."""
    state.tendon[s.TRAVEL : s.TRAVEL + STATES] = filtered.x.reshape(-1, STATES).T
    for name, row in ROWS.items():
        state.view(row)[...] = getattr(filtered, name)
    state.view("kind")[...] = state.view("regime") + 3 * (filtered.wary > 0.0)
    state.set_whole(s.COVARIANCE_PROPAGATED, filtered.covariance is not None)
    if filtered.covariance is not None:
        state.view("covariance")[...] = filtered.covariance.reshape(-1, STATES**2).T
    state.set_whole(s.FILTER_STARTED, filtered.started)


def filter_state_of(state: State) -> FilterState:
    """Read the filter state from the state of a controller."""
    booleans = ("stopped", "measured", "doubtful")
    found = {
        name: tuple(map(bool if name in booleans else int, state.view(row)))
        if state.view(row).dtype == np.int64
        else state.view(row).copy()
        for name, row in ROWS.items()
    }
    carried = None
    if state.whole(s.COVARIANCE_PROPAGATED):
        carried = state.view("covariance").T.reshape(-1, STATES, STATES).copy()
    x = state.tendon[s.TRAVEL : s.TRAVEL + STATES].T.copy().ravel()
    return FilterState(x, **found, covariance=carried, started=state.started)


def read(state: State, measured: Readings) -> None:
    """Write measurements into a state."""
    for name in ("travel", "tension", "excursion"):
        state.view(f"measured_{name}")[...] = getattr(measured, name)
    state.view("measured_joint")[...] = measured.joints
    state.view("saturated")[list(measured.saturated)] = 1


def tick(
    model: HandModel,
    state: FilterState,
    measured: Readings,
    force: np.ndarray,
    rate: np.ndarray,
    contact: tuple[bool, ...],
    friction_state: np.ndarray | None = None,
    missed: int = 0,
) -> tuple[FilterState, Estimate]:
    """Process the measurements of one tick and predict to the present, with the stages of a tick.

    Args:
        model: the hand. state: from the last tick. measured: at the last tick's instant.
        force: (N,) motor force that acted since, without what friction takes [N].
        rate: (N,) planned rate of the tension [N/s].
        contact: per digit, whether it is known to touch.
        friction_state: (N,) how far friction is developed where that is known.
        missed: ticks that were skipped since.
    """
    run = state_of(model, state)
    read(run, measured)
    run.view("force")[...], run.view("rate")[...] = force, rate
    run.view("planned_contact")[...] = contact
    if friction_state is not None:
        run.view("friction_state")[...] = friction_state
    run.set_whole(s.MISSED_TICKS, missed)
    stages.correct_estimate(run.block, run.layout.places, *constants(model))
    if run.started:
        predict_filter_states(model, run.layout, run.block, missed)
    stages.conclude_estimate(run.block, run.layout.places, *constants(model))
    return filter_state_of(run), estimate_of(run)


def state_at_rest(model: HandModel, tension: float, closed: float) -> tuple[np.ndarray, np.ndarray]:
    """Return state (N, 7) and motor forces of a hand at rest with all joints at ``closed`` [rad]."""
    x = np.zeros((model.tendon_count, STATES))
    x[:, S] = model.hand.moment_arms @ np.full(len(model.hand.joints), closed)
    x[:, X] = x[:, S] + tension / model.space.stiffness
    return x, np.full(model.tendon_count, tension)


def step(
    model: HandModel, state: FilterState, measured: Readings, force: np.ndarray, contact: tuple[bool, ...]
) -> tuple[FilterState, Estimate]:
    """Run a tick without a planned change of tension."""
    return tick(model, state, measured, force, np.zeros(model.tendon_count), contact)


def noiseless_readings(
    model: HandModel, x: np.ndarray, tension: np.ndarray, excursion: bool = False
) -> Readings:
    """Return noiseless sensor readings of a state (N, 7) with given tensions, with joint encoders on request."""
    return empty_readings(model)._replace(
        travel=x[:, X].copy(),
        tension=tension,
        excursion=x[:, S] if excursion else np.full(len(x), np.nan),
    )


def all_in_regime(model: HandModel, regime: Regime, x: np.ndarray) -> FilterState:
    """Return every tendon in one regime, with all digits away from their stops."""
    return FilterState.of(x.ravel(), regime, stopped=False)


def no_contact(model: HandModel) -> tuple[bool, ...]:
    """Return that no digit is in contact."""
    return (False,) * len(model.digits)


def start(model: HandModel, state: FilterState, travel: np.ndarray, cells: bool = True) -> FilterState:
    """Return the filter state after readings of the encoders [m], and of the load cells if ``cells``."""
    run = state_of(model, state)
    run.mode = Mode.SILENT
    run.view("position")[...] = travel / model.space.spool
    run.view("group_frames")[...] = cells
    stages.observe_tick(run.block, run.layout.places, *constants(model))
    return filter_state_of(run)


def corrected_state(model: HandModel, state: FilterState, measured: Readings) -> State:
    """Return the state of a free hand after the measurement update, before the prediction."""
    run = state_of(model, state)
    read(run, measured)
    stages.correct_estimate(run.block, run.layout.places, *constants(model))
    return run


def state_of(model: HandModel, filtered: FilterState) -> State:
    """Return the state of a controller with the given filter state."""
    run = active_state(model)
    run.mode = Mode.ARMING  # this mode uses planned contacts, and detects none
    write_filter_state(run, filtered)
    return run


def parts(model: HandModel, kinds: tuple[int, ...], name: str) -> np.ndarray:
    """Return a part of the filter design of each tendon in its regime, (N, ...)."""
    return np.array([getattr(own[kind], name) for own, kind in zip(model.filter.blocks, kinds, strict=True)])
