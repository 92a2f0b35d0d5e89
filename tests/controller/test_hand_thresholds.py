"""Test the fault thresholds that depend on the hand.

A measured value above the fault threshold of one hand can be normal for another hand.
"""

from pathlib import Path

import pytest

from handctl.controller.monitor.safety_thresholds import max_frames_per_tick
from handctl.controller.run_setup import make_drives, make_sensors
from handctl.hand.hand_loading import load_hand
from tests.drives.protocol_bench import OPTIONS_TEXT_BY_PROTOCOL, hand_file

TORQUE_FEEDBACK_OPTION = "torque_feedback = true\n"


@pytest.mark.parametrize("protocol", sorted(OPTIONS_TEXT_BY_PROTOCOL))
def test_the_flood_limit_grows_with_the_number_of_motors(protocol: str, tmp_path: Path) -> None:
    hand = load_hand(
        str(hand_file(tmp_path, [protocol], TORQUE_FEEDBACK_OPTION * (protocol == "odrive")))
    )
    drives, node = make_drives(hand), make_sensors(hand)
    assert max_frames_per_tick(drives, node) == 64
    repeated_drives = drives * 10
    answers = sum(len(drive.frames_per_tick) // 2 for drive in repeated_drives) + len(node.node_ids)
    assert 1.5 * answers < max_frames_per_tick(repeated_drives, node) < 4 * answers
