"""Define the control laws that the tracking benchmark compares.

Each control law adds one part to the preceding control law.
"""

from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

from handctl.controller.controller_state import ControllerState
from handctl.controller.tick import Controller
from handctl.core import state_block as s
from handctl.core.gains.gains import Gains, MotionGains
from handctl.core.gains.motion_design import force_weight_at_period
from handctl.core.hand_model import InverseDynamics
from handctl.core.tick_types import TickIn
from handctl.drives.frame_records import Frames
from handctl.hand.digit import DigitModel, JointValues
from handctl.hand.dynamics import damping_torque, required_torque, spring_torque, static_torque
from handctl.paper.model import equations

NO_FORCE_LOOP_GAINS = {"disturbance_rejection": 0.0, "tension_feedback": 0.0}


def zero_torque(
    digit: DigitModel, q: JointValues, dq: JointValues, ddq: JointValues
) -> tuple[float, ...]:
    """Return zero feedforward torque for each joint, so that only feedback acts."""
    return (0.0,) * digit.joint_count


def gravity_and_spring_torque(
    digit: DigitModel, q: JointValues, dq: JointValues, ddq: JointValues
) -> tuple[float, ...]:
    """Return the feedforward torque that balances gravity and springs."""
    return static_torque(digit, q)


def springs_without_gravity(
    digit: DigitModel, q: JointValues, dq: JointValues, ddq: JointValues
) -> tuple[float, ...]:
    """Return the feedforward joint torques that balance the springs, but not gravity."""
    return spring_torque(digit, q)


def torque_without_gravity(
    digit: DigitModel, q: JointValues, dq: JointValues, ddq: JointValues
) -> tuple[float, ...]:
    """Return the feedforward torque of the inverse dynamics without gravity."""
    torques_of_joints = zip(
        required_torque(digit, q, dq, ddq),
        static_torque(digit, q),
        spring_torque(digit, q),
        strict=True,
    )
    return tuple(full_torque - static + spring for full_torque, static, spring in torques_of_joints)


def misprinted_torque(
    digit: DigitModel, q: JointValues, dq: JointValues, ddq: JointValues
) -> tuple[float, ...]:
    """Return the joint torque from Eq. 10 to 12 of the source paper, including the misprints in these equations.

    The torques in Eq. 10 to 12 belong to absolute angles of the links. The function converts the
    torques of Eq. 10 to 12 to joint torques, and adds the torques of springs and damping. The paper
    contains neither the conversion to joint torques, nor springs and damping. For a digit with
    fewer links than in the paper, the terms of the missing links are left out.
    """
    names = {}
    for order, values in (("", q), ("d", dq), ("dd", ddq)):
        total = 0.0
        for i in range(3):
            total += float(values[i]) if i < digit.joint_count else 0.0
            names[f"{order}th{i + 1}"] = total
    for i in range(3):
        has_joint = i < digit.joint_count
        names[f"L{i + 1}"] = digit.lengths[i] if has_joint else 0.0
        names[f"d{i + 1}"] = float(digit.centres_of_mass[i, 0]) if has_joint else 0.0
        names[f"m{i + 1}"] = digit.masses[i] if has_joint else 0.0
        names[f"I{i + 1}"] = float(digit.inertias[i, 2, 2]) if has_joint else 0.0
    names["g"] = -float((digit.gravity @ digit.mount_rotation)[1])
    printed_torque = [
        sum(float(term.readings[0].evaluate(names)) for term in equation_terms)
        for equation_terms in equations.TORQUE_TERMS
    ]
    joint = (sum(printed_torque), printed_torque[1] + printed_torque[2], printed_torque[2])[
        : digit.joint_count
    ]
    passive_torques = zip(spring_torque(digit, q), damping_torque(digit, dq), strict=True)
    return tuple(
        tau + sum(passive_torques_of_joint)
        for tau, passive_torques_of_joint in zip(joint, passive_torques, strict=True)
    )


MOTION_FORCE_WEIGHT_N = 20.0
"""Motor force in the LQR cost [N].

In the LQR cost, this motor force counts as much as each of the two errors that define the LQR
weights.
"""


def force_weight_factor(rate_hz: float) -> float:
    """Return the factor by which the benchmark multiplies the weight of the motor force at a control rate.

    At a low control rate, the controller reduces the weight of the motor force in the LQR cost. The
    factor cancels this reduction.
    """
    return 1.0 / force_weight_at_period(1.0, 1.0 / rate_hz)


class RawTensionController(Controller):
    """Controller whose control law uses the newest load-cell reading as the tension.

    The newest load-cell reading is one control period old. If the reading is missing, the control
    law uses the estimated tension.
    """

    __slots__ = ()

    def _process_frames(
        self, last_state: ControllerState, state: ControllerState, entry: TickIn, frames: Frames
    ) -> tuple[str, ...]:
        signs = super()._process_frames(last_state, state, entry, frames)
        cell = state.tendon[s.MEASURED_TENSION]
        state.tendon[s.TENSION] = np.where(np.isnan(cell), state.tendon[s.TENSION], cell)
        return signs


def controller_on_raw_tension(controller: Controller) -> Controller:
    """Return a copy of a controller that uses load-cell readings instead of the estimated tensions."""
    return RawTensionController(
        **{
            controller_field.name: getattr(controller, controller_field.name)
            for controller_field in fields(controller)
            if controller_field.init
        }
    )


@dataclass(frozen=True)
class AblationLaw:
    """One of the control laws that the tracking benchmark compares.

    Attributes:
        inverse_dynamics: function that returns the feedforward joint torque.
        motion_gains: gains of the motion loop that differ from the default gains.
        with_raw_tension: True if the input of the tension loop is the raw load cell. False if the
            input is the estimated tension.
    """

    inverse_dynamics: InverseDynamics
    motion_gains: dict[str, float]
    with_raw_tension: bool = False

    def gains(self, position_error_m: float, speed_error_m_s: float, rate_hz: float) -> Gains:
        """Return the gains of this control law for two LQR weights and a control rate.

        All other gains are defined in this module, so that they do not depend on the packaged
        gains.
        """
        weights = {"position_error_m": position_error_m, "speed_error_m_s": speed_error_m_s}
        fixed_gains = {
            "force_N": MOTION_FORCE_WEIGHT_N * force_weight_factor(rate_hz),
            "disturbance_rejection": 1.0,
            "tension_feedback": 0.3,
        }
        return Gains(motion=MotionGains(**{**fixed_gains, **weights, **self.motion_gains}))

    @property
    def change_controller(self) -> partial[Controller]:
        """Return a function that changes a controller so that it uses this control law."""
        return partial(
            _replace_control_law,
            inverse_dynamics=self.inverse_dynamics,
            with_raw_tension=self.with_raw_tension,
        )


def _replace_control_law(
    controller: Controller, inverse_dynamics: InverseDynamics, with_raw_tension: bool
) -> Controller:
    changed_controller = replace(
        controller, model=replace(controller.model, inverse_dynamics=inverse_dynamics)
    )
    return controller_on_raw_tension(changed_controller) if with_raw_tension else changed_controller


NO_INERTIA_GAINS = {"inertia_share": 0.0, "friction_share": 0.0, **NO_FORCE_LOOP_GAINS}
NO_FRICTION_GAINS = {"friction_share": 0.0, **NO_FORCE_LOOP_GAINS}
GRAVITY_LAW_BY_NAME = {
    "PD and springs": AblationLaw(springs_without_gravity, NO_INERTIA_GAINS),
    "PD and springs, + gravity": AblationLaw(gravity_and_spring_torque, NO_INERTIA_GAINS),
    "computed torque without gravity": AblationLaw(torque_without_gravity, NO_FORCE_LOOP_GAINS),
    "computed torque": AblationLaw(required_torque, NO_FORCE_LOOP_GAINS),
}
"""Two pairs of control laws for a hand that lies on its side.

The two control laws of a pair differ only in gravity compensation.
"""
COMPARED_LAW_BY_NAME = {
    "PD alone": AblationLaw(zero_torque, NO_INERTIA_GAINS),
    "+ gravity and springs": AblationLaw(gravity_and_spring_torque, NO_INERTIA_GAINS),
    "+ motor inertia": AblationLaw(gravity_and_spring_torque, NO_FRICTION_GAINS),
    "+ friction": AblationLaw(gravity_and_spring_torque, NO_FORCE_LOOP_GAINS),
    "+ full computed torque": AblationLaw(required_torque, NO_FORCE_LOOP_GAINS),
    "+ force loop, raw sensor": AblationLaw(required_torque, {}, with_raw_tension=True),
    "+ force loop, estimate": AblationLaw(required_torque, {}),
    "the same, Eq. 10-12 as printed": AblationLaw(misprinted_torque, {}),
}
