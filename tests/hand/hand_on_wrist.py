"""Build packaged hands on a wrist. The tendons of the digits have moment arms about the axis of the wrist."""

import json
from typing import Any

from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_from_content, load_hand

WRIST_MOMENT_ARM_M = 0.005
"""Distance at which the digits' tendons pass the axis of the wrist [m].

The tendon that moves the wrist has a larger distance from the axis of the wrist.
"""


def mount_on_wrist(hand_name: str, moment_arm_m: float = WRIST_MOMENT_ARM_M) -> Hand:
    """Return a packaged hand with all its digits on a wrist of one joint.

    Two antagonistic tendons on one motor turn the wrist.

    Args:
        hand_name: name of a packaged hand.
        moment_arm_m: moment arm of every digit tendon about the wrist [m]. If the moment arm is 0,
            the tendons pass through the axis of the wrist. Tendons of digits that close towards -y
            flex the wrist, and tendons of other digits extend the wrist.
    """
    hand = load_hand(hand_name)
    content: dict[str, Any] = json.loads(json.dumps(hand.content))
    node = content["sensor_node"]
    node["joints"] = ["wrist_j1", *node["joints"]]
    for digit in content["digit"]:
        digit["mount_on"] = "wrist"
        digit["mount_position_m"][0] += 0.05
        flexion_sign = 1.0 if abs(digit["mount_rpy_deg"][0]) > 90.0 else -1.0
        for tendon in content["tendon"]:
            moved_digits = {joint.rpartition("_j")[0] for joint in tendon["moment_arm_m"]}
            if moment_arm_m and digit["name"] in moved_digits:
                tendon["moment_arm_m"]["wrist_j1"] = flexion_sign * moment_arm_m
    wrist = {
        "name": "wrist",
        "mount_position_m": [-0.05, 0.0, 0.0],
        "mount_rpy_deg": [0.0, 0.0, 0.0],
        "link_radius_m": 0.01,
        "link_length_m": [0.05],
        "link_com_m": [0.03],
        "link_mass_kg": [0.1],
        "link_inertia_kg_m2": [6e-5],
        "joint_min_deg": [-40.0],
        "joint_max_deg": [40.0],
        "joint_damping_N_m_s_per_rad": [5e-3],
        "joint_armature_kg_m2": [1e-6],
    }
    flexor = content["tendon"][0] | {
        "name": "wrist_flex", "motor": "wrist_motor", "moment_arm_m": {"wrist_j1": -0.016}, "pretension_N": 25.0,
    }  # fmt: skip
    del flexor["tension_floor_N"]
    motor = content["motor"][0] | {"name": "wrist_motor", "node_id": 30}
    content["digit"] = [wrist, *content["digit"]]
    content["tendon"] = [flexor, *content["tendon"]]
    content["motor"] = [motor, *content["motor"]]
    return hand_from_content(content | {"name": f"{hand_name}_wrist"}, hand_name)
