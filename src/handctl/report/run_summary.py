"""Numbers about a run: timing of the control loop, tracking errors, and accuracy of the estimates."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.core.control_law.tendon_redundancy import tendon_directions
from handctl.core.tick_types import HandMode
from handctl.document import validate_content
from handctl.drives.frame_time import frame_time_s
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.file.display_units import EQUIVALENT_M_PER_RAD
from handctl.hand.hand_loading import parse_toml
from handctl.log.read.reader import RunLog
from handctl.programs.task import Task
from handctl.report.lift_judgement import TABLE_DEPTH_COLUMN
from handctl.report.truth_record import TruthRecord

Array = NDArray[np.float64]

SETTLING_TIME_S = 0.5
"""Time for which the tension targets must have been constant in a hold phase before the hold is judged [s]."""
MAX_TARGET_CHANGE_N = 1.0
"""Largest change of tension targets that still count as constant [N].

In a hold with stiffness, the tension targets follow the noise of the encoders and are never exactly
constant.
"""
TENSION_ERROR_KEYS = (
    "tension_rmse_n",
    "tension_raw_rmse_n",
    "tension_hold_error_n",
    "tension_hold_peak_error_n",
)
"""Keys of the tension errors in a summary. Without true values, the tension errors are NaN."""


def summarise_run(
    log: RunLog, hand: Hand, truth: TruthRecord | None, offset_ns: int
) -> dict[str, Any]:
    """Return the summary of a run: rates, lateness, and errors of angles, tensions and the grasp.

    Args:
        log: log of the run.
        hand: hand of the run.
        truth: true values from the simulator. If ``truth`` is None, as on hardware, all numbers
            that need a true value are NaN. A truth file is ignored if its times do not match the
            log, for example if an earlier simulator wrote it.
        offset_ns: time on the clock of the simulator at which the time of the run is 0 [ns].

    Returns:
        the numbers and texts about the run, by name.
    """
    truth = truth if truth and truth.contains_any_time(log.t_ns + offset_ns) else None
    lateness_us = log.late_ns / 1e3
    active = np.isin(log.mode, (int(HandMode.ACTIVE),))
    result: dict[str, Any] = {
        "hand": hand.name,
        "ticks": len(log),
        "missed": int(log.k[-1]) + 1 - len(log) if len(log) else 0,
        "rate_hz": 1e9 / log.header.period_ns,
        "late_us": {
            "p50": _percentile(lateness_us, 50.0),
            "p99_9": _percentile(lateness_us, 99.9),
            "max": float(lateness_us.max(initial=0.0)),
        },
    }
    hold_masks = hold_phase_masks(log, hand)
    result |= judge_tracking(log, hand, truth, offset_ns, active)
    result |= judge_tension(log, hand, truth, offset_ns, active, hold_masks)
    result |= judge_grasp(log, hand, truth, offset_ns, hold_masks)
    return result | {"joint_angles": judge_angles(log, hand, truth, offset_ns, active, hold_masks)}


def _percentile(values: NDArray[Any], percent: float) -> float:
    """Return a percentile of the given values, or NaN if there are no values."""
    return float(np.percentile(values, percent)) if len(values) else float("nan")


def root_mean_square(values: Array) -> float:
    """Return the root mean square of all values except NaN.

    If all values are NaN, the result is NaN.
    """
    finite_values = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(finite_values**2))) if finite_values.size else float("nan")


def hold_phase_masks(log: RunLog, hand: Hand) -> list[NDArray[np.bool_]]:
    """Return one mask (ticks,) for each hold phase of a run.

    A mask is True where the hold is settled.

    A hold is settled if a digit touches an object, and if the target tensions have been constant
    for SETTLING_TIME_S. Target tensions of tendons that hold an angle are ignored, because these
    target tensions change with the load.
    """
    goal = np.where(_holding_mask(log, hand), np.nan_to_num(log.field("tension_goal")), 0.0)
    in_contact = log.field("contact").any(axis=1)
    moving = np.abs(np.diff(goal, axis=0, prepend=goal[:1])).max(axis=1) >= 1e-9
    hold_masks = []
    phase_changes = log.phases
    kinds = _kind_by_phase_name(log)
    for i, change in enumerate(phase_changes):
        # The phases of a task can have any names, so the kind of a phase comes from the task. Other
        # programs call their hold phases "hold".
        if kinds.get(change.name, change.name[:4]) != "hold":
            continue
        end = phase_changes[i + 1].k if i + 1 < len(phase_changes) else log.k[-1] + 1
        is_inside = (log.k >= change.k) & (log.k < end)
        hold_mask = is_inside & in_contact & _settled_mask(is_inside & moving, is_inside, log)
        if not hold_mask.any() and is_inside.any():
            is_far_from_target = (
                np.abs(goal - goal[is_inside][-1]).max(axis=1) > MAX_TARGET_CHANGE_N
            )
            hold_mask = (
                is_inside
                & in_contact
                & _settled_mask(is_inside & is_far_from_target, is_inside, log)
            )
        hold_masks.append(hold_mask)
    return hold_masks


def _kind_by_phase_name(log: RunLog) -> dict[str, str]:
    """Return a mapping from the name of each task phase in a log to the kind of the phase.

    The result is empty if the log has no valid task.
    """
    location = "task.toml in the log"
    try:
        text = log.header.attachments.get("task.toml", b"").decode()
        task = validate_content(parse_toml(text, location), Task, location)
    except (ConfigError, UnicodeDecodeError):
        return {}
    return {phase.name: phase.kind for phase in task.phase}


def _settled_mask(
    moving_mask: NDArray[np.bool_], inside_mask: NDArray[np.bool_], log: RunLog
) -> NDArray[np.bool_]:
    """Return a mask (ticks,) that is True where the targets of a hold phase have been constant for SETTLING_TIME_S."""
    moving_ticks = np.flatnonzero(moving_mask)
    settled_mask: NDArray[np.bool_] = (
        log.times
        >= log.times[moving_ticks[-1] if len(moving_ticks) else np.argmax(inside_mask)]
        + SETTLING_TIME_S
    )
    return settled_mask


def mean_angles(hand: Hand, q: Array) -> Array:
    """Return the mean joint angle of each digit (ticks, D) [rad].

    The mean of the joint angles q of a digit is weighted with the moment arms r of the joints:
    sum(r q) / sum(r). For a digit that has only prismatic joints, the result is in m. If a digit
    has both hinges and prismatic joints, the position of a prismatic joint is converted to rad with
    the scale of ``DisplayUnits``.
    """
    columns = []
    for name in hand.digit_names:
        digit = DigitModel.from_hand(hand, name)
        weights = np.abs(digit.moment_arms).sum(axis=0)
        scale = 1.0 if digit.is_prismatic.all() else digit.joint_units.scale
        columns.append(q[:, digit.joints] @ weights / (weights * scale).sum())
    return np.column_stack(columns)


def judge_tracking(
    log: RunLog,
    hand: Hand,
    truth: TruthRecord | None,
    offset_ns: int,
    active_mask: NDArray[np.bool_],
) -> dict[str, Any]:
    """Return the tracking errors in free motion: the differences between the targets and the true values.

    The result has an error for the mean joint angle of each digit, and an error for each joint
    angle.

    Args:
        log: log of the run.
        hand: hand of the run.
        truth: true values from the simulator, or None on hardware.
        offset_ns: time on the simulator's clock when the time of the run is 0 [ns].
        active_mask: mask (ticks,) that is True where the hand is active.
    """
    goal = mean_angles(hand, log.field("q_goal"))
    free_motion_mask = active_mask[:, None] & ~np.isnan(goal) & (log.field("contact") == 0.0)
    nan_result = {
        "tracking_rmse_rad": float("nan"),
        "tracking_rmse_deg": {},
        "tracking_rmse_joint_deg": {},
    }
    if truth is None:
        return nan_result
    joint_angles = truth.interpolated_columns(
        [f"q/{joint}" for joint in hand.joints], log.t_ns + offset_ns
    )
    true_angles = mean_angles(hand, joint_angles)
    touch_mask = _contact_mask(truth, hand, log, offset_ns)
    error = np.where(free_motion_mask & ~touch_mask, goal - true_angles, np.nan)
    error_by_digit = {
        name: float(
            hand.mean_position_units(name).to_display_units(root_mean_square(error[:, d]))[0]
        )
        for d, name in enumerate(hand.digit_names)
    }
    unit_scales = [hand.mean_position_units(name).scale[0] for name in hand.digit_names]
    digit_of_joint = np.repeat(
        np.arange(len(hand.digit)), [len(digit.joints) for digit in hand.digit]
    )
    joint_errors = np.where(
        (free_motion_mask & ~touch_mask)[:, digit_of_joint],
        log.field("q_goal") - joint_angles,
        np.nan,
    )
    error_by_joint = {
        name: hand.display_units.factor[j] * root_mean_square(joint_errors[:, j])
        for j, name in enumerate(hand.joints)
    }
    return {
        "tracking_rmse_rad": root_mean_square(error / unit_scales), "tracking_rmse_deg": error_by_digit,
        "tracking_rmse_joint_deg": error_by_joint
    }  # fmt: skip


def _contact_mask(truth: TruthRecord, hand: Hand, log: RunLog, offset_ns: int) -> NDArray[np.bool_]:
    """Return a mask (ticks, D) that is True where the digit has a contact in the simulated plant."""
    t_ns = log.t_ns + offset_ns
    force = [
        np.sqrt(
            sum(
                truth.interpolated_column(f"contact_force/{name}/{axis}", t_ns) ** 2
                for axis in "xyz"
            )
        )
        for name in hand.digit_names
    ]
    return np.column_stack(force) > 0.05


def judge_tension(
    log: RunLog,
    hand: Hand,
    truth: TruthRecord | None,
    offset_ns: int,
    active_mask: NDArray[np.bool_],
    hold_masks: list[NDArray[np.bool_]],
) -> dict[str, Any]:
    """Return three kinds of tension errors: of the estimates, of the load cells, and of the control in holds.

    The estimates and the load-cell readings are compared with the true tensions. The error of the
    control is the difference between the commanded and the true tension.

    Args:
        log: log of the run.
        hand: hand of the run.
        truth: true values from the simulator, or None if there are none.
        offset_ns: time on the simulator's clock when the time of the run is 0 [ns].
        active_mask: mask (ticks,), True where the hand is active.
        hold_masks: for each hold, a mask (ticks,) that is True where the hold is settled.
    """
    if truth is None:
        return dict.fromkeys(TENSION_ERROR_KEYS, float("nan"))
    names = [f"tension/{tendon}" for tendon in log.header.tendons]
    true_tensions = truth.interpolated_columns(names, log.t_ns + offset_ns)
    # When a tick uses a load-cell reading, the reading is one control period old.
    columns_before = truth.interpolated_columns(names, log.t_ns - log.header.period_ns + offset_ns)
    # One of the two tendons of a spool pair is always taut.
    is_taut = active_mask[:, None] & ((true_tensions > 0.5) | hand.is_pair)
    error = np.where(_holding_mask(log, hand), log.field("tension_goal") - true_tensions, np.nan)
    columns = [column[~np.isnan(column)] for hold in hold_masks for column in error[hold].T]
    columns = [column for column in columns if len(column)]
    errors = (
        root_mean_square(np.where(is_taut, log.field("tension") - true_tensions, np.nan)),
        root_mean_square(np.where(is_taut, log.field("tension_raw") - columns_before, np.nan)),
        max((abs(float(column.mean())) for column in columns), default=float("nan")),
        max((float(np.abs(column).max()) for column in columns), default=float("nan")),
    )
    return dict(zip(TENSION_ERROR_KEYS, errors, strict=True))


def _holding_mask(log: RunLog, hand: Hand) -> NDArray[np.bool_]:
    """Return a mask (ticks, N), True where a tendon follows a tension target because of a contact of the digit.

    The mask is False for a spool pair for sideways motion, because such a pair holds a position
    instead of a tension. The mask is also False for a digit on which other digits are mounted, such
    as a wrist.
    """
    digit_slices = [hand.digit_tendons[name] for name in hand.digit_names]
    digit_of_tendon = np.repeat(
        np.arange(len(digit_slices)), [tendons.stop - tendons.start for tendons in digit_slices]
    )
    directions_by_digit = [
        tendon_directions(DigitModel.from_hand(hand, name), hand.is_pair[hand.digit_tendons[name]])
        for name in hand.digit_names
    ]
    is_carrier = np.array([name in hand.carrier_digits for name in hand.digit_names])
    can_hold_tension = (np.concatenate(directions_by_digit) != 0.0) & ~is_carrier[digit_of_tendon]
    return np.asarray((log.field("contact") > 0.0)[:, digit_of_tendon] & can_hold_tension)


def judge_grasp(
    log: RunLog,
    hand: Hand,
    truth: TruthRecord | None,
    offset_ns: int,
    hold_masks: list[NDArray[np.bool_]],
) -> dict[str, Any]:
    """Return the motion of the object in a hold, and the forces on the fingertips: estimated and true.

    If the table never sank, the object still rests on the table, and the motion of the object is
    NaN.

    Args:
        log: log of the run.
        hand: hand of the run.
        truth: true values from the simulator, or None if there are none.
        offset_ns: time on the simulator's clock when the time of the run is 0 [ns].
        hold_masks: mask (ticks,) for each hold, True where the hold is settled.
    """
    settled_mask = np.any(hold_masks, axis=0) if hold_masks else np.zeros(len(log), dtype=bool)
    estimated = log.field("tip_force")[settled_mask]
    mean_forces = estimated.mean(axis=0) if len(estimated) else np.full(len(hand.digit), np.nan)
    result: dict[str, Any] = {
        "tip_equivalent_force_n": dict(zip(hand.digit_names, mean_forces.tolist(), strict=True))
    }
    if truth is None or not settled_mask.any():
        return result | {"object_motion_mm": float("nan"), "contact_force_n": {}}
    t_ns = log.t_ns + offset_ns
    force = {
        name: float(
            np.mean(
                np.sqrt(
                    sum(
                        truth.interpolated_column(
                            f"contact_force/{name}/{axis}", t_ns[settled_mask]
                        )
                        ** 2
                        for axis in "xyz"
                    )
                )
            )
        )
        for name in hand.digit_names
    }
    motion = float("nan")
    is_object_on_table = (
        truth.has_column(TABLE_DEPTH_COLUMN)
        and not truth.interpolated_column(TABLE_DEPTH_COLUMN, t_ns[settled_mask]).any()
    )
    if truth.has_column("object/x") and not is_object_on_table:
        paths = [
            truth.interpolated_columns(["object/x", "object/y", "object/z"], t_ns[hold])
            for hold in hold_masks
            if hold.any()
        ]
        motion = max(float(np.linalg.norm(path - path[0], axis=1).max() * 1e3) for path in paths)
    return result | {"object_motion_mm": motion, "contact_force_n": force}


def judge_angles(
    log: RunLog,
    hand: Hand,
    truth: TruthRecord | None,
    offset_ns: int,
    active_mask: NDArray[np.bool_],
    hold_masks: list[NDArray[np.bool_]],
) -> dict[str, dict[str, Any]]:
    """Return the errors of the estimated joint angles of each digit, in those ticks of the holds that are settled.

    If a run has no settled ticks, the errors come from all ticks in which the hand is active.

    Args:
        log: log of the run.
        hand: hand of the run.
        truth: true values from the simulator, or None if there are none.
        offset_ns: time on the simulator's clock when the time of the run is 0 [ns].
        active_mask: mask (ticks,), True where the hand is active.
        hold_masks: mask (ticks,) for each hold, True where the hold is settled.

    Returns:
        For each digit by name: `source` (see `angle_source`), `sigma_deg` (root mean square of the
        estimated standard deviations), `error_deg` (root mean square of the errors) and `inside`
        (fraction of the errors within two standard deviations). Without true values, `error_deg`
        and `inside` are NaN.
    """
    hold_mask = np.any(hold_masks, axis=0) if hold_masks and np.any(hold_masks) else active_mask
    q = log.field("q")[hold_mask]
    sigma = log.field("q_sigma")[hold_mask]
    error = np.full_like(q, np.nan)
    if truth is not None:
        error = q - truth.interpolated_columns(
            [f"q/{joint}" for joint in hand.joints], log.t_ns[hold_mask] + offset_ns
        )
    angles = {}
    for name, joints in hand.digit_joints.items():
        is_finite = ~np.isnan(error[:, joints]) & ~np.isnan(sigma[:, joints])
        is_within_two_sigma = np.abs(error[:, joints]) <= 2.0 * sigma[:, joints]
        unit = hand.mean_position_units(name)
        scale = 1.0 if unit.is_prismatic[0] else hand.display_units.scale[joints]
        angles[name] = {
            "source": angle_source(hand, name),
            "sigma_deg": float(unit.factor[0] * root_mean_square(sigma[:, joints] / scale)),
            "error_deg": float(unit.factor[0] * root_mean_square(error[:, joints] / scale)),
            "inside": float(is_within_two_sigma[is_finite].mean())
            if is_finite.any()
            else float("nan"),
        }
        if unit.is_prismatic[0]:
            angles[name]["unit"] = unit.names[0]
    return angles


def angle_source(hand: Hand, name: str) -> str:
    """Return the source of the estimated joint angles of a digit: "excursion", "encoders" or "assumed"."""
    digit = DigitModel.from_hand(hand, name)
    # If a digit has as many independent tendons as joints, the joint angles follow from the tendon
    # excursions.
    if np.linalg.matrix_rank(digit.moment_arms) == digit.joint_count:
        return "excursion"
    return "encoders" if set(digit.joint_names) <= set(hand.sensor_node.joints) else "assumed"


TEXT_BY_ANGLE_SOURCE = {
    "excursion": "measured by the tendons",
    "encoders": "measured by joint encoders",
    "assumed": "assumed, not measured",
}
"""Text that is printed for each source of joint angles."""


def angle_rows(angle_summaries: dict[str, dict[str, Any]]) -> list[tuple[str, str]]:
    """Return table rows (title, text) about the estimated joint angles: source, standard deviation and error.

    The result has one row for each digit that has an estimated standard deviation, and no row for
    other digits.
    """
    rows = []
    for name, angle in angle_summaries.items():
        if angle["sigma_deg"] != angle["sigma_deg"]:
            continue
        error = ""
        unit = angle.get("unit", "deg")
        digits = 1 if unit == "deg" else 2
        if angle["error_deg"] == angle["error_deg"]:  # a number that equals itself is not NaN
            error = f", {angle['error_deg']:.{digits}f} {unit} rms error"
        source = TEXT_BY_ANGLE_SOURCE[angle["source"]]
        text = f"{source}: sigma {angle['sigma_deg']:.{digits}f} {unit}{error}"
        rows.append((f"{name} joint {'angles' if unit == 'deg' else 'positions'}", text))
    return rows


def tracking_text(run_summary: Mapping[str, Any]) -> tuple[float, str]:
    """Return the factor and the unit with which ``tracking_rmse_rad`` is shown to a user.

    The unit is mm if all digits have only prismatic joints. If at least one digit has a hinge, the
    unit is deg. Errors of prismatic joints are then converted to angles, with 1 rad for 10 mm.
    """
    units = {angle.get("unit", "deg") for angle in run_summary["joint_angles"].values()}
    if units == {"mm"}:
        return 1000.0 * EQUIVALENT_M_PER_RAD, "mm rms"
    return math.degrees(1.0), "deg rms"


def measured_bus_load(
    log: RunLog, bitrate: int, data_bitrate: int | None, sent_lengths: Sequence[tuple[int, bool]]
) -> float:
    """Return an upper bound of the bus load in a run: the fraction of the run in which frames occupy the bus.

    Args:
        log: log of the run, which gives the duration.
        bitrate: bit rate of the bus [bit/s].
        data_bitrate: bit rate of the data phase of CAN FD [bit/s], or None for classical CAN.
        sent_lengths: for every frame in both directions, the number of payload bytes, and True if it is a
            CAN FD frame.
    """
    duration_s = float(log.times[-1] - log.times[0]) or 1.0
    return (
        sum(frame_time_s(size, fd, bitrate, data_bitrate) for size, fd in sent_lengths) / duration_s
    )
