"""Test the tension filter while the hand moves.

The tests check predictions while measurements are missing, and the detection of slack tendons and
of digits on a stop.
"""

import numpy as np

from handctl.core import tick_stages
from handctl.core.estimation.filter_types import STATE_COUNT, O, S, TendonRegime, W, X
from handctl.core.estimation.slack_detection import MIN_TAUT_TENSION_N, SLACK_TICKS
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from tests.controller.filter_oracle import FILTER_STATE_UNITS
from tests.controller.filter_runs import (
    FilterState,
    flags_without_contact,
    noiseless_readings,
    run_filter_tick,
    run_filter_tick_without_plan,
    state_after_first_readings,
    state_at_rest,
    state_in_regime,
)
from tests.controller.synthetic_states import (
    SensorReadings,
    active_state,
    constant_args_of,
    empty_readings,
    static_tendon_forces,
)


def test_without_any_measurement_the_tick_is_a_prediction(model: HandModel) -> None:
    x, force = state_at_rest(model, 25.0, 0.6)
    state = state_in_regime(model, TendonRegime.FREE, x)
    state_after, estimate = run_filter_tick_without_plan(
        model, state, empty_readings(model), force, flags_without_contact(model)
    )
    for i, row in enumerate(state_after.filter_states.reshape(-1, STATE_COUNT)):
        block = model.filter_design.blocks[i][TendonRegime.FREE]
        np.testing.assert_allclose(
            row / FILTER_STATE_UNITS,
            (block.F @ x[i] + block.B @ [force[i], 0.0]) / FILTER_STATE_UNITS,
            atol=1e-9,
        )
    assert np.isnan(estimate.innovation).all()
    assert np.isnan(estimate.nis).all()
    assert not np.isnan(estimate.tension).any()


def test_a_lost_frame_of_one_tendon_leaves_the_others_alone(model: HandModel) -> None:
    x, force = state_at_rest(model, 25.0, 0.6)
    whole_readings = noiseless_readings(model, x, np.full(len(x), 26.0))
    measurement_with_gap = whole_readings._replace(tension=whole_readings.tension.copy())
    measurement_with_gap.tension[1] = np.nan
    results = [
        run_filter_tick_without_plan(
            model,
            state_in_regime(model, TendonRegime.FREE, x),
            m,
            force,
            flags_without_contact(model),
        )[0].filter_states
        for m in (whole_readings, measurement_with_gap)
    ]
    changed = np.abs(results[0] - results[1]).reshape(-1, STATE_COUNT).max(axis=1) > 1e-12
    tendons = next(s for s in model.digit_tendons if s.start <= 1 < s.stop)
    assert changed[1]
    assert not changed[[i for i in range(len(x)) if not tendons.start <= i < tendons.stop]].any()


def test_filter_starts_when_every_encoder_was_read(model: HandModel) -> None:
    n = model.tendon_count
    travel, cell = np.linspace(-3e-3, 2e-3, n), np.zeros(n)
    state, estimate = run_filter_tick_without_plan(
        model,
        FilterState.initial_filter_state(n),
        readings_of(model, travel, cell),
        cell,
        flags_without_contact(model),
    )
    assert not state.started, "not by itself"
    for unknown in (estimate.innovation, estimate.nis):
        assert unknown.shape == (n,)
        assert np.isnan(unknown).all()
    partial = travel.copy()
    partial[n - 1] = np.nan
    assert not state_after_first_readings(model, state, partial).started
    assert not state_after_first_readings(model, state, travel, with_load_cells=False).started
    state = state_after_first_readings(model, state, travel)
    assert state.started
    state, estimate = run_filter_tick_without_plan(
        model, state, readings_of(model, partial, cell), cell, flags_without_contact(model)
    )
    np.testing.assert_allclose(estimate.travel, travel, atol=1e-6)
    np.testing.assert_allclose(estimate.tension, 0.0, atol=1e-9)


def readings_of(
    model: HandModel, spool_travel: np.ndarray, cell_tension: np.ndarray
) -> SensorReadings:
    return empty_readings(model)._replace(travel=spool_travel, tension=cell_tension)


def test_load_cells_may_reply_before_the_encoders_of_a_taut_hand(model: HandModel) -> None:
    """At the start of a run, the first load-cell readings can arrive before the first motor-encoder readings.

    A drive sends its position only after the controller has read the drive's registers.
    """
    n = model.tendon_count
    cell, state = np.full(n, 5.0), FilterState.initial_filter_state(n)
    for _ in range(20):
        state, _ = run_filter_tick_without_plan(
            model,
            state,
            empty_readings(model)._replace(tension=cell),
            np.zeros(n),
            flags_without_contact(model),
        )
    whole_readings = readings_of(model, np.full(n, 2e-3), cell)
    state = state_after_first_readings(model, state, whole_readings.travel)
    for k in range(20):
        state, estimate = run_filter_tick_without_plan(
            model, state, whole_readings, cell, flags_without_contact(model)
        )
        assert np.abs(estimate.tension - (cell if k > SLACK_TICKS else cell / 2)).max() < 4.0, k


def regimes_of_readings(model: HandModel, cell_readings: list[float]) -> list[set[int]]:
    """Return one set of regimes for each tick: the regimes (free, held or slack) of all tendons in the tick.

    In all ticks, the motors are at rest. In each tick, all load cells read the next tension in
    ``cell_readings`` [N].
    """
    n = model.tendon_count
    x = np.zeros((n, STATE_COUNT))
    state = state_in_regime(model, TendonRegime.SLACK, x)._replace(stopped=(True,) * n)
    regimes_by_tick = []
    for cell in cell_readings:
        measured = noiseless_readings(model, x, np.full(n, cell))
        state, _ = run_filter_tick_without_plan(
            model,
            state,
            measured,
            np.full(n, max(cell, 0.0) if cell == cell else 0.0),
            flags_without_contact(model),
        )
        regimes_by_tick.append(set(state.regimes))
    return regimes_by_tick


def test_slack_ends_by_tension_and_not_by_noise(model: HandModel) -> None:
    assert (
        regimes_of_readings(model, [2.4, -2.4, 0.0, 2.4, 2.4, -0.3, 0.9, 0.6])
        == [{TendonRegime.SLACK}] * 8
    )
    assert regimes_of_readings(model, [MIN_TAUT_TENSION_N + 0.1] * 8)[-1] == {TendonRegime.HELD}, (
        "taut, and the springs hold the digit open"
    )
    assert regimes_of_readings(model, [np.nan] * 20)[-1] == {TendonRegime.SLACK}


def test_a_small_tension_ends_slack_after_a_few_ticks(model: HandModel) -> None:
    """A slowly wound tendon counts as taut before its tension reaches five standard deviations of the load-cell noise.

    The filter needs a few ticks to detect a tension below five standard deviations of the load-cell
    noise.
    """
    regimes_by_tick = regimes_of_readings(model, [0.2, 0.9, 1.2, 1.6, 1.7, 1.7])
    assert regimes_by_tick[2] == {TendonRegime.SLACK}
    assert TendonRegime.SLACK not in regimes_by_tick[-1]


def test_slack_needs_a_few_ticks_in_a_row(model: HandModel) -> None:
    taut_readings = [MIN_TAUT_TENSION_N + 1.0] * 30
    regimes_after_one_low_sample = regimes_of_readings(
        model, [*taut_readings, 0.0, *taut_readings[:5], 0.0, *taut_readings[:5]]
    )
    assert TendonRegime.SLACK not in set().union(
        *regimes_after_one_low_sample[len(taut_readings) :]
    ), "one low sample is noise"
    assert regimes_of_readings(model, [*taut_readings, *[-0.5] * 60])[-1] == {TendonRegime.SLACK}


def test_becoming_taut_takes_the_tension_from_the_load_cell(model: HandModel) -> None:
    n = model.tendon_count
    x = np.zeros((n, STATE_COUNT))
    x[:, X] = np.linspace(-2e-3, 2e-3, n)
    state = state_in_regime(model, TendonRegime.SLACK, x)._replace(stopped=(True,) * n)
    cell = np.full(n, 4.0)
    estimated_tensions = []
    for _ in range(60):
        state, estimate = run_filter_tick_without_plan(
            model, state, noiseless_readings(model, x, cell), cell, flags_without_contact(model)
        )
        estimated_tensions.append(estimate.tension)
        assert (
            (np.abs(estimate.tension) < 1e-9) | (np.abs(estimate.tension - cell) < 2.0)
        ).all(), "no overshoot"
    np.testing.assert_allclose(estimated_tensions[-1], cell, atol=0.5)
    np.testing.assert_allclose(
        estimate.stretch_offset, x[:, X] - cell / model.tendon_constants.stiffness, atol=1e-5
    )
    np.testing.assert_allclose(estimate.excursion, 0.0, atol=2e-5)


def test_a_stretch_offset_is_kept(model: HandModel) -> None:
    """In a hand that was not commissioned, the tendons have stretch offsets of several millimetres.

    The stretch offsets must not change the estimated excursions of the tendons.
    """
    n = model.tendon_count
    x, cell = np.zeros((n, STATE_COUNT)), np.full(n, 4.0)
    x[:, X] = 2e-3
    state = state_in_regime(model, TendonRegime.SLACK, x)._replace(stopped=(True,) * n)
    for _ in range(round(1.5 / model.period)):
        state, estimate = run_filter_tick_without_plan(
            model, state, noiseless_readings(model, x, cell), cell, flags_without_contact(model)
        )
    np.testing.assert_allclose(estimate.excursion, 0.0, atol=2e-6)
    np.testing.assert_allclose(estimate.tension, cell, atol=0.01)


def test_contact_holds_a_digit_without_a_jump(model: HandModel) -> None:
    x, _ = state_at_rest(model, 20.0, 0.7)
    n = model.tendon_count
    for _ in range(3):
        balance = static_tendon_forces(model, x, x[:, X] - x[:, S]).resistance
        x[:, X] = x[:, S] + balance / model.tendon_constants.stiffness
    measured = noiseless_readings(model, x, balance)
    free_state, estimate_before = run_filter_tick_without_plan(
        model,
        state_in_regime(model, TendonRegime.FREE, x),
        measured,
        balance,
        flags_without_contact(model),
    )
    held_state, estimate_after = run_filter_tick_without_plan(
        model,
        state_in_regime(model, TendonRegime.FREE, x),
        measured,
        balance,
        (True,) * len(model.digits),
    )
    assert set(free_state.regimes) == {TendonRegime.FREE}
    assert set(held_state.regimes) == {TendonRegime.HELD}
    assert np.abs(estimate_after.tension - estimate_before.tension).max() < 0.2
    assert np.abs(estimate_after.excursion - estimate_before.excursion).max() < 1e-6
    for state, contact, measured_now in (
        (held_state, (True,), measured),
        (held_state, (False,), measured),
    ):
        estimate, now = run_filter_tick_without_plan(
            model, state, measured_now, balance, contact * len(model.digits)
        )
        assert np.abs(now.tension - balance).max() < 0.4
        assert set(estimate.regimes) == {TendonRegime.HELD if contact[0] else TendonRegime.FREE}
    assert n == len(estimate_after.tension)


def test_load_of_an_object_is_external_tension(model: HandModel) -> None:
    """External tension is the part of a tendon's tension that the springs of the digit do not explain."""
    x, _ = state_at_rest(model, 20.0, 0.7)
    n = model.tendon_count
    requested_force = static_tendon_forces(model, x, np.zeros(n)).resistance
    tension = requested_force + 10.0
    x[:, X] = x[:, S] + tension / model.tendon_constants.stiffness
    state = state_in_regime(model, TendonRegime.HELD, x)
    for _ in range(40):
        state, estimate = run_filter_tick_without_plan(
            model,
            state,
            noiseless_readings(model, x, tension),
            tension,
            (True,) * len(model.digits),
        )
    np.testing.assert_allclose(estimate.external_tension, 10.0, atol=0.5)
    x0, rest_tension = np.zeros((n, STATE_COUNT)), np.full(n, 4.0)
    x0[:, X] = rest_tension / model.tendon_constants.stiffness
    state = state_in_regime(model, TendonRegime.HELD, x0)._replace(stopped=(True,) * n)
    state, estimate = run_filter_tick_without_plan(
        model,
        state,
        noiseless_readings(model, x0, rest_tension),
        rest_tension,
        flags_without_contact(model),
    )
    np.testing.assert_allclose(
        estimate.external_tension, 0.0, err_msg="the open stop is no contact"
    )


def test_joint_encoders_distinguish_excursion_from_offset(jamia11: HandModel) -> None:
    """Motor encoder and load cell measure only the sum of excursion and stretch offset.

    With joint encoders, the filter can separate the excursion from the stretch offset.
    """
    x, _ = state_at_rest(jamia11, 20.0, 0.7)
    balance = static_tendon_forces(jamia11, x, np.zeros(len(x))).resistance
    x[:, X] = x[:, S] + balance / jamia11.tendon_constants.stiffness
    ends = {}
    for with_encoders in (False, True):
        wrong_states = x.copy()
        wrong_states[:, S] += 2e-5
        wrong_states[:, O] -= 2e-5
        state = state_in_regime(jamia11, TendonRegime.HELD, wrong_states)
        for k in range(500):
            measured = noiseless_readings(
                jamia11, x, balance, excursion=with_encoders and k % 4 == 0
            )
            state, estimate = run_filter_tick_without_plan(
                jamia11, state, measured, balance, (True,) * len(jamia11.digits)
            )
        ends[with_encoders] = np.abs(estimate.excursion - x[:, S])
    assert (ends[True] < 0.35 * ends[False]).all()


def excursion_of(model: HandModel, joint_angles: np.ndarray) -> np.ndarray:
    """Compute the excursion of each tendon [m] from the joint-encoder readings [rad], and return the excursions.

    The excursion of a tendon is NaN if the reading of one of its joint encoders is missing.
    """
    state = active_state(model)
    state.mode = HandMode.SILENT
    state.view("joint_fresh")[...] = ~np.isnan(joint_angles)
    state.view("joint_angle")[...] = joint_angles
    tick_stages.observe_tick(state.block, state.layout.offsets, *constant_args_of(model))
    return state.view("measured_excursion")


def test_unread_joints_give_no_excursion(jamia11: HandModel, jamia: HandModel) -> None:
    joints = np.full(len(jamia11.hand.joints), 0.3)
    np.testing.assert_allclose(excursion_of(jamia11, joints), jamia11.hand.moment_arms @ joints)
    joints[1] = np.nan
    is_excursion_missing = np.isnan(excursion_of(jamia11, joints))
    assert is_excursion_missing.tolist() == (jamia11.hand.moment_arms[:, 1] != 0).tolist()
    assert np.isnan(excursion_of(jamia, np.full(len(jamia.hand.joints), np.nan))).all()


def test_the_filter_step_changes_none_of_its_arguments(model: HandModel) -> None:
    x, force = state_at_rest(model, 25.0, 0.6)
    state, measured = (
        state_in_regime(model, TendonRegime.FREE, x),
        noiseless_readings(model, x, np.full(len(x), 0.2)),
    )
    argument_copies = [
        state.filter_states.copy(),
        measured.travel.copy(),
        measured.tension.copy(),
        force.copy(),
    ]
    first_state = run_filter_tick_without_plan(
        model, state, measured, force, flags_without_contact(model)
    )[0]
    second = run_filter_tick_without_plan(
        model, state, measured, force, flags_without_contact(model)
    )[0]
    for array_now, array_before in zip(
        (state.filter_states, measured.travel, measured.tension, force),
        argument_copies,
        strict=True,
    ):
        np.testing.assert_array_equal(array_now, array_before)
    np.testing.assert_array_equal(first_state.filter_states, second.filter_states)
    assert first_state.regimes == second.regimes


def test_a_digit_held_just_above_its_stop_is_not_on_it(model: HandModel) -> None:
    """In this test, friction holds an opening digit just before it reaches its mechanical stop.

    If the filter wrongly assumed that the digit is at the stop, the error of the estimated angle
    would grow each time the digit opens.
    """
    x = np.zeros((model.tendon_count, STATE_COUNT))
    x[:, S] = 1e-5
    cell = 0.9 * static_tendon_forces(model, x, np.zeros(len(x))).resistance
    x[:, X] = x[:, S] + cell / model.tendon_constants.stiffness
    state, _ = run_filter_tick_without_plan(
        model,
        state_in_regime(model, TendonRegime.FREE, x),
        noiseless_readings(model, x, cell),
        cell,
        flags_without_contact(model),
    )
    assert not any(state.stopped)


def test_a_digit_that_comes_to_rest_on_its_stop_has_no_excursion(model: HandModel) -> None:
    """When an opening digit comes to rest at its mechanical stop, the filter sets the estimated excursion to zero.

    When the filter sets the excursion to zero, it adds the previous estimate of the excursion to
    the stretch offset.
    """
    x = np.zeros((model.tendon_count, STATE_COUNT))
    x[:, S], x[:, O], x[:, W] = 1.5e-5, -4e-5, 1e-3
    cell = np.full(len(x), 4.0)
    x[:, X] = x[:, S] + x[:, O] + cell / model.tendon_constants.stiffness
    state, estimate = run_filter_tick_without_plan(
        model,
        state_in_regime(model, TendonRegime.HELD, x),
        noiseless_readings(model, x, cell),
        cell,
        flags_without_contact(model),
    )
    assert all(state.stopped)
    table = state.filter_states.reshape(-1, STATE_COUNT)
    np.testing.assert_allclose(table[:, O], -2.5e-5, atol=2e-6)
    np.testing.assert_allclose(table[:, S], 0.0, atol=1e-9)
    np.testing.assert_allclose(table[:, W], 0.0, atol=1e-9)
    np.testing.assert_allclose(estimate.tension, cell, atol=0.1)


def test_friction_whose_direction_is_known_is_no_contact(model: HandModel) -> None:
    x, force = state_at_rest(model, 25.0, 0.6)
    state, zero_vector = (
        state_in_regime(model, TendonRegime.FREE, x),
        np.zeros(model.tendon_count),
    )
    external_tensions = []
    for direction in (None, 1.0, -1.0):
        friction_direction = None if direction is None else np.full(model.tendon_count, direction)
        args = (model, state, noiseless_readings(model, x, force), force, zero_vector)
        state_after, estimate = run_filter_tick(
            *args, flags_without_contact(model), friction_state=friction_direction
        )
        assert set(state_after.regimes) == {TendonRegime.FREE}
        touching, estimate_in_contact = run_filter_tick(
            *args, (True,) * len(model.digits), friction_state=friction_direction
        )
        assert set(touching.regimes) == {TendonRegime.HELD}
        np.testing.assert_allclose(
            estimate_in_contact.external_tension, estimate.external_tension, atol=0.02
        )
        force_at_joints = static_tendon_forces(model, x, force, friction_direction).force_at_joints
        resistance = static_tendon_forces(model, x, force, friction_direction).resistance
        np.testing.assert_allclose(
            estimate.external_tension, force_at_joints - resistance, atol=0.02
        )
        external_tensions.append(estimate.external_tension)
    assert (external_tensions[1] < external_tensions[0] - 0.5).all(), (
        "winding, friction takes from what the load cell shows"
    )
    assert (external_tensions[2] > external_tensions[0] + 0.5).all()


def test_evidence_of_slack_is_cleared_once_a_tendon_is_taut(model: HandModel) -> None:
    x, force = state_at_rest(model, 25.0, 0.6)
    state = state_in_regime(model, TendonRegime.FREE, x)._replace(
        regime_change_evidence=(1,) * model.tendon_count
    )
    state_after, _ = run_filter_tick_without_plan(
        model, state, noiseless_readings(model, x, force), force, flags_without_contact(model)
    )
    assert state_after.regime_change_evidence == (0,) * model.tendon_count
