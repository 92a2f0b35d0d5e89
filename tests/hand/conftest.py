"""Provide hands and digits as fixtures for the tests of the folder ``tests/hand``."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import hand_from_content, load_hand, packaged_hands

SPATIAL_HANDS = ("orca_like",)
"""Packaged hands whose digits are spatial chains on a wrist.

``test_random_chains`` tests hands with spatial chains together with random hands.
"""


@pytest.fixture(params=[name for name in packaged_hands() if name not in SPATIAL_HANDS])
def hand(request: pytest.FixtureRequest) -> Hand:
    """Return a packaged hand with planar digits on the palm.

    A test that uses this fixture runs once for each packaged hand with planar digits on the palm.
    """
    return load_hand(request.param)


@pytest.fixture
def digits(hand: Hand) -> tuple[DigitModel, ...]:
    """Return all digits of the hand."""
    return tuple(DigitModel.from_hand(hand, name) for name in hand.digit_names)


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a random generator with a fixed seed."""
    return np.random.default_rng(20240501)


@pytest.fixture
def refusal_of_content() -> Callable[[Mapping[str, Any]], str]:
    """Return a function that builds a hand from wrong content, expects a ConfigError, and returns its error line.

    The error line contains the file name, the key path, the wrong value and the expected value.
    """

    def refusal_line(content: Mapping[str, Any]) -> str:
        with pytest.raises(ConfigError) as caught:
            hand_from_content(content, "my/hand.toml")
        line = str(caught.value)
        assert line.startswith("my/hand.toml: ")
        assert "\n" not in line
        assert "; expected " in line
        return line

    return refusal_line
