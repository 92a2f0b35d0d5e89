"""Test the design of controller gains.

The simulated hands of an ensemble have different parameters. Designed gains have the required
stability margins for all hands of an ensemble.
"""

import math

import numpy as np
import pytest
from scipy.signal import cont2discrete

from handctl.controller.bus_load import bus_loads
from handctl.core.gains.gains import Gains, packaged_gains
from handctl.core.hand_model import HandModel
from handctl.core.identified_parameters import IdentifiedParameters
from handctl.hand.hand_loading import load_hand, packaged_hands
from handctl.session.run_plan import control_rate
from handctl.tune.loops.gain_design import (
    design_gains,
    design_with_poles,
    distinct_tendons,
    gains_with_poles,
    keeps_required_margins,
    linear_factors,
    model_with_gains,
    worst_margins,
)
from handctl.tune.loops.linear_models import LoopKind, PlantFactors
from handctl.tune.search.ensemble import MIN_FACTOR_SPREAD, factor_half_widths, sample_ensemble
from tests.conftest import NIGHTLY

DEFAULT_PLANT_COUNT = 8
"""Number of plants (simulated hands) in the default ensemble of `tune design`."""
REDUCED_PLANT_COUNT = 2
"""Number of plants (simulated hands) for a hand with many different tendons, in an ordinary test run."""


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_the_packaged_gains_keep_their_margins(hand_name: str) -> None:
    """Reproduce a defect: with the gains of the hand jamia, the hand orca_like oscillated at 140 Hz.

    With the gains of the hand jamia, the hand t42 had a gain margin of only 2.4 dB.
    """
    hand = load_hand(hand_name)
    model = HandModel.from_hand(
        hand, packaged_gains(hand_name), control_rate(None, hand, bus_loads(hand))
    )
    count = (
        DEFAULT_PLANT_COUNT if len(distinct_tendons(model)) < 5 or NIGHTLY else REDUCED_PLANT_COUNT
    )
    margins = worst_margins(
        model, tuple(linear_factors(plant_factors) for plant_factors in sample_ensemble(count, 0))
    )
    assert margins.are_sufficient, margins


def test_a_heavy_digit_does_not_make_a_light_one_slow() -> None:
    """The design can lower the force weight of a heavy digit so that the digit's control loop stays stable.

    The force weight of the heavy digit does not change the force weights of other digits.
    """
    hand = load_hand("t42")
    left_digit, right_digit = hand.digit
    heavy_digit = left_digit.model_copy(
        update={"link_mass_kg": tuple(20.0 * mass for mass in left_digit.link_mass_kg)}
    )
    model = HandModel.from_hand(
        hand.model_copy(update={"digit": (heavy_digit, right_digit)}), packaged_gains("t42"), 500.0
    )
    plants = (PlantFactors(),)
    design_of_light_digits = design_gains(
        HandModel.from_hand(hand, packaged_gains("t42"), 500.0), plants
    )
    assert design_of_light_digits.gains.tendon == ()
    gain_design = design_gains(model, plants)
    assert gain_design.worst_margins_after.are_sufficient
    (light_tendon_gains,) = gain_design.gains.tendon
    assert light_tendon_gains.name == "right_flexor"
    assert light_tendon_gains.motion_force_N == pytest.approx(
        design_of_light_digits.gains.motion.force_N, rel=0.1
    )
    assert gain_design.gains.motion.force_N < 0.5 * design_of_light_digits.gains.motion.force_N
    # Without separate force weights, the tendons of both digits would have the small force weight
    # that the heavy digit requires.
    shared_gains = gain_design.gains.model_copy(update={"tendon": ()})
    assert model_with_gains(model, shared_gains).motion_design.stiffness[
        1
    ] < 0.6 * stiffness_of_motion_loop(model, gain_design.gains)
    redesigned_model = model_with_gains(model, gain_design.as_weights())
    assert np.allclose(
        redesigned_model.motion_design.stiffness,
        model_with_gains(model, gain_design.gains).motion_design.stiffness,
        rtol=1e-6,
    )


def stiffness_of_motion_loop(model: HandModel, gains: Gains) -> float:
    """Return the stiffness of the second tendon's motion loop: acceleration per excursion error [1/s^2].

    The function designs the motion loop with the weights in ``gains``.
    """
    return float(model_with_gains(model, gains).motion_design.stiffness[1])


def test_a_design_keeps_its_margins_and_more_authority_does_not(jamia: HandModel) -> None:
    plants = tuple(linear_factors(plant_factors) for plant_factors in sample_ensemble(2, 0))
    gains_with_large_force = Gains.model_validate(
        {"motion": {"force_N": 60.0}, "tension": {"force_N": 20.0}}
    )
    jamia = model_with_gains(
        jamia, gains_with_large_force.model_copy(update={"filter": jamia.gains.filter})
    )
    assert not keeps_required_margins(jamia, plants)
    gain_design = design_gains(jamia, plants)
    assert gain_design.worst_margins_after.are_sufficient
    assert not gain_design.worst_margins_before.are_sufficient
    assert keeps_required_margins(model_with_gains(jamia, gain_design.gains), plants)
    gains_with_larger_force = gain_design.gains.model_copy(
        update={
            "tension": gain_design.gains.tension.model_copy(
                update={"force_N": 1.3 * gain_design.gains.tension.force_N}
            )
        }
    )
    assert not keeps_required_margins(model_with_gains(jamia, gains_with_larger_force), plants)
    redesigned_model = model_with_gains(jamia, gain_design.as_weights())
    assert np.allclose(
        redesigned_model.motion_design.stiffness,
        model_with_gains(jamia, gain_design.gains).motion_design.stiffness,
        rtol=1e-6,
    )


def test_a_filter_that_leaves_no_margin_is_refused(jamia: HandModel) -> None:
    gains_without_rejection = Gains.model_validate({"motion": {"disturbance_rejection": 0.0}})
    with pytest.raises(ValueError, match="margins"):
        design_gains(
            model_with_gains(jamia, gains_without_rejection), (PlantFactors(torque_constant=30.0),)
        )


@pytest.mark.parametrize("pole_frequency_hz", [3.0, 6.0])
def test_the_closed_loop_has_the_requested_poles(
    jamia: HandModel, pole_frequency_hz: float
) -> None:
    """The closed loop has the requested poles.

    The test computes the poles for a single mass (rotor and digit) under sampled state feedback.
    In this test, the control rate is far above the frequencies of the poles.
    """
    gains = gains_with_poles(jamia, LoopKind.MOTION, pole_frequency_hz, 1.0)
    fast_model = HandModel.from_hand(jamia.hand, gains, 4000.0)
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    F, G, *_ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), fast_model.period)
    K = np.array([[fast_model.motion_design.stiffness[0], fast_model.motion_design.damping[0]]])
    poles = np.log(np.linalg.eigvals(F - G @ K)) / fast_model.period
    assert np.abs(poles) / (2.0 * math.pi) == pytest.approx(
        [pole_frequency_hz, pole_frequency_hz], rel=0.03
    )


@pytest.mark.parametrize(
    ("pole_frequency_hz", "damping_ratio", "expected_message"),
    [
        ((5.0, 3.0), 1.0, "no weights .* above 22.1 Hz"),
        ((6.0, 25.0), 0.7, "no weights .* more than 0.71"),
        ((0.01, 60.0), 100.0, "position_error_m: 609.* 0.1$"),
    ],
)
def test_placed_poles_that_no_weights_have_are_refused(
    jamia: HandModel,
    pole_frequency_hz: tuple[float, float],
    damping_ratio: float,
    expected_message: str,
) -> None:
    """The error message of a refused design proposes poles, or a weight, with which the design would be possible."""
    with pytest.raises(ValueError, match=expected_message):
        design_with_poles(jamia, (PlantFactors(),), *pole_frequency_hz, damping_ratio)


def test_an_ensemble_is_at_least_as_wide_as_its_minimum_spread() -> None:
    drawn_ensemble = sample_ensemble(65, 3, {"stiffness": 0.01, "mass": 0.4})
    assert drawn_ensemble[0] == dict.fromkeys(MIN_FACTOR_SPREAD, 1.0)
    assert (
        sample_ensemble(65, 3, {"stiffness": 0.01, "mass": 0.4})
        == drawn_ensemble
        != sample_ensemble(65, 4)
    )
    stiffness, mass = (
        np.array([plant_factors[key] for plant_factors in drawn_ensemble])
        for key in ("stiffness", "mass")
    )
    assert 0.8 <= stiffness.min() < 0.83
    assert 1.17 < stiffness.max() <= 1.2
    assert mass.min() < 0.65


def identification_of_tendon(tendon_stiffness: float, half_width: float) -> IdentifiedParameters:
    """Return identified parameters of one tendon: a stiffness and a delay.

    ``half_width`` is the half width of the stiffness's confidence interval.
    """
    return IdentifiedParameters(
        names=("tendon_stiffness", "delay"),
        values=(tendon_stiffness, 1e-3),
        half_widths=(half_width, 1e-4),
        covariance=((1.0, 0.0), (0.0, 1.0)),
    )


def test_an_uncertain_identification_widens_the_ensemble_to_its_intervals() -> None:
    spread = factor_half_widths(
        {
            "index_tendon": identification_of_tendon(5e4, 1.5e4),
            "thumb_tendon": identification_of_tendon(5e4, 2e4),
        }
    )
    assert spread == {"stiffness": pytest.approx(0.4)}
    stiffness_factors = [
        plant_factors["stiffness"] for plant_factors in sample_ensemble(65, 0, spread)
    ]
    assert min(stiffness_factors) < 0.62
    assert max(stiffness_factors) > 1.38


def test_the_worst_of_an_ensemble_is_no_better_than_the_nominal_plant(jamia: HandModel) -> None:
    plants = tuple(linear_factors(plant_factors) for plant_factors in sample_ensemble(3, 1))
    assert worst_margins(jamia, plants).shortfall >= worst_margins(jamia, plants[:1]).shortfall
