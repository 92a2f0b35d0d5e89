"""The linear models of the control loops predict the behaviour of the running controller.

The stability margins of the linear models equal those that the package `control` computes.
"""

import math

import numpy as np
import pytest
from control import frd, ss, stability_margins

from handctl.core.gains.gains import Gains, packaged_gains
from handctl.core.hand_model import HandModel
from handctl.hand.hand_loading import load_hand, packaged_hands
from handctl.tune.loops import linear_models
from handctl.tune.loops.linear_models import (
    LoopKind,
    PlantFactors,
    controller_system,
    open_loop,
    plant_system,
)
from handctl.tune.loops.margins import frequency_grid, margins_of_loop, step_response

LOOP_KINDS = list(LoopKind)


@pytest.mark.parametrize("loop_kind", LOOP_KINDS)
@pytest.mark.parametrize("hand_name", ["jamia", "jamia11"])
def test_the_linear_controller_predicts_the_running_one(
    hand_name: str, loop_kind: LoopKind, request: pytest.FixtureRequest
) -> None:
    """Compare one tick of the controller, near the operating point, with the prediction of the linear model."""
    model: HandModel = request.getfixturevalue(hand_name)
    K = controller_system(model, 0, loop_kind)
    tick, state, reading, steps = linear_models._operating_point(model, 0, loop_kind)
    centre, random = tick(state, reading), np.random.default_rng(0)
    for _ in range(10):
        state_step = steps * random.normal(size=len(state))
        reading_step = np.array([1e-7, 1e-2, 1e-7]) * random.normal(size=3)
        state_change = tick(state + state_step, reading + reading_step) - centre
        predicted_state = np.concatenate(
            [K.A @ state_step + K.B @ reading_step, K.C @ state_step + K.D @ reading_step]
        )
        scale = np.append(steps, 1e-6)
        assert (
            np.abs((predicted_state - state_change) / scale).max()
            < 1e-3 * np.abs(state_change / scale).max()
        )


@pytest.mark.parametrize("loop_kind", LOOP_KINDS)
def test_a_tick_acts_on_the_samples_of_the_tick_before(
    jamia: HandModel, loop_kind: LoopKind
) -> None:
    """Compare the impulse response of the open-loop model with a simulation of plant and controller.

    On the bus, a tick of the controller gets the sensor samples of the previous tick. The
    simulation of this test therefore gives the controller the sensor samples of the previous tick.
    """
    P, K, L = (
        plant_system(jamia, 0, loop_kind),
        controller_system(jamia, 0, loop_kind),
        open_loop(jamia, 0, loop_kind),
    )
    p, state_of_controller, sample, state = P.B[:, 0], np.zeros(len(K.A)), np.zeros(3), L.B[:, 0]
    for k in range(1, 30):
        controller_output = float((K.C @ state_of_controller + K.D @ sample)[0])
        assert float((L.C @ state)[0]) == pytest.approx(-controller_output, rel=1e-9, abs=1e-12)
        assert k > 1 or controller_output == 0.0
        state_of_controller, sample, p = K.A @ state_of_controller + K.B @ sample, P.C @ p, P.A @ p
        state = L.A @ state


@pytest.mark.parametrize("loop_kind", LOOP_KINDS)
@pytest.mark.parametrize("hand_name", packaged_hands())
@pytest.mark.parametrize("rate_hz", [200.0, 1000.0])
def test_the_frequency_response_solves_the_equations_of_the_system(
    hand_name: str, loop_kind: LoopKind, rate_hz: float
) -> None:
    """The computed frequency response equals C (zI - A)^-1 B + D, as the package ``control`` computes it."""
    system = open_loop(HandModel.from_hand(load_hand(hand_name), Gains(), rate_hz), 0, loop_kind)
    omega = frequency_grid(system.period)
    expected = ss(system.A, system.B, system.C, system.D, system.period)(
        np.exp(1j * omega * system.period)
    )
    error = np.abs(system.frequency_response(omega) - expected)
    assert (error < 1e-9 * np.abs(1.0 + expected)).all()


@pytest.mark.parametrize("loop_kind", LOOP_KINDS)
@pytest.mark.parametrize("hand_name", ["jamia", "jamia11"])
def test_margins_are_those_of_control(
    hand_name: str, loop_kind: LoopKind, request: pytest.FixtureRequest
) -> None:
    model: HandModel = request.getfixturevalue(hand_name)
    system = open_loop(model, 0, loop_kind)
    omega = frequency_grid(system.period)
    margins = margins_of_loop(system)
    gain, phase, _, _, _, _ = stability_margins(
        frd(system.frequency_response(omega), omega, smooth=True)
    )
    assert margins.gain_db == pytest.approx(20.0 * abs(math.log10(gain)), abs=0.02)
    assert margins.phase_deg == pytest.approx(phase, abs=0.05)


@pytest.mark.parametrize("loop_kind", LOOP_KINDS)
def test_the_gain_margin_is_where_the_loop_becomes_unstable(
    jamia: HandModel, loop_kind: LoopKind
) -> None:
    """A control loop is unstable if the torque is multiplied by slightly more than the gain margin.

    A control loop is stable if the torque is multiplied by slightly less than the gain margin.
    """
    margin = 10.0 ** (margins_of_loop(open_loop(jamia, 0, loop_kind)).gain_db / 20.0)
    assert margins_of_loop(
        open_loop(jamia, 0, loop_kind, PlantFactors(torque_constant=0.97 * margin))
    ).stable
    assert not margins_of_loop(
        open_loop(jamia, 0, loop_kind, PlantFactors(torque_constant=1.03 * margin))
    ).stable


def test_closed_loop_responds_to_a_force_step(jamia: HandModel) -> None:
    """After a step of the disturbance force by 1 N, the controller brings the tension back to its goal.

    Without a controller, the tension would stay 1 N away from its goal after the force step.
    """
    _, tension = step_response(jamia, 0, LoopKind.TENSION, 1.0)
    assert abs(tension[-1]) < 0.3 < np.abs(tension).max() < 2.0


@pytest.mark.parametrize("digit_name", ["index", "thumb"])
def test_margins_hardly_depend_on_small_changes_of_a_moment_arm(digit_name: str) -> None:
    """Reproduce a defect: with identified moment arms, the loops of the hand n_plus_1 counted as unstable.

    In a digit with antagonistic tendons, the control law keeps one tension at the tension floor. At
    the tension floor, the slope of the control law changes abruptly. Depending on rounding, the
    linear model contained the slope on one side of the floor, or the mean of both slopes.
    """
    hand = load_hand("n_plus_1")
    gains = packaged_gains("n_plus_1")
    changed_tendons = tuple(
        tendon.model_copy(
            update={
                "moment_arm_m": {
                    joint: arm * (1.0 + 1e-4 * (i % 3 - 1))
                    for joint, arm in tendon.moment_arm_m.items()
                }
            }
        )
        for i, tendon in enumerate(hand.tendon)
    )
    changed_hand = hand.model_copy(update={"tendon": changed_tendons})
    tendon = hand.digit_tendons[digit_name].start
    margins, changed_margins = (
        margins_of_loop(
            open_loop(HandModel.from_hand(each_hand, gains, 250.0), tendon, LoopKind.MOTION)
        )
        for each_hand in (hand, changed_hand)
    )
    assert margins.are_sufficient
    assert changed_margins.stable
    assert changed_margins.gain_db == pytest.approx(margins.gain_db, rel=0.01)
    assert changed_margins.phase_deg == pytest.approx(margins.phase_deg, rel=0.01)
