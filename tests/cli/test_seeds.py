"""Test ``handctl demo`` in lockstep with every packaged hand, every drive protocol and 20 seeds.

An ordinary test run covers only a sample of the combinations of hand, drive protocol and seed.
"""

import os

import pytest

from benchmarks.seeds import run_demo
from handctl.campaign.fault_matrix import ALL_PROTOCOLS
from handctl.hand.hand_loading import packaged_hands

NIGHTLY = os.environ.get("HANDCTL_NIGHTLY") == "1"
DEMO_CASES = [
    (hand, protocol, seed)
    for hand in packaged_hands()
    for protocol in ALL_PROTOCOLS
    for seed in range(20)
]
SAMPLE_CASES = [("jamia11", "mit", 7), ("t42", "mit", 3)]
"""Hand, drive protocol and seed of the demos that an ordinary test run executes.

In an earlier version, the demo of jamia11 ended during commissioning with the fault N04 (a stuck
encoder). The hand t42 has two digits.

In ordinary test runs, tests/runtime/test_lockstep_again.py tests CiA 402 drives.
"""


@pytest.mark.timeout(300)
@pytest.mark.parametrize(("hand", "protocol", "seed"), DEMO_CASES if NIGHTLY else SAMPLE_CASES)
def test_the_demo_meets_its_requirements_with_every_seed(
    hand: str, protocol: str, seed: int
) -> None:
    figures = run_demo(hand, protocol, seed)
    assert not figures["why"], figures
