"""Hands and digits that the tests of this room run over."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.load import hand_from_content, load_hand, packaged_hands

SPATIAL = ("orca_like",)
"""Packaged hands of spatial chains on a wrist. ``test_chains`` has them beside random trees."""


@pytest.fixture(params=[name for name in packaged_hands() if name not in SPATIAL])
def hand(request: pytest.FixtureRequest) -> Hand:
    """Every packaged hand of planar digits on the palm."""
    return load_hand(request.param)


@pytest.fixture
def digits(hand: Hand) -> tuple[DigitModel, ...]:
    """All its digits."""
    return tuple(DigitModel.of(hand, name) for name in hand.digit_names)


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same on every run."""
    return np.random.default_rng(20240501)


@pytest.fixture
def refusal() -> Callable[[Mapping[str, Any]], str]:
    """The one line that refuses a content: file, key path, value, and what would be right."""

    def refuse(content: Mapping[str, Any]) -> str:
        with pytest.raises(ConfigError) as caught:
            hand_from_content(content, "my/hand.toml")
        line = str(caught.value)
        assert line.startswith("my/hand.toml: ")
        assert "\n" not in line
        assert "; expected " in line
        return line

    return refuse
