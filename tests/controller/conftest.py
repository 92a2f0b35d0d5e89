"""Hands with everything that follows from them, made once: the design of the gains takes a while."""

import pytest

from handctl.core.gains.gains import Gains
from handctl.core.model import HandModel
from handctl.core.types import Mode
from handctl.hand.load import load_hand
from handctl.programs.live import LiveProgram
from tests.controller.bench import Bench, bench

DEFAULT_RATES = {"jamia": 500.0, "jamia11": 200.0}
"""Control rates that the bus load allows [Hz]."""


@pytest.fixture(scope="session")
def jamia() -> HandModel:
    """One tendon a digit, at its default rate."""
    return HandModel.of(load_hand("jamia"), Gains(), DEFAULT_RATES["jamia"])


@pytest.fixture(scope="session")
def jamia11() -> HandModel:
    """One tendon a joint, with joint encoders, at its default rate."""
    return HandModel.of(load_hand("jamia11"), Gains(), DEFAULT_RATES["jamia11"])


@pytest.fixture(params=["jamia", "jamia11"])
def model(request: pytest.FixtureRequest) -> HandModel:
    """Every packaged hand."""
    found: HandModel = request.getfixturevalue(request.param)
    return found


@pytest.fixture(scope="module")
def active() -> Bench:
    """A hand in action that holds something."""
    run = bench(HandModel.of(load_hand("jamia"), Gains(), 200.0), LiveProgram())
    run.until(Mode.ACTIVE)
    run.run(1.0)
    run.tick('{"do": "move", "angle_deg": {"middle": 20}, "duration_s": 5}')
    run.tick('{"do": "hold", "tension_N": {"index": 30}}')
    run.run(0.1)
    return run
