"""Test a digit that touches an object although no contact is planned.

An event reports the unplanned contact. After the contact, the digit presses on the object with a
bounded tension.
"""

import numpy as np
import pytest

from handctl.core.estimation.blocked_digits import (
    MAX_BLOCKED_EXTRA_TENSION_N,
    MAX_UNBLOCKED_TENSION_N,
    MIN_BLOCKED_TENSION_N,
)
from handctl.core.hand_model import HandModel
from handctl.programs.live_session import JogProgram
from handctl.programs.requests import MoveDigitsRequest
from tests.controller.control_law_runs import temperatures_for_limits, tension_limits_of
from tests.controller.plant_run import PlantRun, model_of, run_on_plant
from tests.controller.synthetic_states import (
    SyntheticEstimate,
    active_state,
    balanced_state,
    detect_contacts,
    estimate_from_states,
)


def estimate_with_unexplained_tension(
    model: HandModel, unexplained_tension: float
) -> SyntheticEstimate:
    """Return the estimate of a resting hand in which every tendon has the same external tension [N].

    In a real hand, an object that pushes the digits would cause an external tension.
    """
    return estimate_from_states(model, balanced_state(model, 0.5))._replace(
        external_tension=np.full(model.tendon_count, unexplained_tension)
    )


def test_a_lasting_tension_blocks_and_a_short_one_does_not(model: HandModel) -> None:
    state, lasting = active_state(model), round(0.1 / model.period)

    def blocked_digits_after(unexplained_tension: float, ticks: int) -> np.ndarray:
        for _ in range(ticks):
            detect_contacts(
                model, state, estimate_with_unexplained_tension(model, unexplained_tension)
            )
        return state.view("blocked")

    assert not blocked_digits_after(2.0 * MIN_BLOCKED_TENSION_N, 1).any(), "one tick of it"
    assert blocked_digits_after(2.0 * MIN_BLOCKED_TENSION_N, lasting).all()
    assert blocked_digits_after(
        0.5 * (MIN_BLOCKED_TENSION_N + MAX_UNBLOCKED_TENSION_N), lasting
    ).all(), "until it is free"
    assert not blocked_digits_after(0.0, lasting).any()


def test_only_digits_blocked_on_their_way_are_restrained(model: HandModel) -> None:
    state = active_state(model)
    state.view("planned")[...] = 20.0
    state.view("planned")[model.digit_tendons[1]] = 0.0
    assert np.isinf(tension_limits_of(model, state)).all()
    state.view("blocked")[:2] = 1
    state.view("temperature")[...] = temperatures_for_limits(
        model, np.full(model.tendon_count, 60.0)
    )
    limit = tension_limits_of(model, state)
    np.testing.assert_allclose(limit[model.digit_tendons[0]], 20.0 + MAX_BLOCKED_EXTRA_TENSION_N)
    np.testing.assert_allclose(limit[model.digit_tendons[1].start :], 60.0)


@pytest.fixture(scope="module", params=["jamia", "jamia11"])
def run_against_palm(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, PlantRun]:
    """Return the name of a hand and the record of a run of this hand.

    In the recorded run, the index finger moves towards 100 degrees, but touches the palm before it
    reaches this angle.
    """
    move = JogProgram(MoveDigitsRequest(do="move", angle_deg={"index": 100.0}, duration_s=1.0), 1.6)
    return request.param, run_on_plant(
        request.param, move, None, tmp_path_factory.mktemp("pressed"), 4.0
    )


def test_a_motion_into_a_stop_is_reported_and_presses_gently(
    run_against_palm: tuple[str, PlantRun],
) -> None:
    hand, run = run_against_palm
    assert [where for _, where in run.events_named("blocked")][:1] == ["index"]
    assert not run.events_named("fault"), (
        "no safety fault: before, the loop wound the rope up to the trip at 140 N"
    )
    own_tendons = model_of(hand).digit_tendons[0]
    at = run.events_named("blocked")[0][0]
    real = np.array(run.true_tension)[np.array(run.time_s) > at + 0.1][:, own_tendons]
    assert real.max() < 120.0, "[N]; safety trips at 140"
