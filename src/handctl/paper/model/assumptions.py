"""Assumptions of the paper's model that the text of the paper does not mention.

For each assumption, the module computes its effect on the numbers of the paper.
"""

from fractions import Fraction

import numpy as np

from handctl.hand.digit import Array
from handctl.paper import paper_data as src
from handctl.paper.errata_item import ErrataItem
from handctl.paper.model.kinematics import paper_digit
from handctl.paper.verdicts import verdict_of_number, verdict_of_statement

STATICS_TAG = ("statics",)
MIN_BEND_RATIO = 18.0
"""Smallest ratio of pulley diameter to wire diameter in engineering practice.

Source: ISO 4308-1, factor h2 of mechanism class M4.
"""
WRAP_ANGLES_DEG = (15.0, 30.0, 45.0)
"""Joint angles of a finger that wraps around an object and touches it with the middle of each link [deg].

Source: Birglen, Laliberte & Gosselin (2008).
"""


def assumption_errata() -> list[ErrataItem]:
    """Return the items of the errata about the assumptions of the paper."""
    return [
        *_check_one_tendon(),
        *_check_coupling(),
        *_check_grip_balance(),
        *_check_two_sided_payload(),
        _check_bending(),
        _check_lift_off(),
    ]


def _check_one_tendon() -> list[ErrataItem]:
    """Check whether one tendon can balance the tip force at every joint of a straight finger.

    The condition is T r_p = M at each joint, with the tension T, the pulley radius r_p and the
    moment M of the tip force.
    """
    tip_distances = src.tip_distances_mm(src.paper_finger())
    given_ratio = src.tension_per_newton(src.paper_finger()) * src.PULLEY_RADIUS_MM
    rows = []
    for i, required in enumerate(tip_distances):
        radius = required / src.tension_per_newton(src.paper_finger())
        rows.append(
            ErrataItem(
                f"tendon.joint{i + 1}", "Sec. 5", f"M = T r_p with T = 18.33F, M{'₁₂₃'[i]} = {required}F",
                float(given_ratio), "N mm per N",
                verdict_of_statement(given_ratio == required),
                f"One tendon on equal pulleys gives {given_ratio}F at every joint. This joint requires {required}F. "
                "The "
                f"surplus of {given_ratio - required}F goes to stops or other contacts. Balance requires a pulley of "
                f"{float(radius):.4g} mm.",
                STATICS_TAG,
            )
        )  # fmt: skip
    return rows


def _check_coupling() -> list[ErrataItem]:
    """Check whether section 5 of the paper is consistent with the equal joint angles of section 4.

    With equal angles, the work of the tendon must equal the work of the tip force.
    """
    tip_distances = src.tip_distances_mm(src.paper_finger())
    # If all joint angles are equal, the principle of virtual work gives T times 3 r_p = F times the
    # sum of the levers. In this equation, T is the tension, and F is the force at the tip.
    tension = sum(tip_distances, Fraction(0)) / (len(tip_distances) * src.PULLEY_RADIUS_MM)
    force = src.FINGER_GRIP_FORCE_N * tension
    torque = src.FINGER_GRIP_FORCE_N * tension * src.SPOOL_RADIUS_MM / 1000
    moment_arms = src.paper_hand().moment_arms[
        src.paper_hand().digit_tendons["index"], src.paper_hand().digit_joints["index"]
    ]
    # The variable `free_dimensions` is the number of joint motions that no tendon controls.
    free_dimensions = len(tip_distances) - int(np.linalg.matrix_rank(moment_arms))
    return [
        ErrataItem(
            "coupling.tension", "Sec. 4 against Sec. 5", "18.33 F", float(tension), "N per N",
            verdict_of_number("18.33", tension),
            "If θ₁ = θ₂ = θ₃ is enforced, as section 4 says, virtual work gives T = (55 + 25 + 10)F/(3 × 3) = 10F: "
            f"{float(force):g} N and {float(torque):g} N m at 6 N instead of 110 N and 0.55 N m.", ("virtual work",)),
        ErrataItem(
            "coupling.freedom", "Sec. 4", "the rotation angle of first to third link are always equal",
            float(free_dimensions), "",
            verdict_of_statement(free_dimensions == 0),
            f"One tendon sets one sum of three angles, and {free_dimensions} motions remain free. Without contact, "
            "the angles are "
            "equal only if the springs are in proportion to the pulleys. With contact, they are not equal.", ("rank",)),
    ]  # fmt: skip


def _check_grip_balance() -> list[ErrataItem]:
    """Check whether the forces of three fingers (6 N each) and of the thumb (10 N) balance each other."""
    fingers = src.FINGER_COUNT * src.FINGER_GRIP_FORCE_N
    tension = fingers * src.tension_per_newton(src.paper_thumb())
    torque = tension * src.SPOOL_RADIUS_MM / 1000
    return [
        ErrataItem(
            "grip.balance", "Sec. 5 against Sec. 6",
            f"{src.THUMB_GRIP_FORCE_N} N thumb, {src.FINGER_GRIP_FORCE_N} N each finger",
            float(fingers), "N", verdict_of_statement(fingers == src.THUMB_GRIP_FORCE_N),
            f"Three fingers press with {fingers} N, the thumb with {src.THUMB_GRIP_FORCE_N} N: the object would be "
            f"pushed out. For {fingers} N the thumb's tendon needs {tension} N and its motor {float(torque):g} N m.",
            STATICS_TAG),
    ]  # fmt: skip


def _check_two_sided_payload() -> list[ErrataItem]:
    """Compare the printed payload with the payload that friction on both sides of the object holds."""
    fingers = src.FINGER_COUNT * src.FINGER_GRIP_FORCE_N
    two_sided_payload_kg = 2 * src.payload_kg(fingers)
    payload_limit = 2 * src.payload_kg(src.THUMB_GRIP_FORCE_N)
    return [
        ErrataItem(
            "payload.both_sides", "Sec. 5", f"m = {src.PAYLOAD_KG} kg", float(two_sided_payload_kg), "kg",
            verdict_of_number(src.PAYLOAD_KG, two_sided_payload_kg),
            "The paper counts friction on the finger side only. A thumb that balances 18 N carries "
            "the same load again.",
            STATICS_TAG),
        ErrataItem(
            "payload.thumb_limit", "Sec. 5 against Sec. 6", f"m = {src.PAYLOAD_KG} kg", float(payload_limit), "kg",
            verdict_of_number(src.PAYLOAD_KG, payload_limit),
            "Payload with friction on both sides, if the thumb presses with 10 N and the fingers balance it.",
            STATICS_TAG),
    ]  # fmt: skip


def _check_bending() -> ErrataItem:
    """Check the ratio of pulley diameter to wire diameter, which determines how sharply the wire is bent."""
    diameter = src.wire_diameter_mm(
        src.FINGER_GRIP_FORCE_N * src.tension_per_newton(src.paper_finger())
    )
    ratio = float(2 * src.PULLEY_RADIUS_MM) / diameter
    return ErrataItem(
        "wire.bending", "Sec. 5", "r_p = 3 mm, wire 0.86 mm", ratio, "", verdict_of_statement(ratio >= MIN_BEND_RATIO),
        f"Ratio of pulley diameter to rope diameter. Engineering practice requires at least {MIN_BEND_RATIO:g}. "
        "The paper does not consider bending stress, fatigue, friction, return springs and a safety factor. A stress "
        "of 190 MPa is usual for aluminium, and not for a steel rope.",
        ("arithmetic",))  # fmt: skip


def contact_forces(tension: float, angles_deg: tuple[float, ...] = WRAP_ANGLES_DEG) -> Array:
    """Return the normal forces (3,) [N] that act at the middles of three links.

    The normal forces balance the joint torques of a tendon with the given tension [N]. At each
    joint, the tendon runs over a pulley of the same radius.
    """
    lengths = np.array(paper_digit("index").lengths)
    link_angles = np.cumsum(np.radians(angles_deg))
    moment_arm_matrix = np.zeros((3, 3))
    for joint in range(3):
        for link in range(joint, 3):
            # The expression below is the lever with which a normal force at the middle of `link`
            # acts on `joint`.
            distance_to_link = lengths[joint:link] @ np.cos(
                link_angles[link] - link_angles[joint:link]
            )
            moment_arm_matrix[joint, link] = distance_to_link + lengths[link] / 2.0
    return np.linalg.solve(
        moment_arm_matrix, np.full(3, tension * float(src.PULLEY_RADIUS_MM) / 1000.0)
    )


def _check_lift_off() -> ErrataItem:
    """Check whether all links of a finger press on an object around which the finger wraps."""
    forces = contact_forces(110.0)
    return ErrataItem(
        "grip.middle_link", "Sec. 5", "one tendon, equal pulleys, three phalanges on the object", float(forces[1]), "N",
        verdict_of_statement(bool((forces >= 0.0).all())),
        f"At joint angles of 15, 30 and 45° and 110 N the links would press with {forces[0]:.1f}, {forces[1]:.1f} and "
        f"{forces[2]:.1f} N. The middle link cannot pull and lifts off, and the finger closes until its stop.",
        STATICS_TAG)  # fmt: skip
