"""The demo in lockstep with every packaged hand, every protocol and 20 seeds. Ordinary runs test a sample."""

import os

import pytest

from benchmarks.seeds import demo
from handctl.campaign.scenarios import ALL_PROTOCOLS
from handctl.hand.load import packaged_hands

NIGHTLY = os.environ.get("HANDCTL_NIGHTLY") == "1"
CASES = [(hand, protocol, seed) for hand in packaged_hands() for protocol in ALL_PROTOCOLS for seed in range(20)]
SAMPLE = [("jamia11", "mit", 7), ("t42", "mit", 3)]
"""Regression: the first case ended with N04 in commissioning. The second hand has two digits.

tests/runtime/test_lockstep_again.py has a second run of CiA 402 drives.
"""


@pytest.mark.timeout(300)
@pytest.mark.parametrize(("hand", "protocol", "seed"), CASES if NIGHTLY else SAMPLE)
def test_the_demo_meets_its_requirements_with_every_seed(hand: str, protocol: str, seed: int) -> None:
    figures = demo(hand, protocol, seed)
    assert not figures["why"], figures
