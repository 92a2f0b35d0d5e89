"""Provide models of hands as fixtures. The model of a hand is made only once, for all tests."""

import pytest

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.hand.hand_loading import load_hand


@pytest.fixture(scope="session")
def jamia() -> HandModel:
    """Return the model of ``jamia``, a hand with one tendon per digit, for a control rate of 500 Hz."""
    return HandModel.from_hand(load_hand("jamia"), Gains(), 500.0)


@pytest.fixture(scope="session")
def jamia11() -> HandModel:
    """Return the model of ``jamia11``, a hand with one tendon per joint, for a control rate of 200 Hz."""
    return HandModel.from_hand(load_hand("jamia11"), Gains(), 200.0)
