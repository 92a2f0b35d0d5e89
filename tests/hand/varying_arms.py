"""Build packaged hands whose moment arms vary with the joint angle."""

import json
from typing import Any

import numpy as np

from handctl.hand.hand_loading import hand_from_content, load_hand


def with_varying_arms(
    name: str, fraction: float, kind: str = "polynomial", encoders: bool = True
) -> Any:
    """Return a hand whose moment arms vary over the joint range.

    Each moment arm is scaled by ``1 - fraction`` at the lower joint limit, and by ``1 + fraction``
    at the upper joint limit.

    Args:
        name: name of a packaged hand.
        fraction: largest variation of each moment arm, relative to the constant moment arm.
        kind: how the moment arm depends on the angle. "polynomial" gives a straight line, and
            "table" half a period of a sine. For "content", the function returns the content of the
            hand file with constant moment arms.
        encoders: True if the hand keeps its joint encoders.
    """
    hand = load_hand(name)
    content = json.loads(json.dumps(hand.content))
    if kind == "content":
        return content
    if not encoders:
        content["sensor_node"]["joints"] = []
    for tendon in content["tendon"]:
        for joint, arm in tendon["moment_arm_m"].items():
            low, high = hand.joint_limits[:, hand.joints.index(joint)].tolist()
            middle = (low + high) / 2.0
            half = (high - low) / 2.0
            if kind == "polynomial":
                slope = arm * fraction / half
                tendon["moment_arm_m"][joint] = {"polynomial_m": [arm - slope * middle, slope]}
            else:
                angle = np.linspace(low, high, 13)
                values = arm * (1.0 + fraction * np.sin(0.5 * np.pi * (angle - middle) / half))
                tendon["moment_arm_m"][joint] = {
                    "angle_deg": np.degrees(angle).tolist(),
                    "arm_m": values.tolist(),
                }
    return hand_from_content(content | {"name": f"{name}_varied"}, name)
