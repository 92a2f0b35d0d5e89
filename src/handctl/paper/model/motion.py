"""Dynamics of section 7 of the paper, computed along a closing motion of a digit.

The torque that closes a digit is divided into components. Each component of the torque has one
cause.
"""

from dataclasses import dataclass

import numpy as np

from handctl.core.control_law.trajectory import MinimumJerk
from handctl.hand import dynamics
from handctl.hand.digit import Array, DigitModel
from handctl.hand.tendons import reflected_inertia
from handctl.paper import paper_data as src
from handctl.paper.errata_item import ErrataItem
from handctl.paper.model import equations
from handctl.paper.model.lagrange import finger_states, printed_equation_value
from handctl.paper.verdicts import verdict_of_ambiguous_statement, verdict_of_statement

CLOSED_JOINT_ANGLE_DEG = 60.0
"""Angle of each joint at the end of the closing motion [deg]."""
CLOSING_DURATIONS_S = (0.6, 0.3, 0.15)
"""Durations of the motions whose torques are drawn [s]."""
SAMPLE_COUNT = 301
"""Number of samples of a motion."""
TORQUE_CAUSES = ("inertia", "Coriolis", "gravity", "springs", "motor inertia")
"""Causes of the torque. The first three causes are effects of the links alone."""


@dataclass(frozen=True, slots=True)
class ClosingTorques:
    """Torques that close a digit along a minimum-jerk path on which all joints have the same angle.

    Attributes:
        digit: name of the digit.
        duration_s: duration of the motion [s].
        times: (samples,) times of the samples [s].
        torque_by_cause: (samples,) torque at the single coordinate of the digit for each cause, by
            the name of the cause [N m].
        moment_arm_m: moment arm of the tendon for the single coordinate of the digit, which is the
            sum of all pulley radii [m].
    """

    digit: str
    duration_s: float
    times: Array
    torque_by_cause: dict[str, Array]
    moment_arm_m: float

    def peak_tension(self, cause: str) -> float:
        """Return the largest tension [N] that one component of the torque requires."""
        return float(np.abs(self.torque_by_cause[cause]).max()) / self.moment_arm_m


def upright_digit(name: str) -> DigitModel:
    """Return a digit that moves in a vertical plane and is opened by its weight, as in Eq. 6."""
    model = DigitModel.from_hand(src.paper_hand(), name)
    return model.with_gravity(
        model.mount_rotation @ np.array([0.0, -float(src.GRAVITY_M_PER_S2), 0.0])
    )


def closing_torques(name: str, duration_s: float) -> ClosingTorques:
    """Return the torques for closing a digit from straight to 60 degrees per joint.

    Args:
        name: name of the digit.
        duration_s: duration of the motion [s].
    """
    digit = upright_digit(name)
    times = np.linspace(0.0, duration_s, SAMPLE_COUNT)
    path = MinimumJerk(np.zeros(1), np.radians([CLOSED_JOINT_ANGLE_DEG]), duration_s)
    # The digit has a single coordinate. Therefore the joint torques are projected on the coupling
    # of the joints.
    rotor = float(reflected_inertia(digit)[0, 0])
    coupling = digit.coupling[:, 0]
    rows = []
    for t in times:
        theta, dtheta, ddtheta = (float(value[0]) for value in path.motion_at(float(t)))
        q = coupling * theta
        dq = coupling * dtheta
        ddq = coupling * ddtheta
        rows.append((
            coupling @ dynamics.mass_matrix(digit, q) @ ddq, coupling @ dynamics.bias_torque(digit, q, dq),
            coupling @ dynamics.gravity_torque(digit, q), coupling @ dynamics.spring_torque(digit, q), rotor * ddtheta,
        ))  # fmt: skip
    columns = np.array(rows).T
    lever = float(digit.reduced_moment_arms[0, 0])
    return ClosingTorques(
        name, duration_s, times, dict(zip(TORQUE_CAUSES, columns, strict=True)), lever
    )


def closing_torque_t1(duration_s: float) -> tuple[Array, Array, Array]:
    """Return times [s], and the torque T_1 [N m] of a closing finger by the printed and by the corrected Eq. 10.

    Each of the three arrays contains one value for each time.
    """
    digit = upright_digit("index")
    times = np.linspace(0.0, duration_s, SAMPLE_COUNT)
    path = MinimumJerk(np.zeros(1), np.radians([CLOSED_JOINT_ANGLE_DEG]), duration_s)
    motion_samples = np.array([[value[0] for value in path.motion_at(float(t))] for t in times])
    states = dict(finger_states(digit))
    for order in range(3):
        # If all joint angles are equal, the absolute angles are multiples of the first joint angle.
        states |= {"d" * order + f"th{i}": i * motion_samples[:, order] for i in (1, 2, 3)}
    correct_torque = sum(term.correct_form.evaluate(states) for term in equations.TORQUE_TERMS_1)
    return (
        times,
        np.asarray(printed_equation_value(equations.TORQUE_TERMS_1, states)),
        np.asarray(correct_torque),
    )


def motion_errata() -> list[ErrataItem]:
    """Return the errata items about the torque that closes a digit.

    The errata items are about Eq. 10 for a straight finger, about the completeness of Eq. 3 to 12,
    and about the torque that section 8 mentions.
    """
    return [_check_static_torque(), _check_completeness(), _check_torque_value()]


def _check_static_torque() -> ErrataItem:
    """Check whether T_1 of Eq. 10 is the torque at joint 1 that holds a straight finger.

    In fact, the holding torque at joint 1 is the sum of T_1 to T_3 in Eq. 10 to 12.
    """
    _, printed_torque, correct_torque = closing_torque_t1(CLOSING_DURATIONS_S[1])
    digit = upright_digit("index")
    joint = float(dynamics.gravity_torque(digit, np.zeros(digit.joint_count))[0])
    return ErrataItem(
        "eq10.static", "Eq. 10", f"T₁ = {printed_torque[0]:.3g} N m", joint, "N m",
        verdict_of_statement(bool(abs(printed_torque[0] - joint) < 1e-9 * abs(joint))),
        "Torque at joint 1 that holds the straight finger up against its weight. With Eq. 10 the finger would fall. "
        f"The corrected T₁ alone is {1000 * correct_torque[0]:.4g} mN m, which belongs to the absolute angle θ₁. The "
        "joint must "
        f"hold τ₁ = T₁ + T₂ + T₃ = {1000 * joint:.4g} mN m.", ("statics", "virtual work"))  # fmt: skip


def _check_completeness() -> ErrataItem:
    """Check whether Eq. 3 to 12 give the complete torque of a motion.

    The paper mentions neither springs nor the inertia of the actuator.
    """
    torques = closing_torques("index", CLOSING_DURATIONS_S[-1])
    links = sum(torques.torque_by_cause[torque_cause] for torque_cause in TORQUE_CAUSES[:3])
    link_and_motor_torque = links + torques.torque_by_cause["motor inertia"]
    links_peak, driven_peak = (
        float(np.abs(torque).max()) / torques.moment_arm_m
        for torque in (links, link_and_motor_torque)
    )
    return ErrataItem(
        "sec7.complete", "Sec. 7", "the torque required to move the fingers", links_peak, "N",
        verdict_of_ambiguous_statement([True, links_peak > 0.5 * driven_peak]),
        f"Peak tension for closing a finger by {CLOSED_JOINT_ANGLE_DEG:g}° in {torques.duration_s:g} s with the "
        "dynamics of the links only, which Eq. 3 to 12 describe. This tension is complete if the actuator has no "
        "inertia, "
        "and the paper states no inertia. With the rotor of this project the peak is "
        f"{driven_peak:.1f} N. The return springs of this project (peak {torques.peak_tension('springs'):.1f} N) are "
        "not part of the paper's hand.", ("this project's dynamics",))  # fmt: skip


def _check_torque_value() -> ErrataItem:
    """Check whether the paper states a value of the torque, as section 8 of the paper claims.

    Eq. 10 to 12 contain symbols and no numbers.
    """
    torques = closing_torques("index", CLOSING_DURATIONS_S[-1])
    peak = 1000.0 * float(
        np.abs(
            sum(torques.torque_by_cause[torque_cause] for torque_cause in TORQUE_CAUSES[:3])
        ).max()
    )
    terms = [
        term
        for terms in equations.TORQUE_TERMS
        for term in terms
        if not term.printed_form.startswith("(")
    ]
    numbers = [
        term.id for term in terms if not any(reading.quantity_names for reading in term.readings)
    ]
    return ErrataItem(
        "sec8.torque", "Sec. 8", "dynamic modeling suggested the approximate value of the torque", peak, "mN m",
        verdict_of_statement(bool(numbers)),
        f"No value is printed: each of the {len(terms)} terms of Eq. 10 to 12 has symbols, whose values "
        "(masses, centres of mass, inertias, a motion) the paper does not give. With the values of this "
        f"project, closing by {CLOSED_JOINT_ANGLE_DEG:g}° in {torques.duration_s:g} s requires this peak torque, in "
        "the only coordinate of the finger.",
        ("count", "this project's dynamics"))  # fmt: skip
