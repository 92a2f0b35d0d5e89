"""Hands with their gains designed, once."""

import pytest

from handctl.core.gains.gains import Gains
from handctl.core.model import HandModel
from handctl.hand.load import load_hand


@pytest.fixture(scope="session")
def jamia() -> HandModel:
    """One tendon a digit, 500 Hz."""
    return HandModel.of(load_hand("jamia"), Gains(), 500.0)


@pytest.fixture(scope="session")
def jamia11() -> HandModel:
    """One tendon a joint, 200 Hz."""
    return HandModel.of(load_hand("jamia11"), Gains(), 200.0)
