"""The steps of the ablation: what the controller knows of the hand, one thing more at each step."""

from dataclasses import dataclass, replace
from functools import partial

from handctl.controller.gains import FilterGains, Gains, MotionGains, TensionGains
from handctl.controller.model import Inverse
from handctl.controller.tick import Controller
from handctl.hand.digit import DigitModel, Values
from handctl.hand.dynamics import damping_torque, required_torque, spring_torque, static_torque
from handctl.paper import equations

RAW = {"free_rate_N_per_s": 1e4}
"""Noise assumed of a filter that, on the way, believes the newest load-cell sample, as if there were none."""
NO_FORCE_LOOP = {"disturbance_rejection": 0.0, "tension_feedback": 0.0}


def nothing(digit: DigitModel, q: Values, dq: Values, ddq: Values) -> tuple[float, ...]:
    """No torque: feedback alone."""
    return (0.0,) * digit.joint_count


def statics(digit: DigitModel, q: Values, dq: Values, ddq: Values) -> tuple[float, ...]:
    """Gravity and springs."""
    return static_torque(digit, q)


def misprinted(digit: DigitModel, q: Values, dq: Values, ddq: Values) -> tuple[float, ...]:
    """Eq. 10 to 12 as the paper prints them, in their first reading, instead of the links' dynamics.

    Torques of the absolute angles, mapped to the joints as they should be (the paper does not say), with springs and
    damping, which the paper does not have. A digit that lacks a link lacks its terms.
    """
    names = {}
    for order, values in (("", q), ("d", dq), ("dd", ddq)):
        total = 0.0
        for i in range(3):
            total += float(values[i]) if i < digit.joint_count else 0.0
            names[f"{order}th{i + 1}"] = total
    for i in range(3):
        here = i < digit.joint_count
        names[f"L{i + 1}"] = digit.lengths[i] if here else 0.0
        names[f"d{i + 1}"] = digit.coms[i] if here else 0.0
        names[f"m{i + 1}"] = digit.masses[i] if here else 0.0
        names[f"I{i + 1}"] = digit.inertias[i] if here else 0.0
    names["g"] = -digit.gravity[1]
    printed = [sum(float(term.readings[0].value(names)) for term in terms) for terms in equations.TORQUES]
    joint = (sum(printed), printed[1] + printed[2], printed[2])[: digit.joint_count]
    passive = zip(spring_torque(digit, q), damping_torque(digit, dq), strict=True)
    return tuple(tau + sum(parts) for tau, parts in zip(joint, passive, strict=True))


@dataclass(frozen=True)
class Law:
    """One step of the ablation.

    Attributes:
        inverse: joint torque that is fed forward.
        motion, filter, tension: gains that differ from the defaults.
    """

    inverse: Inverse
    motion: dict[str, float]
    filter: dict[str, float]
    tension: dict[str, float]

    def gains(self, position_error_m: float, speed_error_m_s: float) -> Gains:
        """Gains with the two weights that were tuned."""
        weights = {"position_error_m": position_error_m, "speed_error_m_s": speed_error_m_s}
        motion = MotionGains(**weights, **self.motion)
        return Gains(motion=motion, filter=FilterGains(**self.filter), tension=TensionGains(**self.tension))

    @property
    def change(self) -> partial[Controller]:
        """What is done to the controller."""
        return partial(_with_inverse, inverse=self.inverse)


def _with_inverse(controller: Controller, inverse: Inverse) -> Controller:
    return replace(controller, model=replace(controller.model, inverse=inverse))


SPRINGS = {"inertia_share": 0.0, "friction_share": 0.0, **NO_FORCE_LOOP}
MOTOR = {"friction_share": 0.0, **NO_FORCE_LOOP}
LAWS = {
    "PD alone": Law(nothing, SPRINGS, {}, {}),
    "+ gravity and springs": Law(statics, SPRINGS, {}, {}),
    "+ motor inertia": Law(statics, MOTOR, {}, {}),
    "+ friction": Law(statics, NO_FORCE_LOOP, {}, {}),
    "+ full computed torque": Law(required_torque, NO_FORCE_LOOP, {}, {}),
    "+ force loop, raw sensor": Law(required_torque, {}, RAW, {}),
    "+ force loop, estimate": Law(required_torque, {}, {}, {}),
    "the same, Eq. 10-12 as printed": Law(misprinted, {}, {}, {}),
}
