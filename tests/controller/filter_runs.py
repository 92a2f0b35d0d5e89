"""Make states and sensor readings, and run single ticks, for tests of the tension filter.

``FilterState`` is the part of the controller's state that belongs to the filter.
``run_filter_tick_without_plan`` runs one tick of the filter on a ``FilterState``.
"""

from typing import NamedTuple

import numpy as np

from handctl.controller.controller_state import ControllerState
from handctl.core import state_block as s
from handctl.core import tick_stages
from handctl.core.estimation.filter_prediction import FilterPrediction
from handctl.core.estimation.filter_types import STATE_COUNT, S, TendonRegime, X
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from tests.controller.synthetic_states import (
    SensorReadings,
    SyntheticEstimate,
    active_state,
    constant_args_of,
    empty_readings,
    estimate_from_state,
)


class FilterState(NamedTuple):
    """State of the tension filter between two ticks.

    If no shape is stated, an attribute has one entry per tendon. The attribute ``started`` is a
    single value.

    Attributes:
        filter_states: (7 * tendons,) the seven filter states of each tendon, tendon after tendon.
        regimes: members of ``TendonRegime``.
        stopped: True if the tendon's digit is fully open and rests at its mechanical stop.
        regime_change_evidence: evidence that a slack tendon becomes taut, or that a taut tendon becomes
            slack.
        is_length_known: True if the length of the tendon is known.
        normalised_cell_innovation: last load-cell innovation, divided by its standard deviation.
        nis_mean, nis_fast_average: slow and fast average of the normalised innovation squared.
        is_doubtful: True if the innovations are too large for the model of the tendon, so the
            filter trusts this model less.
        doubt_time_s: remaining time for which the filter trusts its model of the tendon less [s].
        covariance: (tendons, 7, 7) covariance of the filter states while measurements are missing.
            The value is None if the covariance is the steady-state covariance.
        started: True if every sensor has been read once.
    """

    filter_states: np.ndarray
    regimes: tuple[int, ...]
    stopped: tuple[bool, ...]
    regime_change_evidence: tuple[int, ...]
    is_length_known: tuple[bool, ...]
    normalised_cell_innovation: np.ndarray
    nis_mean: np.ndarray
    is_doubtful: tuple[bool, ...]
    nis_fast_average: np.ndarray
    doubt_time_s: np.ndarray
    covariance: np.ndarray | None = None
    started: bool = True

    @staticmethod
    def tendons_in_regime(x: np.ndarray, regime: TendonRegime, stopped: bool) -> "FilterState":
        """Return a filter state with given tendon states (7 * tendons,).

        All tendons are in the same regime: free, held or slack.
        """
        n = len(x) // STATE_COUNT
        zero_vector = np.zeros(n)
        no = (False,) * n
        default_nis = np.full(n, 2.0)
        return FilterState(
            x,
            (int(regime),) * n,
            (stopped,) * n,
            (0,) * n,
            no,
            zero_vector,
            default_nis,
            no,
            default_nis,
            zero_vector,
        )

    @staticmethod
    def initial_filter_state(n: int) -> "FilterState":
        """Return the state that the filter of N tendons has before the first reading of a sensor."""
        return FilterState.tendons_in_regime(
            np.zeros(STATE_COUNT * n), TendonRegime.SLACK, stopped=True
        )._replace(started=False)


STATE_FIELD_BY_ATTRIBUTE = {
    "regimes": "regime", "stopped": "stopped", "regime_change_evidence": "turning",
    "is_length_known": "length_known",
    "normalised_cell_innovation": "surprise", "nis_mean": "nis_mean", "is_doubtful": "doubtful",
    "nis_fast_average": "nis_lately",
    "doubt_time_s": "wary",
}  # fmt: skip
"""Field of the state block for each attribute of ``FilterState``.

The attributes for the seven filter states and for the covariance have no entry in
``STATE_FIELD_BY_ATTRIBUTE``.
"""


def write_filter_state(state: ControllerState, filter_state: FilterState) -> None:
    """Write a filter state into a controller's state."""
    state.tendon[s.SPOOL_TRAVEL : s.SPOOL_TRAVEL + STATE_COUNT] = (
        filter_state.filter_states.reshape(-1, STATE_COUNT).T
    )
    for name, row in STATE_FIELD_BY_ATTRIBUTE.items():
        state.view(row)[...] = getattr(filter_state, name)
    state.view("kind")[...] = state.view("regime") + 3 * (filter_state.doubt_time_s > 0.0)
    state.run_integers[s.COVARIANCE_PROPAGATED] = filter_state.covariance is not None
    if filter_state.covariance is not None:
        state.view("covariance")[...] = filter_state.covariance.reshape(-1, STATE_COUNT**2).T
    state.run_integers[s.FILTER_STARTED] = filter_state.started


def filter_state_of(state: ControllerState) -> FilterState:
    """Return the part of a controller's state that belongs to the filter."""
    boolean_fields = ("stopped", "is_length_known", "is_doubtful")
    field_values = {
        name: tuple(map(bool if name in boolean_fields else int, state.view(row)))
        if state.view(row).dtype == np.int64
        else state.view(row).copy()
        for name, row in STATE_FIELD_BY_ATTRIBUTE.items()
    }
    covariances = None
    if state.run_integers[s.COVARIANCE_PROPAGATED]:
        covariances = state.view("covariance").T.reshape(-1, STATE_COUNT, STATE_COUNT).copy()
    x = state.tendon[s.SPOOL_TRAVEL : s.SPOOL_TRAVEL + STATE_COUNT].T.copy().ravel()
    return FilterState(x, **field_values, covariance=covariances, started=state.has_started)


def write_readings(state: ControllerState, measured: SensorReadings) -> None:
    """Write the measurements of a tick into a controller's state."""
    for name in ("travel", "tension", "excursion"):
        state.view(f"measured_{name}")[...] = getattr(measured, name)
    state.view("measured_joint")[...] = measured.joints
    state.view("saturated")[list(measured.saturated_tendons)] = 1


def run_filter_tick(
    model: HandModel,
    state: FilterState,
    measured: SensorReadings,
    motor_force: np.ndarray,
    planned_rate: np.ndarray,
    digit_contact: tuple[bool, ...],
    friction_state: np.ndarray | None = None,
    missed_ticks: int = 0,
) -> tuple[FilterState, SyntheticEstimate]:
    """Correct the filter with the measurements of one tick, and predict the present state.

    The function calls the same stages of the filter as a tick of the controller.

    Args:
        model: model of the hand.
        state: state of the filter after the last tick.
        measured: readings that the sensors took at the last tick.
        motor_force: (tendons,) motor force on each tendon since the last tick, with motor friction
            already subtracted [N].
        planned_rate: (tendons,) planned rate of change of the tension of each tendon [N/s].
        digit_contact: for each digit, True if the digit is known to touch an object.
        friction_state: (tendons,) friction of each tendon as a fraction of its full amount, from 1
            (winding up) to -1 (paying out). NaN if the fraction is unknown.
        missed_ticks: number of ticks that were missed since the last tick.
    """
    controller_state = state_with_filter(model, state)
    write_readings(controller_state, measured)
    controller_state.view("force")[...], controller_state.view("rate")[...] = (
        motor_force,
        planned_rate,
    )
    controller_state.view("planned_contact")[...] = digit_contact
    if friction_state is not None:
        controller_state.view("friction_state")[...] = friction_state
    controller_state.run_integers[s.MISSED_TICKS] = missed_ticks
    tick_stages.correct_tension_estimate(
        controller_state.block, controller_state.layout.offsets, *constant_args_of(model)
    )
    if controller_state.has_started:
        FilterPrediction(model, controller_state.layout).predict(
            controller_state.block, missed_ticks
        )
    tick_stages.conclude_estimate(
        controller_state.block, controller_state.layout.offsets, *constant_args_of(model)
    )
    return filter_state_of(controller_state), estimate_from_state(controller_state)


def state_at_rest(
    model: HandModel, tension: float, joint_angle: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the filter states (tendons, 7) and motor forces (tendons,) for joints at rest at ``joint_angle`` [rad]."""
    x = np.zeros((model.tendon_count, STATE_COUNT))
    x[:, S] = model.hand.moment_arms @ np.full(len(model.hand.joints), joint_angle)
    x[:, X] = x[:, S] + tension / model.tendon_constants.stiffness
    return x, np.full(model.tendon_count, tension)


def run_filter_tick_without_plan(
    model: HandModel,
    state: FilterState,
    measured: SensorReadings,
    motor_force: np.ndarray,
    digit_contact: tuple[bool, ...],
) -> tuple[FilterState, SyntheticEstimate]:
    """Run one tick of the filter without a planned change of tension."""
    return run_filter_tick(
        model, state, measured, motor_force, np.zeros(model.tendon_count), digit_contact
    )


def noiseless_readings(
    model: HandModel, x: np.ndarray, tension: np.ndarray, excursion: bool = False
) -> SensorReadings:
    """Return readings without noise, for given filter states (tendons, 7) and tensions (tendons,) [N].

    If ``excursion`` is True, the readings include tendon excursions from the joint encoders.
    """
    return empty_readings(model)._replace(
        travel=x[:, X].copy(),
        tension=tension,
        excursion=x[:, S] if excursion else np.full(len(x), np.nan),
    )


def state_in_regime(model: HandModel, regime: TendonRegime, x: np.ndarray) -> FilterState:
    """Return a filter state in which every tendon has the same regime: free, held or slack.

    In the returned filter state, no digit rests at the mechanical stop that limits its opening.
    """
    return FilterState.tendons_in_regime(x.ravel(), regime, stopped=False)


def flags_without_contact(model: HandModel) -> tuple[bool, ...]:
    """Return the contact flags of a hand whose digits touch no object: one False for each digit."""
    return (False,) * len(model.digits)


def state_after_first_readings(
    model: HandModel, state: FilterState, travel: np.ndarray, with_load_cells: bool = True
) -> FilterState:
    """Return the filter state after the first readings of the motor encoders.

    ``travel`` [m] contains the readings of the motor encoders. If ``with_load_cells`` is True, the
    readings of all load cells have arrived in the same tick.
    """
    controller_state = state_with_filter(model, state)
    controller_state.mode = HandMode.SILENT
    controller_state.view("position")[...] = travel / model.tendon_constants.spool_radius
    controller_state.view("group_frames")[...] = with_load_cells
    tick_stages.observe_tick(
        controller_state.block, controller_state.layout.offsets, *constant_args_of(model)
    )
    return filter_state_of(controller_state)


def corrected_state(
    model: HandModel, state: FilterState, measured: SensorReadings
) -> ControllerState:
    """Return a controller's state between the correction and the prediction of the filter.

    In the returned state, no digit is in contact.
    """
    controller_state = state_with_filter(model, state)
    write_readings(controller_state, measured)
    tick_stages.correct_tension_estimate(
        controller_state.block, controller_state.layout.offsets, *constant_args_of(model)
    )
    return controller_state


def state_with_filter(model: HandModel, filter_state: FilterState) -> ControllerState:
    """Return a controller's state that contains the given filter state."""
    controller_state = active_state(model)
    controller_state.mode = (
        HandMode.ARMING
    )  # in the mode ARMING, the filter takes contacts from the plan, and detects none itself
    write_filter_state(controller_state, filter_state)
    return controller_state


def design_arrays_by_tendon(
    model: HandModel, regime_by_tendon: tuple[int, ...], array_name: str
) -> np.ndarray:
    """Return one array of each tendon's filter design, stacked along a new first axis.

    ``array_name`` is the name of the array. A tendon has one filter design for each regime: free,
    held (the digit rests on an object or a stop) or slack. ``regime_by_tendon`` contains the regime
    of each tendon.
    """
    return np.array(
        [
            getattr(designs_of_tendon[kind], array_name)
            for designs_of_tendon, kind in zip(
                model.filter_design.blocks, regime_by_tendon, strict=True
            )
        ]
    )
