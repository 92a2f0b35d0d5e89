"""Test the fingertip positions that a client computes, without a running hand."""

import numpy as np
import pytest

from handctl import ConfigError
from handctl.client import Fingertips, FingertipStream
from handctl.hand.hand_loading import load_hand

JAMIA11_HAND = load_hand("jamia11")
START_ANGLE_RAD = np.radians(20.0)


def test_tips_and_angles_are_inverse_to_each_other():
    tips = Fingertips(JAMIA11_HAND)
    assert tips.digits == JAMIA11_HAND.digit_names
    assert tips.joints == JAMIA11_HAND.joints
    angles = {joint: START_ANGLE_RAD + 0.1 * (i % 3) for i, joint in enumerate(JAMIA11_HAND.joints)}
    positions = tips.tips(angles)
    solved_angles = tips.angles_deg(positions)
    reached_tips = tips.tips({name: np.radians(angle) for name, angle in solved_angles.items()})
    np.testing.assert_allclose(reached_tips, positions, atol=1e-6)
    assert tips.distances_m.max() < 1e-6
    angles_of_index = tips.angles_deg({"index": positions[0]})
    assert set(angles_of_index) == {"index_j1", "index_j2", "index_j3"}


@pytest.mark.parametrize(
    ("tip_positions", "expected_message"),
    [
        (np.zeros((2, 3)), r"positions of shape \(2, 3\); expected \(4, 3\)"),
        (
            {"pinky": (0.0, 0.0, 0.0)},
            "no 'pinky'; expected some of index, middle, ring, thumb|no 'pinky'",
        ),
        ({"index": (0.0, np.nan, 0.0)}, r"for index; expected x, y, z \[m\]|nan.* for index"),
        ({"index": (0.0, 0.0)}, "for index"),
        ({"index": 3.0}, "for index"),
    ],
)
def test_wrong_positions_are_refused(tip_positions, expected_message):
    with pytest.raises(ConfigError, match=expected_message):
        Fingertips(JAMIA11_HAND).angles_deg(tip_positions)


@pytest.mark.parametrize("digit_names", [["pinky"], ["index", "index"]])
def test_wrong_digits_are_refused(digit_names):
    with pytest.raises(ConfigError, match="no digit on the palm, or twice"):
        Fingertips(JAMIA11_HAND, digit_names)


class StreamOwner:
    """Fake client that owns a stream of targets, and observes a hand at rest."""

    description = JAMIA11_HAND

    def observe(self):
        """Return an observation in which all joint angles are 20 deg."""
        return self

    def named(self, field):
        """Return the angles of all joints by name [rad]."""
        assert field == "q_rad"
        return dict.fromkeys(JAMIA11_HAND.joints, START_ANGLE_RAD)


class FakeTargetSender:
    """Fake sender that stores the streamed targets."""

    def __init__(self):
        self.sent = []

    def send(self, index, sent_ns, values):
        """Store a target, and report success."""
        self.sent.append(values.tolist())
        return True


def test_a_stream_of_positions_sends_joint_angles():
    tips = Fingertips(JAMIA11_HAND, ["index", "thumb"])
    sender = FakeTargetSender()
    goal = {"stream": "1-1", "space": "joint", "names": list(tips.joints), "rate_Hz": 50.0}
    stream = FingertipStream(StreamOwner(), sender, goal, tips, 0.03, 1.0)
    assert stream.names == ("index", "thumb")
    positions = Fingertips(JAMIA11_HAND, ["index", "thumb"]).tips(
        dict.fromkeys(tips.joints, np.radians(30.0))
    )
    stream.send(positions)
    stream.send({"thumb": positions[1]})
    first_angles, second_angles = np.array(sender.sent)
    reached_tips = tips.tips(dict(zip(tips.joints, np.radians(first_angles), strict=True)))
    np.testing.assert_allclose(reached_tips, positions, atol=1e-6)
    np.testing.assert_allclose(first_angles[:3], second_angles[:3])
    with pytest.raises(ConfigError, match="positions of shape"):
        stream.send([1.0, 2.0])
    assert len(sender.sent) == 2
