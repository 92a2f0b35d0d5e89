"""Block with the constants of a hand.

The constants come from the model, the drives, the sensors and the limits of the hand.
"""

import functools
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from handctl.core import constants as h
from handctl.core.block_schema import BlockArray, BlockLayout
from handctl.core.constants import CONSTANT_SCHEMA, FILTER_DESIGN_COUNT, FILTER_DESIGN_SIZE
from handctl.core.control_law.computed_torque import (
    MAX_UNWINDING_FORCE_FRACTION,
    MOTOR_FRICTION_SPEED_M_S,
    TRIM_DECAY_TIME_S,
)
from handctl.core.control_law.servo_commands import MAX_LOOP_PHASE_RAD
from handctl.core.deferred_imports import DeferredModule
from handctl.core.detectors.residuals import RESIDUAL_TIME_CONSTANTS_S
from handctl.core.estimation import blocked_digits, contact_force, posture
from handctl.core.estimation.filter_types import FilterBlock
from handctl.core.estimation.varying_moment_arms import MIN_SPRING_STIFFNESS
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import Vector
from handctl.drives.sensors.sensor_node import JOINT_STEP_M, JOINT_STEP_RAD
from handctl.hand.digit import DigitModel

linalg = DeferredModule("scipy.linalg")

MIN_JOINT_MOTION_FRACTION = 1e-9
"""Entry of ``EXCURSION_TO_JOINTS`` above which a tendon moves a joint, as a fraction of the largest entry.

Smaller entries are rounding errors.
"""


def layout_of_constants(model: HandModel) -> BlockLayout:
    """Return the layout of the block with the constants of a hand."""
    return CONSTANT_SCHEMA.layout({
        "tendon": model.tendon_count,
        "joint": len(model.hand.joints),
        "digit": len(model.digits),
        "coordinate": model.coordinate_count,
        "kind": FILTER_DESIGN_COUNT,
        "element": FILTER_DESIGN_SIZE,
        "place": max(digit.joint_count for digit in model.digits) + 2,
        "run": 1,
    })  # fmt: skip


class HandConstants:
    """Constants of a hand and of its gains.

    Attributes:
        layout: layout of the block.
        block: array with all constants. The array is read-only, unless a moment arm of the hand
            varies with the joint angle.
    """

    def __init__(self, model: HandModel, extra_constants: Mapping[str, object]) -> None:
        """Fill the block with the constants of a hand.

        Args:
            model: model of the hand.
            extra_constants: constants that are not in the model, by field: tare, zero, thresholds,
                and constants of drives and sensors.
        """
        self.layout = layout_of_constants(model)
        self.block: BlockArray = self.layout.initial.copy()
        for constants_group in (
            _motor_constants(model),
            _control_law_constants(model),
            _link_constants(model),
            _structure_constants(model),
            _posture_constants(model),
            extra_constants,
        ):
            for name, value in constants_group.items():
                self.layout.view(self.block, name)[...] = value
        self.layout.view(self.block, "design")[...] = filter_design_array(model)
        self.block.flags.writeable = bool(model.hand.has_varying_arm.any())


def _motor_constants(model: HandModel) -> dict[str, object]:
    tendons = model.tendon_constants
    return {
        "motor_mass": tendons.motor_mass,
        "motor_damping": tendons.motor_damping,
        "coulomb": tendons.coulomb_friction,
        "stiffness": tendons.stiffness,
        "load_stiffness": tendons.load_stiffness,
        "load_damping": tendons.load_damping,
        "spool": tendons.spool_radius,
        "capstan": model.friction_coefficient,
        "wrap": model.wrap_angle,
        "floor": model.floor,
        "ceiling": model.ceiling,
        "torque_gain": 1.0 if model.torque_gain is None else model.torque_gain,
        "digit": model.digit_of_tendon,
        "side": model.redundancy.closing_sign,
        "open_excursion": model.redundancy.excursion_at_lower_limits,
        "excursion_low": model.redundancy.excursion_range[0],
        "excursion_high": model.redundancy.excursion_range[1],
        "relaxed": model.relaxed_tensions,
        "blind": model.margin_without_cell,
        "balance": model.redundancy.balance_tension,
        "pair": model.is_pair,
        "pretension": model.hand.pretension,
        "sprung": model.redundancy.has_return_springs,
        "redundant": model.redundancy.has_surplus,
        "absolute": ~model.redundancy.has_return_springs & ~model.hand.tendons_with_encoders,
        "period": model.period,
        "period_ns": round(model.period * 1e9),
        "touch_kept": math.exp(-model.period / blocked_digits.TOUCH_TIME_CONSTANT_S),
        "felt_fraction": -math.expm1(-model.period / contact_force.TIP_FORCE_TIME_CONSTANT_S),
        "usual_fraction": -math.expm1(-model.period / contact_force.TIP_FORCE_MEAN_TIME_CONSTANT_S),
        "drift_fraction": -math.expm1(
            -model.period / contact_force.TIP_FORCE_DRIFT_TIME_CONSTANT_S
        ),
        "fast_fraction": -math.expm1(-model.period / contact_force.FAST_GRIP_TIME_CONSTANT_S),
        "slow_fraction": -math.expm1(-model.period / contact_force.SLOW_GRIP_TIME_CONSTANT_S),
        "arms_sum": (
            np.abs(model.hand.moment_arms_of_own_digit) * model.hand.display_units.scale
        ).sum(axis=1),
    }


def _control_law_constants(model: HandModel) -> dict[str, object]:
    tendons = model.tendon_constants
    motion = model.gains.motion
    tension = model.gains.tension
    limit = model.torque_limit / tendons.spool_radius
    half_period_gain = 0.5 * model.period / tendons.motor_mass
    return {
        "limit": limit,
        "unwind": np.where(model.is_pair, -1.0, -MAX_UNWINDING_FORCE_FRACTION) * limit,
        "mass": tendons.motor_mass + tendons.load_mass,
        "inertia": motion.inertia_share * tendons.motor_mass,
        "error_gain": model.motion_design.stiffness,
        "speed_gain": model.motion_design.damping,
        "tension_gain": model.motion_design.tension,
        "tension_speed_gain": model.motion_design.tension_speed,
        "half": half_period_gain,
        "stopping": MOTOR_FRICTION_SPEED_M_S + half_period_gain * tendons.coulomb_friction,
        "exact": [exact for digit in model.digits for exact in _has_exact_solution(digit)],
        "rejection": motion.disturbance_rejection,
        "friction_fraction": motion.friction_share,
        "tension_feedback": motion.tension_feedback,
        "integral_gain": tension.integral_per_s * model.period,
        "stream_speed": math.radians(model.hand.stream.speed_deg_s),
        "stream_acceleration": math.radians(model.hand.stream.acceleration_deg_s2),
        "stream_hold_ns": round(1e6 * model.hand.stream.hold_after_ms),
        "stream_relax_ns": round(1e6 * model.hand.stream.relax_after_ms),
        "trim_kept": math.exp(-model.period / TRIM_DECAY_TIME_S),
        **servo_constants(model),
    }


def servo_constants(model: HandModel) -> dict[str, Vector]:
    """Return the stiffness and damping of the drives' position loops, and a flag for each drive with a position loop.

    If the hand file contains neither stiffness nor damping, the position loops have the gains of
    the motion loop. If the hand file contains only the stiffness, the position loops have the
    damping ratio of the motion loop. The stiffness is limited, and the limit falls with the control
    rate, see ``servo_commands.MAX_LOOP_PHASE_RAD``.
    """
    tendons = model.tendon_constants
    motors = [model.hand.motor_of_tendon(name) for name in model.hand.tendon_names]
    inertia = (tendons.motor_mass + tendons.load_mass) * tendons.spool_radius**2
    stiffness = inertia * model.motion_design.stiffness
    damping = inertia * model.motion_design.damping
    kp = np.array([motor.kp_N_m_per_rad for motor in motors], dtype=np.float64)  # NaN if absent
    kd = np.array([motor.kd_N_m_s_per_rad for motor in motors], dtype=np.float64)
    max_stiffness = inertia * (MAX_LOOP_PHASE_RAD / model.period) ** 2
    kp = np.minimum(np.where(np.isnan(kp), stiffness, kp), max_stiffness)
    kd = np.where(np.isnan(kd), damping * np.sqrt(kp / stiffness), kd)
    return {
        "servo": np.array([motor.closes_position_loop for motor in motors]),
        "servo_stiffness": kp,
        "servo_damping": kd,
    }


def _has_exact_solution(digit: DigitModel) -> list[bool]:
    """Return a flag for each tendon of a digit: True if the digit has as many tendons as coordinates.

    In a digit with as many tendons as coordinates, the joint torques determine the tensions.
    """
    tendons, coordinates = digit.reduced_moment_arms.shape
    return [tendons == coordinates] * tendons


def _link_constants(model: HandModel) -> dict[str, object]:
    digits = model.digits
    coordinates = np.array(
        [0, *(coordinate_slice.stop for coordinate_slice in model.digit_coordinates)]
    )
    angle_ranges = np.concatenate([digit.joint_max - digit.joint_min for digit in digits])
    return {
        "spring": np.concatenate([digit.spring_stiffness for digit in digits]),
        "preload": np.concatenate([digit.spring_preload for digit in digits]),
        "joint_scale": model.hand.display_units.scale,
        "joint_damping": np.concatenate([digit.joint_damping for digit in digits]),
        "link": model.link_tree.table,
        "parent": model.link_tree.parent,
        "low": np.concatenate([digit.joint_min for digit in digits]),
        "high": np.concatenate([digit.joint_max for digit in digits]),
        "range_sigma": angle_ranges / math.sqrt(12.0),
        "gravity": np.array(model.hand.mount.gravity_m_s2)[:, None],
        "joints_first": [digit.joints.start for digit in digits],
        "joints_end": [digit.joints.stop for digit in digits],
        "tendons_first": [digit.tendons.start for digit in digits],
        "tendons_end": [digit.tendons.stop for digit in digits],
        "coordinates_first": coordinates[:-1],
        "coordinates_end": coordinates[1:],
    }


def _structure_constants(model: HandModel) -> dict[str, object]:
    digits = model.digits
    joint_motion = np.abs(model.excursion_to_joints)
    return {
        "excursion_to_joints": model.excursion_to_joints,
        "moves": joint_motion > MIN_JOINT_MOTION_FRACTION * joint_motion.max(initial=0.0),
        "moment_arms": model.hand.moment_arms_of_own_digit,
        "carrier_arms": model.hand.moment_arms_of_carrying_digits,
        "hand_passed": bool(model.hand.moment_arms_of_carrying_digits.any()),
        "varying": model.hand.has_varying_arm,
        "digit_varying": [digit.has_varying_arm for digit in digits],
        "hand_varying": bool(model.hand.has_varying_arm.any()),
        "arm_polynomial": np.moveaxis(model.hand.arm_polynomials, 2, 0),
        "mean_balance": model.redundancy.balance_tension,
        # For constant moment arms, the two offsets are zero. For varying moment arms,
        # ``estimation.varying_moment_arms`` writes the two offsets in each tick.
        "angle_offset": 0.0,
        "explained_offset": 0.0,
        "torque_to_tension": model.torque_to_tension,
        "pulley_weight": model.pulley_weights,
        "coupling": model.coupling,
        "reduced_arms": linalg.block_diag(*(digit.reduced_moment_arms for digit in digits)),
    }


def _posture_constants(model: HandModel) -> dict[str, object]:
    digits = model.digits
    hand = model.hand
    arms = model.hand.moment_arms_of_own_digit
    joint_counts = [digit.joint_count for digit in digits]
    compliance = linalg.block_diag(*(_joint_compliance(digit) for digit in digits))
    spread = linalg.block_diag(*(digit.coupling @ digit.coupling.T for digit in digits))
    has_encoder = np.array([joint in hand.sensor_node.joints for joint in hand.joints])
    are_encoders_fused = bool((compliance.any(axis=1) & has_encoder).any())
    update_ticks = (
        1 if are_encoders_fused else max(1, round(posture.POSTURE_UPDATE_PERIOD_S / model.period))
    )
    step_size = np.where(hand.is_prismatic, JOINT_STEP_M, JOINT_STEP_RAD)
    noise = hand.joint_noise**2 + step_size**2 / 12.0
    hinge_variance = hand.sensor_node.joint_noise_rad**2 + JOINT_STEP_RAD**2 / 12.0
    return {
        "compliance": compliance,
        "spread": spread,
        "posture_torque": spread @ arms.T,
        "same_digit": linalg.block_diag(*(np.ones((size, size)) for size in joint_counts)),
        "place_weight": np.concatenate(
            [_contact_place_probabilities(digits, digit) for digit in digits], axis=1
        ),
        "encoder_variance": noise,
        "loose": compliance.any(axis=1) & has_encoder,
        "excursion_variance": np.where(
            hand.tendons_with_encoders,
            hinge_variance * (arms**2 * (noise / hinge_variance)).sum(axis=1),
            (2.0 * model.gains.filter.offset_m) ** 2,
        ),
        "turn_fraction": -math.expm1(-update_ticks * model.period / posture.TURN_SMOOTHING_S),
        "pressed_kept": math.exp(-model.period / posture.CONTACT_DECAY_TIME_S),
        "null_space": bool(compliance.any()),
        "joints_fused": are_encoders_fused,
        "posture_ticks": update_ticks,
    }


def _joint_compliance(digit: DigitModel) -> Vector:
    """Return the compliance of the joints, rotation per torque at constant excursions, (n, n) [rad/(N m)].

    With the spring stiffness K and a basis N of the null space of the moment arms, the compliance
    is N (N^T K N)^-1 N^T.
    """
    free_motions = linalg.null_space(digit.moment_arms)
    if not free_motions.shape[1]:
        return np.zeros((digit.joint_count, digit.joint_count))
    min_stiffness = MIN_SPRING_STIFFNESS / digit.joint_units.scale**2
    stiffness = np.diag(np.maximum(digit.spring_stiffness, min_stiffness))
    return np.asarray(
        free_motions @ np.linalg.solve(free_motions.T @ stiffness @ free_motions, free_motions.T)
    )


def _contact_place_probabilities(digits: tuple[DigitModel, ...], digit: DigitModel) -> Vector:
    """Return the probability of each assumed contact place on a digit, with a column per joint, (places, n).

    All columns are equal. The assumed contacts are a force at the middle of each link, a force at
    the tip, and an equal torque on all joints, see ``posture``.
    """
    n = digit.joint_count
    probabilities = np.zeros((max(any_digit.joint_count for any_digit in digits) + 2, n))
    probabilities[: n + 1] = probabilities[-1] = 1.0 / (n + 2)
    return probabilities


@functools.lru_cache(maxsize=16)
def filter_design_array(model: HandModel) -> NDArray[np.float64]:
    """Return the filter designs of a hand as an array (N, KINDS, ELEMENTS), for compiled code."""
    return np.array(
        [[_block_elements(block) for block in tendon] for tendon in model.filter_design.blocks]
    )


def _block_elements(block: FilterBlock) -> Vector:
    information = block.innovation_information
    return np.concatenate((
        block.F.ravel(), block.B.ravel(), block.K.ravel(), block.Q.ravel(), block.R, block.P.ravel(), block.H.ravel(),
        block.tension_row, [information[0, 0], 2.0 * information[0, 1], information[1, 1]],
        [block.tension_variance, block.cell_sigma, block.cell_error_variance, float(block.is_cell_error_observable)],
    ))  # fmt: skip


def low_pass_fractions(model: HandModel, motor_period: Vector, joint_period: float) -> Vector:
    """Return the update fraction (9, N) of each low-passed residual.

    Each update adds to a residual the update fraction times the difference of input and residual.
    """
    sample_periods = np.full((len(RESIDUAL_TIME_CONSTANTS_S), model.tendon_count), model.period)
    sample_periods[2] = motor_period  # row COMMAND_DIFFERENCE
    sample_periods[5] = joint_period  # row SLIP
    return np.asarray(1.0 - np.exp(-sample_periods / np.array(RESIDUAL_TIME_CONSTANTS_S)[:, None]))


assert h.CELL_ERROR_OBSERVABLE_OFFSET == FILTER_DESIGN_SIZE - 1
