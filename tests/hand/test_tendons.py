"""Test the elastic law of a tendon, and the statics of tendons and joints."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import load_hand
from handctl.hand.tendons import (
    TendonElasticity,
    effective_moment_arms,
    excursions,
    pulley_factors,
    reflected_inertia,
)

TENDON_ELASTICITIES = [
    TendonElasticity.from_tendon(load_hand("jamia").tendon[0]),
    TendonElasticity(
        stiffness=1e5, stiffness_beyond_knee=3e5, knee=200.0, knee_width=3e-4, damping=30.0
    ),
    TendonElasticity(
        stiffness=7e4, stiffness_beyond_knee=7e2, knee=50.0, knee_width=1e-5, damping=0.0
    ),
]
for_each_elasticity = pytest.mark.parametrize(
    "law", TENDON_ELASTICITIES, ids=["softening", "hardening", "nearly plastic"]
)


@for_each_elasticity
def test_the_knee_is_smooth(law):
    knee_stretch = law.knee / law.stiffness
    for h in (1e-9, 1e-10):
        assert math.isclose(
            law.elastic_tension(knee_stretch - h),
            law.elastic_tension(knee_stretch + h),
            abs_tol=2.1 * h * law.stiffness,
        )
        assert math.isclose(
            law.tangent_stiffness(knee_stretch - h),
            law.tangent_stiffness(knee_stretch + h),
            rel_tol=1.1 * h / law.knee_width * 4,
        )
    assert math.isclose(law.elastic_tension(knee_stretch), law.knee, rel_tol=1e-12)
    assert math.isclose(law.tangent_stiffness(1.0), law.stiffness_beyond_knee, rel_tol=1e-9)


@for_each_elasticity
def test_tension_is_the_integral_of_the_tangent_stiffness(law):
    knee_stretch = law.knee / law.stiffness
    for stretch in np.linspace(0.1, 3.0, 12) * knee_stretch:
        total, _ = quad(
            law.tangent_stiffness,
            0.0,
            stretch,
            points=[knee_stretch] if stretch > knee_stretch else None,
            epsrel=1e-11,
        )
        assert math.isclose(law.elastic_tension(stretch), total, rel_tol=1e-8)


@for_each_elasticity
def test_stretch_is_the_exact_inverse(law):
    for tension in np.concatenate(
        (np.geomspace(1e-9, 3000.0, 300), law.knee + np.geomspace(1e-12, 10.0, 50))
    ):
        assert math.isclose(law.elastic_tension(law.stretch(tension)), tension, rel_tol=1e-13)
    assert law.stretch(0.0) == 0.0
    for tension in (-1e-9, math.nan, math.inf):
        with pytest.raises(ValueError, match="no stretch"):
            law.stretch(tension)


@for_each_elasticity
def test_tension_rises_with_stretch(law):
    tensions = [law.elastic_tension(stretch) for stretch in np.linspace(0.0, 5e-3, 2000)]
    assert (np.diff(tensions) > 0.0).all()


@for_each_elasticity
def test_a_slack_or_slackening_tendon_never_pushes(law, rng):
    for stretch, rate in zip(
        rng.normal(size=2000) * 2e-3, rng.normal(size=2000) * 5.0, strict=True
    ):
        tension = law.tension(stretch, rate)
        assert tension >= 0.0
        if stretch <= 0.0:
            assert tension == law.elastic_tension(stretch) == law.tangent_stiffness(stretch) == 0.0
        elif tension > 0.0:
            assert math.isclose(
                tension, law.elastic_tension(stretch) + law.damping * rate, rel_tol=1e-12
            )
        else:
            assert law.damping * rate <= -law.elastic_tension(stretch)


def test_known_numbers_of_the_packaged_tendon():
    elasticity = TENDON_ELASTICITIES[0]
    assert math.isclose(elasticity.stretch(110.0), 1.1e-3, rel_tol=1e-12)
    assert math.isclose(elasticity.knee / elasticity.stiffness, 2.0e-3, rel_tol=1e-12)
    tension_beyond_knee = 200.0 + 0.4e5 * 1e-3 + 0.6e5 * 3e-4 * (1 - math.exp(-1e-3 / 3e-4))
    assert math.isclose(elasticity.elastic_tension(3e-3), tension_beyond_knee, rel_tol=1e-12)


def test_work_of_tendons_is_work_of_joints(digits, rng):
    """The work f . ds of the tendon tensions f equals the work tau . dq of the joint torques tau.

    The vector ds is the change of the tendon excursions, and dq is the change of the joint angles.
    """
    for digit in digits:
        for _ in range(50):
            q, move = rng.normal(size=(2, digit.joint_count))
            tension = rng.uniform(3.0, 110.0, len(digit.tendon_names))
            travel = excursions(digit, q + move) - excursions(digit, q)
            torque = digit.moment_arms.T @ tension
            assert math.isclose(tension @ travel, torque @ move, rel_tol=1e-12, abs_tol=1e-12)


def test_flexing_a_joint_winds_its_tendon(digits):
    for digit in digits:
        is_closing = digit.moment_arms.sum(axis=1) > 0.0
        assert ((excursions(digit, np.full(digit.joint_count, 0.5)) > 0.0) == is_closing).all(), (
            "the spool of an extensor unwinds"
        )


def test_friction_follows_the_capstan_equation(digits, rng):
    for digit in digits:
        q = rng.uniform(0.0, 1.6, digit.joint_count)
        count = len(digit.tendon_names)
        assert np.array_equal(
            pulley_factors(digit, q, np.zeros(count)), np.ones_like(digit.moment_arms)
        )
        assert np.array_equal(effective_moment_arms(digit, q, np.zeros(count)), digit.moment_arms)
        winding_factors = pulley_factors(digit, q, np.full(count, 1.0))
        for t in range(count):
            wrap_angle = digit.wrap[t]
            for j in range(digit.joint_count):
                wrap_angle += q[j] if digit.moment_arms[t, j] else 0.0
                assert math.isclose(
                    winding_factors[t, j], math.exp(-digit.friction[t] * wrap_angle), rel_tol=1e-12
                )
        paying_out_factors = pulley_factors(digit, q, np.full(count, -1.0))
        assert np.allclose(winding_factors * paying_out_factors, 1.0, rtol=1e-12)
        slow_winding_factors = pulley_factors(digit, q, np.full(count, 1e-3))
        assert (winding_factors < slow_winding_factors).all()
        assert (slow_winding_factors < 1.0).all()


def test_friction_of_a_closed_grasp_is_a_fifth_to_a_third():
    digit = DigitModel.from_hand(load_hand("jamia"), "index")
    assert math.isclose(
        1 / pulley_factors(digit, (1.6, 0.0, 0.0), (1.0,))[0, 0], 1.29, rel_tol=3e-3
    )


def test_rotor_outweighs_the_finger():
    assert np.allclose(
        reflected_inertia(DigitModel.from_hand(load_hand("jamia"), "index")), 4.2e-4, rtol=5e-3
    )


def test_reflected_inertia_is_the_rotors_kinetic_energy(hand, digits, rng):
    for digit in digits:
        speed = rng.normal(size=digit.coupling.shape[1])
        tendon_speeds = digit.moment_arms @ digit.coupling @ speed
        motors = [hand.motor_of_tendon(name) for name in digit.tendon_names]
        energy = sum(
            m.inertia_kg_m2 * (v / m.spool_radius_m) ** 2 / 2
            for m, v in zip(motors, tendon_speeds, strict=True)
        )
        assert math.isclose(speed @ reflected_inertia(digit) @ speed / 2, energy, rel_tol=1e-12)


def test_one_tendon_per_joint_pulls_the_absolute_torques():
    """Check the tensions of a digit with one tendon per joint and the moment arm r at every joint.

    The matrix of the moment arms is R = r S, where S is the lower triangular matrix of ones. The
    tension of a tendon times the moment arm r equals the torque of its joint minus the torque of
    the next joint.
    """
    digit = DigitModel.from_hand(load_hand("jamia11"), "ring")
    tau = np.array([0.33, 0.15, 0.06])
    assert np.allclose(digit.torque_to_tension @ tau * 0.003, [0.18, 0.09, 0.06], rtol=1e-9)


def test_maps_between_tendon_and_joint_space_are_inverse(digits, rng):
    for digit in digits:
        theta = rng.normal(size=digit.coupling.shape[1])
        q = digit.coupling @ theta
        assert np.allclose(digit.excursion_to_joints @ excursions(digit, q), q, rtol=1e-9)
        assert np.allclose(digit.joints_to_coordinates @ q, theta, rtol=1e-9)
        tau = rng.normal(size=digit.joint_count)
        computed_torque = digit.reduced_moment_arms.T @ digit.torque_to_tension @ tau
        assert np.allclose(computed_torque, digit.coupling.T @ tau, rtol=1e-9)
