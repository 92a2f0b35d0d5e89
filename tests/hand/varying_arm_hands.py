"""Build packaged hands whose moment arms vary with the joint angle."""

import json
from typing import Any

import numpy as np

from handctl.hand.hand_loading import hand_from_content, load_hand


def hand_with_varying_arms(
    hand_name: str,
    arm_variation: float,
    polynomial_kind: str = "polynomial",
    with_joint_encoders: bool = True,
) -> Any:
    """Return a hand whose moment arms vary over the joint range.

    Each moment arm is scaled by ``1 - fraction`` at the lower joint limit, and by ``1 + fraction``
    at the upper joint limit.

    Args:
        hand_name: name of a packaged hand.
        arm_variation: largest variation of each moment arm, relative to the constant moment arm.
        polynomial_kind: how the moment arm depends on the angle. "polynomial" gives a straight
            line, and "table" gives half a period of a sine. For "content", the function returns the
            content of the hand file with constant moment arms.
        with_joint_encoders: True if the hand keeps its joint encoders.
    """
    hand = load_hand(hand_name)
    content = json.loads(json.dumps(hand.content))
    if polynomial_kind == "content":
        return content
    if not with_joint_encoders:
        content["sensor_node"]["joints"] = []
    for tendon in content["tendon"]:
        for joint, arm in tendon["moment_arm_m"].items():
            low, high = hand.joint_limits[:, hand.joints.index(joint)].tolist()
            middle_angle = (low + high) / 2.0
            half_range = (high - low) / 2.0
            if polynomial_kind == "polynomial":
                slope = arm * arm_variation / half_range
                tendon["moment_arm_m"][joint] = {
                    "polynomial_m": [arm - slope * middle_angle, slope]
                }
            else:
                angle = np.linspace(low, high, 13)
                values = arm * (
                    1.0 + arm_variation * np.sin(0.5 * np.pi * (angle - middle_angle) / half_range)
                )
                tendon["moment_arm_m"][joint] = {
                    "angle_deg": np.degrees(angle).tolist(),
                    "arm_m": values.tolist(),
                }
    return hand_from_content(content | {"name": f"{hand_name}_varied"}, hand_name)
