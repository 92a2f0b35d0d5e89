"""Test which parts of an ordinary run's log count as free motion of a digit."""

from pathlib import Path

import numpy as np

from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.tune.identify.tendon_data import STOP_DISTANCE_DEG, TRANSIENT_S, tendon_data

GRASP_LOG = Path(__file__).parents[2] / "logs" / "golden" / "jamia-grasp.mcap"


def test_a_digit_that_is_held_or_rests_on_a_stop_is_not_free() -> None:
    """Reproduce a defect: the identification used data of digits at their joint stops.

    Because of the data at the stops, the identified spring stiffness and friction were too large by
    a third.
    """
    hand = load_hand("jamia")
    with RunLog(GRASP_LOG) as log:
        is_held = np.isnan(log.field("q_goal"))
        angles, period = np.degrees(log.field("q")), log.header.period_ns * 1e-9
        free_sample_count, active = 0, (log.mode == HandMode.ACTIVE)[:-1]
        for data, digit in zip(tendon_data(log, hand), hand.digit, strict=True):
            joints = hand.digit_joints[digit.name]
            free_sample_count += int((data.free_motion_mask & active).sum())
            for k in np.flatnonzero(data.free_motion_mask):
                transient_ticks = slice(k - round(TRANSIENT_S / period) + 1, k + 1)
                assert not is_held[transient_ticks, joints].any()
                assert (
                    angles[transient_ticks, joints]
                    > np.array(digit.joint_min_deg) + STOP_DISTANCE_DEG
                ).all()
                assert (
                    angles[transient_ticks, joints]
                    < np.array(digit.joint_max_deg) - STOP_DISTANCE_DEG
                ).all()
    assert free_sample_count > 60, "free samples are found"
