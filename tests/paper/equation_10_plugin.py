"""Pytest plugin that uses Eq. 10 of the paper in the dynamics of handctl.

The plugin uses Eq. 10 either with the misprints of the paper, or in its corrected form.

``test_literal.py`` runs the tests of the model with this plugin. The environment variable
HANDCTL_EQ10 selects the printed or the corrected form of Eq. 10.
"""

import os
from math import cos, sin

from handctl.hand import dynamics
from handctl.paper.model import equations

EQUATION_TERMS = [
    term.readings[0] if os.environ["HANDCTL_EQ10"] == "printed" else term.correct_form
    for term in equations.TORQUE_TERMS_1
]
HANDCTL_TORQUE_FUNCTION = dynamics._rigid_body_torque


def torque_from_equation_10(digit, gravity, q, dq, ddq):
    """Return the joint torques of a digit, and compute the torque of the first joint with Eq. 10.

    Eq. 10 of the paper gives the torque T_1 of the first joint. The torques of the other joints
    come from the dynamic model of handctl.
    """
    _, tau2, tau3 = (*HANDCTL_TORQUE_FUNCTION(digit, gravity, q, dq, ddq), 0.0, 0.0)[:3]
    r1, r2, _ = (*digit.armature, 0.0, 0.0)[:3]
    states = {"g": 1.0}
    for i in range(3):
        has_joint = i < digit.joint_count
        states |= {
            f"L{i + 1}": digit.lengths[i] if has_joint else 0.0,
            f"d{i + 1}": digit.centres_of_mass[i, 0] if has_joint else 0.0,
            f"m{i + 1}": digit.masses[i] if has_joint else 0.0,
            f"I{i + 1}": digit.inertias[i, 2, 2] if has_joint else 0.0,
            f"th{i + 1}": sum(q[: i + 1]),
            f"dth{i + 1}": sum(dq[: i + 1]),
            f"ddth{i + 1}": sum(ddq[: i + 1]),
        }
    gx, gy, _ = gravity @ digit.mount_rotation
    angle = states["th1"]
    weight = gx * sin(angle) - gy * cos(angle)
    torque_of_motion = sum(term.evaluate(states) for term in EQUATION_TERMS[:-1])
    gravity_torque = EQUATION_TERMS[-1].evaluate({**states, "th1": 0.0}) * weight
    tau1 = torque_of_motion + gravity_torque + tau2 - r2 * ddq[1] + r1 * ddq[0]
    return (float(tau1), tau2, tau3)[: digit.joint_count]


dynamics._rigid_body_torque = torque_from_equation_10
