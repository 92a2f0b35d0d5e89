"""Test the design of the tension filter.

Compare the discrete model with the differential equations of a tendon. Compare the filter gains
with the gains that a second solver computes.
"""

import itertools
import weakref

import numpy as np
import pytest

from handctl.core import constants as h
from handctl.core.estimation.filter_types import (
    STATE_COUNT,
    TRANSITION_CACHE_SIZE,
    E,
    FilterDesign,
    O,
    S,
    TendonRegime,
    X,
)
from handctl.core.gains.filter_design import design_filter
from handctl.core.gains.gains import FilterGains, Gains
from handctl.core.hand_model import HandModel, _joint_period
from handctl.hand.hand_loading import load_hand
from tests.controller.filter_oracle import (
    FILTER_STATE_UNITS,
    assumed_measurements,
    covariance_by_doubling,
    integrate_one_period,
    measurement_noise,
)
from tests.controller.synthetic_states import constant_tables_of


class FilterDesigns:
    """Filter designs of the packaged hands at a chosen control rate."""

    def __init__(self, model_by_hand: dict[str, HandModel]) -> None:
        self.models = model_by_hand

    def filter_design_of(self, hand_name: str, rate_hz: float) -> FilterDesign:
        model = self.models[hand_name]
        return design_filter(
            model.tendon_constants,
            FilterGains(),
            1.0 / rate_hz,
            _joint_period(model.hand, 1.0 / rate_hz),
        )


@pytest.fixture
def filter_designs(jamia: HandModel, jamia11: HandModel) -> FilterDesigns:
    return FilterDesigns({"jamia": jamia, "jamia11": jamia11})


def first_and_last_tendon(model: HandModel) -> list[int]:
    """Return the index of the first tendon of the first finger, and the index of the last tendon of the thumb."""
    return [0, model.tendon_count - 1]


@pytest.mark.parametrize("regime", TendonRegime)
def test_discrete_model_and_gains_agree_with_the_differential_equations(
    model: HandModel, regime: TendonRegime
) -> None:
    for i in first_and_last_tendon(model):
        block = model.filter_design.blocks[i][regime]
        F, G, Q = integrate_one_period(model, i, regime)
        np.testing.assert_allclose(
            block.F * FILTER_STATE_UNITS / FILTER_STATE_UNITS[:, None], F, rtol=1e-7, atol=1e-8
        )
        np.testing.assert_allclose(block.B / FILTER_STATE_UNITS[:, None], G, rtol=1e-7, atol=1e-8)
        H, R = (
            assumed_measurements(block, regime) * FILTER_STATE_UNITS,
            np.diag(measurement_noise(model, i) ** 2),
        )
        P = covariance_by_doubling(F, H, Q, R)
        innovation = H @ P @ H.T + R
        gain = np.linalg.solve(innovation, H @ P).T
        gain[E] *= regime == TendonRegime.SLACK
        np.testing.assert_allclose(
            block.K[:, :2] / FILTER_STATE_UNITS[:, None],
            gain,
            rtol=1e-5,
            atol=1e-6 * np.abs(gain).max(),
        )
        row, gains = block.tension_row * FILTER_STATE_UNITS, model.gains.filter
        drift = (
            0.0
            if regime == TendonRegime.SLACK
            else gains.cell_drift_N**2 * gains.cell_tared_s / gains.cell_drift_time_s
        )
        np.testing.assert_allclose(block.tension_variance, row @ P @ row + drift, rtol=1e-6)
        np.testing.assert_allclose(
            block.innovation_information, np.linalg.inv(innovation), rtol=1e-5, atol=1e-6
        )


@pytest.mark.parametrize("regime", TendonRegime)
def test_measurement_rows_predict_the_measurements(model: HandModel, regime: TendonRegime) -> None:
    for i, blocks in enumerate(model.filter_design.blocks):
        H, row = blocks[regime].H, blocks[regime].tension_row
        state = np.array([3e-4, 0.01, 1e-4, 0.002, 5.0, 7.0, 4e-5])
        is_taut = regime != TendonRegime.SLACK
        tension = (
            (
                model.tendon_constants.stiffness[i] * 1.6e-4
                + model.tendon_constants.damping[i] * 0.008
            )
            if is_taut
            else 0.0
        )
        np.testing.assert_allclose(row @ state, tension, rtol=1e-12)
        np.testing.assert_allclose(H @ state, [state[X], tension + state[E], state[S]], rtol=1e-12)


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 200.0, 250.0, 400.0, 500.0, 1000.0])
@pytest.mark.parametrize("hand_name", ["jamia", "jamia11"])
def test_every_regime_is_stable_at_every_rate(
    hand_name: str, rate_hz: float, filter_designs: FilterDesigns
) -> None:
    design = filter_designs.filter_design_of(hand_name, rate_hz)
    for blocks in design.blocks:
        for block in blocks:
            error = block.F @ (np.eye(STATE_COUNT) - block.K @ block.H)
            assert np.abs(np.linalg.eigvals(error)).max() < 1.0
            gain_without_joint_encoder = block.K.copy()
            gain_without_joint_encoder[:, 2] = 0.0
            assert (
                np.abs(
                    np.linalg.eigvals(
                        block.F @ (np.eye(STATE_COUNT) - gain_without_joint_encoder @ block.H)
                    )
                ).max()
                < 1.0
            ), "no joint frame"


def test_joint_encoders_separate_excursion_from_offset_and_nothing_else(
    jamia: HandModel, jamia11: HandModel
) -> None:
    gains = jamia11.gains.filter
    ticks_per_joint_frame = jamia11.hand.sensor_node.joint_decimation
    for blocks in jamia11.filter_design.blocks:
        for block in blocks:
            remaining_fraction = (1.0 - block.K[S, 2]) ** (
                gains.joint_time_s / (ticks_per_joint_frame * jamia11.period)
            )
            np.testing.assert_allclose(remaining_fraction, np.exp(-1.0), rtol=1e-9)
            assert block.K[O, 2] == -block.K[S, 2]
            assert not np.delete(block.K[:, 2], [S, O]).any()
            np.testing.assert_allclose(block.tension_row @ block.K[:, 2], 0.0, atol=1e-9)
    assert not any(
        block.K[:, 2].any() for blocks in jamia.filter_design.blocks for block in blocks
    ), "no joint encoders"


def test_the_transition_of_all_tendons_is_that_of_its_blocks(
    model: HandModel, rng: np.random.Generator
) -> None:
    n = model.tendon_count
    kinds = rng.integers(0, 2 * len(TendonRegime), n)
    transition = model.filter_design.transition(kinds.tobytes())
    x, u = rng.normal(size=(n, STATE_COUNT)), rng.normal(size=(n, 2))
    moved, driven = (
        (transition.F @ x.T.ravel()).reshape(STATE_COUNT, n).T,
        (transition.B @ u.T.ravel()).reshape(STATE_COUNT, n).T,
    )
    for i, kind in enumerate(kinds.tolist()):
        block = model.filter_design.blocks[i][kind]
        np.testing.assert_allclose(moved[i], block.F @ x[i], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(driven[i], block.B @ u[i], rtol=1e-9, atol=1e-12)


def test_the_constants_of_the_kernels_are_the_blocks(model: HandModel) -> None:
    """The kernels get all arrays of the filter design, and variances that were computed from these arrays."""
    design = constant_tables_of(model).design
    assert design.shape == (model.tendon_count, h.FILTER_DESIGN_COUNT, h.FILTER_DESIGN_SIZE)
    offset_by_matrix_name = {
        "F": h.TRANSITION_MATRIX_OFFSET,
        "B": h.INPUT_MATRIX_OFFSET,
        "K": h.KALMAN_GAIN_OFFSET,
        "Q": h.PROCESS_NOISE_OFFSET,
        "R": h.MEASUREMENT_NOISE_OFFSET,
        "P": h.COVARIANCE_OFFSET,
        "H": h.MEASUREMENT_MATRIX_OFFSET,
    }
    for blocks_of_tendon, rows in zip(model.filter_design.blocks, design, strict=True):
        for block, row in zip(blocks_of_tendon, rows, strict=True):
            for name, first_element in {
                **offset_by_matrix_name,
                "tension_row": h.TENSION_ROW_OFFSET,
            }.items():
                matrix = getattr(block, name)
                np.testing.assert_array_equal(
                    row[first_element : first_element + matrix.size].reshape(matrix.shape),
                    matrix,
                    err_msg=name,
                )
            information = np.array([[1.0, 0.5], [0.5, 1.0]]) * block.innovation_information
            stored_information = row[h.INFORMATION_OFFSET : h.INFORMATION_OFFSET + 3]
            np.testing.assert_allclose(
                [information[0, 0], 4 * information[0, 1], information[1, 1]], stored_information
            )
            assert row[h.TENSION_VARIANCE_OFFSET] == block.tension_variance
            np.testing.assert_allclose(
                row[h.CELL_SIGMA_OFFSET] ** 2, np.linalg.inv(block.innovation_information)[1, 1]
            )
            assert row[h.CELL_ERROR_VARIANCE_OFFSET] == block.cell_error_variance
            assert row[h.CELL_ERROR_OBSERVABLE_OFFSET] == block.is_cell_error_observable


def test_transitions_of_many_regimes_use_bounded_memory(jamia: HandModel) -> None:
    design = FilterDesign(jamia.filter_design.blocks * 2)
    kinds = [
        np.array(kinds_of_tendons)
        for kinds_of_tendons in itertools.islice(
            itertools.product(range(3), repeat=8), 2 * TRANSITION_CACHE_SIZE
        )
    ]
    transition_references = [
        weakref.ref(design.transition(kinds_of_tendons.tobytes()).F) for kinds_of_tendons in kinds
    ]
    assert sum(F() is not None for F in transition_references) <= TRANSITION_CACHE_SIZE
    last_kinds = kinds[-1].tobytes()
    assert design.transition(last_kinds) is design.transition(last_kinds)


def test_asking_for_other_gains_gives_other_filters() -> None:
    hand = load_hand("jamia")
    model_with_packaged_gains = HandModel.from_hand(hand, Gains(), 500.0)
    model_with_larger_rate = HandModel.from_hand(
        hand, Gains(filter=FilterGains(free_rate_N_per_s=900.0)), 500.0
    )
    free_tension_variances = [
        m.filter_design.blocks[0][TendonRegime.FREE].tension_variance
        for m in (model_with_packaged_gains, model_with_larger_rate)
    ]
    assert free_tension_variances[1] > free_tension_variances[0], (
        "who trusts the model less knows the tension less"
    )


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def test_tendons_that_are_alike_share_a_design(jamia11: HandModel) -> None:
    """Tendons of equal fingers share one filter design.

    The filter designs of thumb and finger tendons differ, because a thumb tendon moves another mass
    than a finger tendon.
    """
    blocks = dict(zip(jamia11.hand.tendon_names, jamia11.filter_design.blocks, strict=True))
    assert blocks["index_t1"] is blocks["ring_t1"]
    assert len({id(kinds_of_tendons) for kinds_of_tendons in blocks.values()}) == 5
