"""Hands whose digits are random chains of links.

The axes, orientations, lengths, masses and inertias of the links are random.
"""

from typing import Any

import numpy as np

from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_from_content, load_hand

RANDOM_CHAIN_SEEDS = range(20)
SEEDS_WITH_PRISMATIC_JOINTS = range(20, 40)
"""Seeds of hands in which about half of the joints are prismatic."""


def build_random_hand_tree(seed: int) -> Hand:
    """Return a hand of five random digits of 1 to 3 links.

    Each random digit is mounted on the palm or on a digit with a smaller index.
    """
    rng = np.random.default_rng(seed + 100)
    return random_hand(seed, *rng.integers(1, 4, 5).tolist(), rng=rng)


def random_hand(seed: int, *joint_counts: int, rng: np.random.Generator | None = None) -> Hand:
    """Return a hand of random digits that have one tendon per joint.

    ``joint_counts`` contains the number of links of each digit. Without ``joint_counts``, the hand
    has two digits: the first has 1 to 8 links, the second 1 to 7 links. If ``rng`` is given, some
    digits of the random hand are mounted on other digits.
    """
    is_mounted = rng
    rng = np.random.default_rng(seed)
    joint_counts = joint_counts or (seed % 8 + 1, int(rng.integers(1, 8)))
    content = load_hand("jamia11").content
    digits = [random_digit(rng, f"d{number}", count) for number, count in enumerate(joint_counts)]
    for number, digit in enumerate(digits) if seed in SEEDS_WITH_PRISMATIC_JOINTS else ():
        make_some_joints_prismatic(np.random.default_rng((seed, number)), digit)
    line: list[str] = []
    for digit in digits if is_mounted else ():
        # The carrier of a digit is the palm, the previous digit, or one of the digits that carry
        # the previous digit.
        level = int(rng.integers(0, len(line) + 1))
        if level:
            digit["mount_on"] = line[level - 1]
        line = [*line[:level], digit["name"]]
    tendons: list[dict[str, Any]] = []
    motors: list[dict[str, Any]] = []
    for digit in digits:
        joints = [f"{digit['name']}_j{i + 1}" for i in range(len(digit["link_length_m"]))]
        types = digit.get("joint_type", ["revolute"] * len(joints))
        prismatic_joints = {
            joint for joint, kind in zip(joints, types, strict=True) if kind == "prismatic"
        }
        for i, name in enumerate(joints):
            number = len(tendons)
            arms = {joint: float(rng.uniform(0.002, 0.006)) for joint in joints[: i + 1]}
            excursion_ratios = {
                joint: 200.0 * arms.pop(joint) for joint in prismatic_joints & arms.keys()
            }
            tendons.append(
                content["tendon"][0]
                | {"name": f"{name}_t", "motor": f"{name}_m", "moment_arm_m": arms}
                | ({"excursion_ratio": excursion_ratios} if excursion_ratios else {})
            )
            motors.append(content["motor"][0] | {"name": f"{name}_m", "node_id": number + 1})
    gravity = rng.normal(size=3)
    node = content["sensor_node"] | {
        "tendons": [tendon["name"] for tendon in tendons],
        "joints": [],
    }
    entries_by_section = {"digit": digits, "tendon": tendons, "motor": motors, "sensor_node": node}
    mount = {"gravity_m_s2": (9.81 * gravity / np.linalg.norm(gravity)).tolist()}
    return hand_from_content(
        content | entries_by_section | {"mount": mount, "name": f"random{seed}"}, f"seed {seed}"
    )


def random_digit(rng: np.random.Generator, digit_name: str, joint_count: int) -> dict[str, Any]:
    """Return a digit of random links.

    Some links have length zero. For some links, the hand file gives the centre of mass and the
    inertia as single numbers instead of vectors.
    """
    length = rng.uniform(0.01, 0.05, joint_count)
    length[:-1] *= rng.random(joint_count - 1) > 0.2
    radius = 0.006
    axes = rng.normal(size=(joint_count, 3))
    mass = rng.uniform(1e-3, 2e-2, joint_count)
    com: list[Any] = rng.uniform(-0.004, 0.004, (joint_count, 3)).tolist()
    inertia: list[Any] = []
    for i in range(joint_count):
        # Compute the inertia from a body of random mass points, so that it satisfies the
        # inequalities of a real inertia tensor.
        points = rng.normal(size=(6, 3)) * 0.3 * np.maximum(length[i] / 3, radius / 2)
        moments = mass[i] / 6 * ((points**2).sum() * np.eye(3) - points.T @ points)
        inertia.append(moments[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)].tolist())
        if i % 3 == 1:
            com[i], inertia[i] = float(length[i] / 2), float(moments[2, 2])
    return {
        "name": digit_name,
        "mount_position_m": rng.uniform(-0.05, 0.05, 3).tolist(),
        "mount_rpy_deg": rng.uniform(-180, 180, 3).tolist(),
        "link_length_m": length.tolist(),
        "joint_axis": (axes / np.linalg.norm(axes, axis=1, keepdims=True)).tolist(),
        "joint_rpy_deg": rng.uniform(-180, 180, (joint_count, 3)).tolist(),
        "link_com_m": com,
        "link_mass_kg": mass.tolist(),
        "link_inertia_kg_m2": inertia,
        "link_radius_m": radius,
        "joint_min_deg": [-100.0] * joint_count,
        "joint_max_deg": [100.0] * joint_count,
        "joint_damping_N_m_s_per_rad": [5e-4] * joint_count,
        "joint_armature_kg_m2": rng.uniform(0.0, 1e-6, joint_count).tolist(),
        "spring_stiffness_N_m_per_rad": rng.uniform(0.03, 0.1, joint_count).tolist(),
        "spring_preload_rad": [0.6] * joint_count,
    }


def make_some_joints_prismatic(random_source: np.random.Generator, digit: dict[str, Any]) -> None:
    """Make some joints of a digit prismatic.

    With a probability of 0.2, all joints of the digit become prismatic.
    """
    count = len(digit["link_length_m"])
    is_prismatic = random_source.random(count) < (1.0 if random_source.random() < 0.2 else 0.5)
    digit["joint_type"] = ["prismatic" if slide else "revolute" for slide in is_prismatic]
    values = {
        "joint_min_deg": ("joint_min_m", -0.05, -0.02),
        "joint_max_deg": ("joint_max_m", 0.02, 0.05),
        "joint_damping_N_m_s_per_rad": ("joint_damping_N_s_per_m", 0.5, 5.0),
        "joint_armature_kg_m2": ("joint_armature_kg", 0.0, 0.01),
        "spring_stiffness_N_m_per_rad": ("spring_stiffness_N_per_m", 100.0, 500.0),
        "spring_preload_rad": ("spring_preload_m", 0.06, 0.1),
    }
    for key, (prismatic_key, low, high) in values.items():
        digit[key] = [
            value for value, slide in zip(digit[key], is_prismatic, strict=True) if not slide
        ]
        digit[prismatic_key] = random_source.uniform(low, high, int(is_prismatic.sum())).tolist()
        for name in (key, prismatic_key):
            if not digit[name]:
                del digit[name]
