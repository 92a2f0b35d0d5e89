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
from tests.controller.synthetic import Estimate, Readings, blank, constants, estimate_of, nothing_read


class FilterState(NamedTuple):
    """What the filter hands to the next tick, per tendon.

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
        """Every tendon in one regime, with states (7N,)."""
        n = len(x) // STATES
        none = np.zeros(n)
        no = (False,) * n
        usual = np.full(n, 2.0)
        return FilterState(x, (int(regime),) * n, (stopped,) * n, (0,) * n, no, none, usual, no, usual, none)

    @staticmethod
    def initial(n: int) -> "FilterState":
        """Before any sensor was read."""
        return FilterState.of(np.zeros(STATES * n), Regime.SLACK, stopped=True)._replace(started=False)


ROWS = {
    "regimes": "regime", "stopped": "stopped", "turning": "turning", "measured": "length_known",
    "surprise": "surprise", "nis": "nis_mean", "doubtful": "doubtful", "lately": "nis_lately", "wary": "wary",
}  # fmt: skip
"""Fields of the block that a filter's state is made of, beside its seven states and the covariance."""


def put(state: State, filtered: FilterState) -> None:
    """Write a filter's state into a controller's."""
    state.tendon[s.TRAVEL : s.TRAVEL + STATES] = filtered.x.reshape(-1, STATES).T
    for name, row in ROWS.items():
        state.view(row)[...] = getattr(filtered, name)
    state.view("kind")[...] = state.view("regime") + 3 * (filtered.wary > 0.0)
    state.set_whole(s.CARRIED, filtered.covariance is not None)
    if filtered.covariance is not None:
        state.view("covariance")[...] = filtered.covariance.reshape(-1, STATES**2).T
    state.set_whole(s.STARTED, filtered.started)


def taken(state: State) -> FilterState:
    """Read a filter's state from a controller's."""
    booleans = ("stopped", "measured", "doubtful")
    found = {
        name: tuple(map(bool if name in booleans else int, state.view(row)))
        if state.view(row).dtype == np.int64
        else state.view(row).copy()
        for name, row in ROWS.items()
    }
    carried = state.view("covariance").T.reshape(-1, STATES, STATES).copy() if state.whole(s.CARRIED) else None
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
    """Take in the measurements of one tick and predict to the present, by the stages of a tick.

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
    run.set_whole(s.MISSED, missed)
    stages.correct_estimate(run.block, run.layout.places, *constants(model))
    if run.started:
        predict_filter_states(model, run.layout, run.block, missed)
    stages.conclude_estimate(run.block, run.layout.places, *constants(model))
    return taken(run), estimate_of(run)


def resting(model: HandModel, tension: float, closed: float) -> tuple[np.ndarray, np.ndarray]:
    """State (N, 7) of a hand at rest with all joints at ``closed`` [rad], and the motor forces that hold it there."""
    x = np.zeros((model.tendon_count, STATES))
    x[:, S] = model.hand.moment_arms @ np.full(len(model.hand.joints), closed)
    x[:, X] = x[:, S] + tension / model.space.stiffness
    return x, np.full(model.tendon_count, tension)


def step(
    model: HandModel, state: FilterState, measured: Readings, force: np.ndarray, contact: tuple[bool, ...]
) -> tuple[FilterState, Estimate]:
    """A tick in which no change of tension is intended."""
    return tick(model, state, measured, force, np.zeros(model.tendon_count), contact)


def readings(model: HandModel, x: np.ndarray, tension: np.ndarray, excursion: bool = False) -> Readings:
    """What noiseless sensors read of a state (N, 7) with these tensions; joint encoders only if asked."""
    return nothing_read(model)._replace(
        travel=x[:, X].copy(),
        tension=tension,
        excursion=x[:, S] if excursion else np.full(len(x), np.nan),
    )


def all_in(model: HandModel, regime: Regime, x: np.ndarray) -> FilterState:
    """Every tendon in one regime, digits off their stops."""
    return FilterState.of(x.ravel(), regime, stopped=False)


def nowhere(model: HandModel) -> tuple[bool, ...]:
    """No digit is in contact."""
    return (False,) * len(model.digits)


def start(model: HandModel, state: FilterState, travel: np.ndarray, cells: bool = True) -> FilterState:
    """The filter's state once encoders have told these travels [m], and the load cells something if ``cells``."""
    run = state_of(model, state)
    run.mode = Mode.SILENT
    run.view("position")[...] = travel / model.space.spool
    run.view("group_frames")[...] = cells
    stages.observe_tick(run.block, run.layout.places, *constants(model))
    return taken(run)


def corrected(model: HandModel, state: FilterState, measured: Readings) -> State:
    """The state of a hand that touches nothing once measurements were taken in, before the prediction."""
    run = state_of(model, state)
    read(run, measured)
    stages.correct_estimate(run.block, run.layout.places, *constants(model))
    return run


def state_of(model: HandModel, filtered: FilterState) -> State:
    """A controller's state with that of the filter."""
    run = blank(model)
    run.mode = Mode.ARMING  # in which a planned contact counts, and none is felt
    put(run, filtered)
    return run


def parts(model: HandModel, kinds: tuple[int, ...], name: str) -> np.ndarray:
    """A part of the design of every tendon in its kind, (N, ...)."""
    return np.array([getattr(own[kind], name) for own, kind in zip(model.filter.blocks, kinds, strict=True)])
