"""Provide models of packaged hands to the tests of the controller.

Each hand model is computed once for all tests, because the design of its gains takes long.
"""

import pytest

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import load_hand
from handctl.programs.live_session import LiveProgram
from tests.controller.controller_bench import ControllerBench, make_controller_bench

DEFAULT_RATES = {"jamia": 500.0, "jamia11": 200.0}
"""Default control rate of each hand [Hz].

At this rate, the bus of the hand can carry all of its frames.
"""


@pytest.fixture(scope="session")
def jamia() -> HandModel:
    """Return the model of ``jamia``, a hand with one tendon per digit, at the default control rate."""
    return HandModel.from_hand(load_hand("jamia"), Gains(), DEFAULT_RATES["jamia"])


@pytest.fixture(scope="session")
def jamia11() -> HandModel:
    """Return the model of ``jamia11`` at the default control rate of this hand.

    The hand ``jamia11`` has a tendon and an encoder at each joint.
    """
    return HandModel.from_hand(load_hand("jamia11"), Gains(), DEFAULT_RATES["jamia11"])


@pytest.fixture(params=["jamia", "jamia11"])
def model(request: pytest.FixtureRequest) -> HandModel:
    """Return the model of one of the two packaged Jamia hands.

    A test that uses this fixture runs twice: once with jamia, and once with jamia11.
    """
    parametrised_model: HandModel = request.getfixturevalue(request.param)
    return parametrised_model


@pytest.fixture(scope="module")
def active_bench() -> ControllerBench:
    """Return a test bench: a controller that runs with a simple simulated hand.

    The hand is active and holds a tension.
    """
    run = make_controller_bench(
        HandModel.from_hand(load_hand("jamia"), Gains(), 200.0), LiveProgram()
    )
    run.run_until_mode(HandMode.ACTIVE)
    run.run(1.0)
    run.tick('{"do": "move", "angle_deg": {"middle": 20}, "duration_s": 5}')
    run.tick('{"do": "hold", "tension_N": {"index": 30}}')
    run.run(0.1)
    return run
