"""A digit that meets what nobody planned: it is told, and presses with a bounded tension instead of ringing."""

import numpy as np
import pytest

from handctl.core.estimation.estimator import Estimate
from handctl.core.estimation.touch import BLOCKED_N, FREED_N, PRESS_N, Touch, feel, gentle
from handctl.core.model import HandModel
from handctl.programs.live import JogProgram
from handctl.programs.requests import MoveDigits
from tests.controller.plant_run import PlantRun, model_of, run_on_plant
from tests.controller.synthetic import at_rest, known


def pulled(model: HandModel, external: float) -> Estimate:
    """An estimate of a hand at rest, with so much on every tendon that nothing explains [N]."""
    return known(model, at_rest(model, 0.5))._replace(external=np.full(model.tendon_count, external))


def test_a_lasting_tension_blocks_and_a_short_one_does_not(model: HandModel) -> None:
    felt = feel(model, Touch.none(len(model.digits)), pulled(model, 2.0 * BLOCKED_N))
    assert not any(felt.blocked), "one tick of it"
    for _ in range(round(0.1 / model.period)):
        felt = feel(model, felt, pulled(model, 2.0 * BLOCKED_N))
    assert all(felt.blocked)
    for _ in range(round(0.1 / model.period)):
        felt = feel(model, felt, pulled(model, 0.5 * (BLOCKED_N + FREED_N)))
    assert all(felt.blocked), "until it is free"
    for _ in range(round(0.1 / model.period)):
        felt = feel(model, felt, pulled(model, 0.0))
    assert not any(felt.blocked)


def test_only_digits_blocked_on_their_way_are_restrained(model: HandModel) -> None:
    n, digits = model.tendon_count, len(model.digits)
    planned = np.full(n, 20.0)
    planned[model.digit_tendons[1]] = 0.0
    none, some = Touch.none(digits), Touch(np.zeros(digits), (True, True, *(False,) * (digits - 2)))
    assert gentle(model, none, planned, None) is None
    limit = gentle(model, some, planned, np.full(n, 60.0))
    assert limit is not None
    np.testing.assert_allclose(limit[model.digit_tendons[0]], 20.0 + PRESS_N)
    np.testing.assert_allclose(limit[model.digit_tendons[1].start :], 60.0)


@pytest.fixture(scope="module", params=["jamia", "jamia11"])
def pressed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, PlantRun]:
    """The index is told to go to 100 degrees; its first joint meets the palm long before."""
    move = JogProgram(MoveDigits(do="move", angle_deg={"index": 100.0}, duration_s=1.0), 1.6)
    return request.param, run_on_plant(request.param, move, None, tmp_path_factory.mktemp("pressed"), 4.0)


def test_a_motion_into_a_stop_is_told_and_presses_gently(pressed: tuple[str, PlantRun]) -> None:
    hand, run = pressed
    assert [where for _, where in run.told("blocked")][:1] == ["index"]
    assert not run.told("fault"), "no safety fault: before, the loop wound the rope up to the trip at 140 N"
    own = model_of(hand).digit_tendons[0]
    at = run.told("blocked")[0][0]
    real = np.array(run.real)[np.array(run.t) > at + 0.1][:, own]
    assert real.max() < 120.0, "[N]; safety trips at 140"
