"""Data of a tendon from a log: travel, tension and torque at the same times, and masks for the fit."""

import json
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from handctl.controller.run_setup import SETUP_ATTACHMENT_NAME
from handctl.core.tick_types import HandMode
from handctl.hand.description import Hand
from handctl.log.read.logfile import LogErrorContext
from handctl.log.read.reader import RunLog
from handctl.log.read.timeline import phase_of_each_tick
from handctl.programs.excitation import TARE_STEP_NAME

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SLACK_STEP_NAMES = (TARE_STEP_NAME,)
"""Names of the steps of an excitation in which the tendon is slack."""
STOP_STEP_NAMES = ("stretch",)
"""Names of the excitation steps in which the tendon is taut and the digit is at its open stop."""
FREE_STEP_NAMES = ("sweep",)
"""Names of the steps of an excitation in which the digit moves freely."""
CONTACT_PHASES = ("close", "open")
"""Names of the excitation steps in which a contact begins or ends.

When a contact begins or ends, the motor force can jump within one sample.
"""
IGNORED_STEP_START_S = 0.02
"""Time at the beginning of each excitation step, from which no data are used [s]."""
TRANSIENT_S = 0.35
"""Time after which a relaxed tendon is slack, because the springs have opened the digit [s]."""
STOP_DISTANCE_DEG = 2.0
"""Distance from a joint stop below which the stop can carry a fraction of the load [deg]."""
MIN_TENSION_N = 2.0
"""Tension above which a tendon counts as taut [N]."""


@dataclass(frozen=True, slots=True)
class TendonData:
    """Measurements and commands of a tendon during the excitation of its digit.

    Row j of every array belongs to the time j control periods after row 0.

    Attributes:
        tendon: name of the tendon.
        digit: name of the digit.
        period: control period [s].
        t: (n,) time on the clock of the log [s].
        travel: (n,) travel at the spool [m], with NaN for a missing value.
        tension: (n,) reading of the load cell minus the tare [N], with NaN for a missing value.
        command: (n,) motor force that is commanded from each time ``t`` on, converted to the tendon
            [N].
        joints: (n, joints) readings of the digit's joint encoders [rad], with NaN for a missing
            reading.
        slack: (n,) True if the tendon is slack, so that the load cell shows its offset.
        stop: (n,) True if the tendon is taut and the digit is at its open stop.
        free_motion_mask: (n,) True if the tendon is taut and the digit moves freely.
        torque_mask: (n,) True if the motor equation is valid between the time of the row and the
            time of the next row.
    """

    tendon: str
    digit: str
    period: float
    t: Array
    travel: Array
    tension: Array
    command: Array
    joints: Array
    slack: Mask
    stop: Mask
    free_motion_mask: Mask
    torque_mask: Mask


def tendon_data(log: RunLog, hand: Hand) -> list[TendonData]:
    """Return the data of every excited tendon.

    If the log contains no excitation, return the data of all tendons.

    The measurements that arrive in a tick were taken in the previous tick. Therefore the function
    shifts all measurements by one tick.

    Args:
        log: log of any run.
        hand: description of the hand of the run.
    """
    period = log.header.period_ns * 1e-9
    phases = phase_of_each_tick(log.phases, log.k)
    excited_digits = {
        name.partition(" ")[0]
        for name in phases
        if name.partition(" ")[2] in (*STOP_STEP_NAMES, *FREE_STEP_NAMES)
    }
    settling_ticks = round(IGNORED_STEP_START_S / period)
    transient_ticks = round(TRANSIENT_S / period)
    # After the last tick, the log contains no further measurement. Therefore every array ends one
    # tick earlier than the log.
    active = (log.mode == HandMode.ACTIVE)[:-1]
    # If a tick was missed, the equation between a command and the next measurement is not valid.
    is_consecutive = np.append(np.diff(log.k) == 1, True)[:-1]
    contact = log.field("contact")[:-1]
    gain = _logged_gain(log, len(hand.tendon))
    result = []
    for i, tendon in enumerate(hand.tendon):
        d = next(d for d, name in enumerate(hand.digit_names) if _digit_has_tendon(hand, name, i))
        digit = hand.digit_names[d]
        spool = hand.motor_of_tendon(tendon.name).spool_radius_m
        data = TendonData(
            tendon=tendon.name,
            digit=digit,
            period=period,
            t=log.times[:-1],
            travel=log.field("motor_position")[1:, i] * spool,
            tension=log.field("tension_raw")[1:, i],
            command=log.field("motor_torque_goal")[:-1, i] / spool / gain[i],
            joints=log.field("joint_encoder")[1:, hand.digit_joints[digit]],
            slack=_step_mask(phases, digit, SLACK_STEP_NAMES, transient_ticks)[:-1],
            stop=_step_mask(phases, digit, STOP_STEP_NAMES, settling_ticks)[:-1] & active,
            free_motion_mask=_step_mask(phases, digit, FREE_STEP_NAMES, settling_ticks)[:-1]
            & active,
            torque_mask=active
            & is_consecutive
            & ~_step_mask(phases, digit, CONTACT_PHASES, 0)[:-1],
        )
        if excited_digits:
            result += (
                [_restrict_to_excitation(data, phases, digit)] if digit in excited_digits else []
            )
        else:
            is_taut = (log.field("tension_goal")[:-1, i] > MIN_TENSION_N) & (
                data.tension > MIN_TENSION_N
            )
            is_taut |= bool(hand.is_pair[i])
            is_free_motion = (
                active & is_taut & (contact[:, d] < 0.5) & _free_motion_mask(log, hand, digit)[:-1]
            )
            result.append(replace(data, free_motion_mask=is_free_motion))
    return result


def _logged_gain(log: RunLog, tendons: int) -> list[float]:
    """Return the torque gains (N,) that the controller used in the logged run."""
    text = log.header.attachments.get(SETUP_ATTACHMENT_NAME, b"{}")
    with LogErrorContext(f"{SETUP_ATTACHMENT_NAME} in the log"):
        setup = json.loads(text)
        if not isinstance(setup, dict):
            raise ValueError("not a table")
        gains = setup.get("torque_gain") or [1.0] * tendons
        if len(gains) != tendons:
            raise ValueError(f"{len(gains)} torque gains of {tendons} tendons")
        return [float(gain) for gain in gains]


def _digit_has_tendon(hand: Hand, digit: str, tendon: int) -> bool:
    """Return True if a tendon belongs to a digit.

    The tendon is given by its index among the hand's tendons.
    """
    tendons = hand.digit_tendons[digit]
    return bool(tendons.start <= tendon < tendons.stop)


def _free_motion_mask(log: RunLog, hand: Hand, digit: str) -> Mask:
    """Return a mask of the ticks in which a digit moves freely.

    In the selected ticks, the digit has followed a trajectory for a minimum time, and is away from
    its stops.
    """
    joints = hand.digit_joints[digit]
    (digit_file,) = (candidate for candidate in hand.digit if candidate.name == digit)
    # Near the ends of a joint's range, the stop of the joint carries a part of the load.
    q = np.degrees(log.field("q")[:, joints])
    margin = STOP_DISTANCE_DEG
    is_inside_range = (q > np.array(digit_file.joint_min_deg) + margin) & (
        q < np.array(digit_file.joint_max_deg) - margin
    )
    moving = ~np.isnan(log.field("q_goal")[:, joints]).any(axis=1)
    return _debounced_mask(
        np.asarray(moving & is_inside_range.all(axis=1)),
        round(TRANSIENT_S * 1e9 / log.header.period_ns),
    )


def _debounced_mask(mask: Mask, tick_count: int) -> Mask:
    """Return a mask that is True where `mask` has been True for more than `tick_count` ticks."""
    # `last` is the index of the last False at or before each tick. Before the first False, its
    # value is -1.
    last_index = np.maximum.accumulate(np.where(mask, -1, np.arange(len(mask))))
    return np.asarray(np.arange(len(mask)) - last_index > tick_count)


def _step_mask(
    phase_of_tick: NDArray[np.str_], digit: str, step_names: tuple[str, ...], settling_ticks: int
) -> Mask:
    """Return a mask of the ticks in the named steps of a digit, without `settling_ticks` at the start of each step."""
    is_in_step = np.isin(phase_of_tick, [f"{digit} {step}" for step in step_names])
    settled_mask = is_in_step.copy()
    for shift in range(1, settling_ticks):
        settled_mask[shift:] &= phase_of_tick[shift:] == phase_of_tick[:-shift]
    return np.asarray(settled_mask)


def _restrict_to_excitation(
    data: TendonData, phase_of_tick: NDArray[np.str_], digit: str
) -> TendonData:
    """Return the rows of the data from the first to the last tick of the excitation of the digit."""
    ticks = np.flatnonzero(np.char.startswith(phase_of_tick[:-1], f"{digit} "))
    rows = slice(int(ticks[0]), int(ticks[-1]) + 1)
    excited_samples = {
        name: getattr(data, name)[rows]
        for name in (
            "t",
            "travel",
            "tension",
            "command",
            "joints",
            "slack",
            "stop",
            "free_motion_mask",
            "torque_mask",
        )
    }
    return replace(data, **excited_samples)


def average_samples(values: Array, half_window: int) -> Array:
    """Return moving averages: each is the mean of a sample and of `half_window` samples on each side of the sample.

    At both ends of the data, the moving average is NaN.
    """
    mean_values = np.full(len(values), np.nan)
    width = 2 * half_window + 1
    if len(values) >= width:
        mean_values[half_window:-half_window] = np.convolve(
            values, np.full(width, 1.0 / width), "valid"
        )
    return mean_values
