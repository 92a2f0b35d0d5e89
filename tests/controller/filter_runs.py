"""States, sensors and single ticks for tests of the tension filter.

``FilterState`` is the part of a controller's state that belongs to the filter. ``step`` runs the
stages of one tick on such a state.
"""

from typing import NamedTuple

import numpy as np

from handctl.controller.controller_state import ControllerState
from handctl.core import state_block as s
from handctl.core import tick_stages
from handctl.core.estimation.filter_prediction import predict_filter_states
from handctl.core.estimation.filter_stack import STATE_COUNT, S, TendonRegime, X
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from tests.controller.synthetic import (
    Estimate,
    Readings,
    active_state,
    constants,
    empty_readings,
    estimate_of,
)


class FilterState(NamedTuple):
    """State of the tension filter between two ticks, with one entry per tendon.

    Attributes:
        x: (7N,) the seven filter states of each tendon, tendon after tendon.
        regimes: members of ``TendonRegime``. stopped: whether the digit is on its open stop. turning: evidence that the
            tendon leaves or enters slack.
        measured: whether the tendon's length is known. surprise: last load-cell innovation, divided by its standard
            deviation.
        nis, lately: two averages of the normalised innovation squared. doubtful: whether the filter doubts its model.
        wary: time for which the filter still doubts its model [s].
        covariance: (N, 7, 7) of the states while measurements are missing. None stands for the steady-state covariance.
        started: whether every sensor has been read once.
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
    def of(x: np.ndarray, regime: TendonRegime, stopped: bool) -> "FilterState":
        """Return a filter state with every tendon in the same regime, from the states (7N,) of the tendons."""
        n = len(x) // STATE_COUNT
        none = np.zeros(n)
        no = (False,) * n
        usual = np.full(n, 2.0)
        return FilterState(
            x, (int(regime),) * n, (stopped,) * n, (0,) * n, no, none, usual, no, usual, none
        )

    @staticmethod
    def initial(n: int) -> "FilterState":
        """Return the state that the filter of N tendons has before the first reading of a sensor."""
        return FilterState.of(np.zeros(STATE_COUNT * n), TendonRegime.SLACK, stopped=True)._replace(
            started=False
        )


ROWS = {
    "regimes": "regime", "stopped": "stopped", "turning": "turning", "measured": "length_known",
    "surprise": "surprise", "nis": "nis_mean", "doubtful": "doubtful", "lately": "nis_lately", "wary": "wary",
}  # fmt: skip
"""Field of the state block for each attribute of ``FilterState``.

The seven states and the covariance are not listed.
"""


def write_filter_state(state: ControllerState, filtered: FilterState) -> None:
    """Write a filter state into the block of a controller's state."""
    state.tendon[s.TRAVEL : s.TRAVEL + STATE_COUNT] = filtered.x.reshape(-1, STATE_COUNT).T
    for name, row in ROWS.items():
        state.view(row)[...] = getattr(filtered, name)
    state.view("kind")[...] = state.view("regime") + 3 * (filtered.wary > 0.0)
    state.set_run_integer(s.COVARIANCE_PROPAGATED, filtered.covariance is not None)
    if filtered.covariance is not None:
        state.view("covariance")[...] = filtered.covariance.reshape(-1, STATE_COUNT**2).T
    state.set_run_integer(s.FILTER_STARTED, filtered.started)


def filter_state_of(state: ControllerState) -> FilterState:
    """Return the filter's part of a controller's state."""
    booleans = ("stopped", "measured", "doubtful")
    found = {
        name: tuple(map(bool if name in booleans else int, state.view(row)))
        if state.view(row).dtype == np.int64
        else state.view(row).copy()
        for name, row in ROWS.items()
    }
    carried = None
    if state.run_integer(s.COVARIANCE_PROPAGATED):
        carried = state.view("covariance").T.reshape(-1, STATE_COUNT, STATE_COUNT).copy()
    x = state.tendon[s.TRAVEL : s.TRAVEL + STATE_COUNT].T.copy().ravel()
    return FilterState(x, **found, covariance=carried, started=state.started)


def read(state: ControllerState, measured: Readings) -> None:
    """Write the measurements of a tick into a controller's state."""
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
    """Correct the filter with the measurements of one tick and predict the present state, by the stages of a real tick.

    Args:
        model: the hand. state: of the filter after the last tick. measured: readings that the sensors took at the last
            tick.
        force: (N,) motor force on each tendon since the last tick, with motor friction already subtracted [N].
        rate: (N,) rate at which the tension of each tendon is planned to change [N/s].
        contact: for each digit, whether it is known to touch an object.
        friction_state: (N,) how far the friction of each tendon is developed, where that is known.
        missed: number of ticks that were skipped since the last tick.
    """
    run = state_of(model, state)
    read(run, measured)
    run.view("force")[...], run.view("rate")[...] = force, rate
    run.view("planned_contact")[...] = contact
    if friction_state is not None:
        run.view("friction_state")[...] = friction_state
    run.set_run_integer(s.MISSED_TICKS, missed)
    tick_stages.correct_estimate(run.block, run.layout.places, *constants(model))
    if run.started:
        predict_filter_states(model, run.layout, run.block, missed)
    tick_stages.conclude_estimate(run.block, run.layout.places, *constants(model))
    return filter_state_of(run), estimate_of(run)


def state_at_rest(model: HandModel, tension: float, closed: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the states (N, 7) and motor forces (N,) of a hand that rests with all joints at ``closed`` [rad]."""
    x = np.zeros((model.tendon_count, STATE_COUNT))
    x[:, S] = model.hand.moment_arms @ np.full(len(model.hand.joints), closed)
    x[:, X] = x[:, S] + tension / model.space.stiffness
    return x, np.full(model.tendon_count, tension)


def step(
    model: HandModel,
    state: FilterState,
    measured: Readings,
    force: np.ndarray,
    contact: tuple[bool, ...],
) -> tuple[FilterState, Estimate]:
    """Run one tick of the filter in which no change of tension is planned."""
    return tick(model, state, measured, force, np.zeros(model.tendon_count), contact)


def noiseless_readings(
    model: HandModel, x: np.ndarray, tension: np.ndarray, excursion: bool = False
) -> Readings:
    """Return noiseless readings of filter states (N, 7) and tensions (N,). ``excursion`` adds joint encoders."""
    return empty_readings(model)._replace(
        travel=x[:, X].copy(),
        tension=tension,
        excursion=x[:, S] if excursion else np.full(len(x), np.nan),
    )


def all_in_regime(model: HandModel, regime: TendonRegime, x: np.ndarray) -> FilterState:
    """Return a filter state with every tendon in the same regime. No digit is on its open stop."""
    return FilterState.of(x.ravel(), regime, stopped=False)


def no_contact(model: HandModel) -> tuple[bool, ...]:
    """Return the contact flags of a hand whose digits touch no object, one False per digit."""
    return (False,) * len(model.digits)


def start(
    model: HandModel, state: FilterState, travel: np.ndarray, cells: bool = True
) -> FilterState:
    """Return the filter state after readings of the encoders [m], and of the load cells if ``cells``."""
    run = state_of(model, state)
    run.mode = HandMode.SILENT
    run.view("position")[...] = travel / model.space.spool
    run.view("group_frames")[...] = cells
    tick_stages.observe_tick(run.block, run.layout.places, *constants(model))
    return filter_state_of(run)


def corrected_state(model: HandModel, state: FilterState, measured: Readings) -> ControllerState:
    """Return a controller's state after the filter's measurement update, before its prediction.

    No digit is in contact.
    """
    run = state_of(model, state)
    read(run, measured)
    tick_stages.correct_estimate(run.block, run.layout.places, *constants(model))
    return run


def state_of(model: HandModel, filtered: FilterState) -> ControllerState:
    """Return a controller's state that contains the given filter state."""
    run = active_state(model)
    run.mode = (
        HandMode.ARMING
    )  # in this mode the filter takes contacts from the plan, and detects none
    write_filter_state(run, filtered)
    return run


def parts(model: HandModel, kinds: tuple[int, ...], name: str) -> np.ndarray:
    """Return one array of the filter design for each tendon (N, ...), selected by the tendon's regime."""
    return np.array(
        [getattr(own[kind], name) for own, kind in zip(model.filter.blocks, kinds, strict=True)]
    )
