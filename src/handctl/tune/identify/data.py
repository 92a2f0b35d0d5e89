"""What a log tells of one tendon: travel, tension and torque at the same instants, and what each is good for."""

import json
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from handctl.controller.setup import ATTACHMENT
from handctl.core.types import Mode
from handctl.hand.description import Hand
from handctl.log.read.logfile import Reading
from handctl.log.read.moments import phase_of_each
from handctl.log.read.reader import RunLog

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TARES = ("tare",)
ON_STOP = ("stretch",)
FREE = ("sweep",)
UNSURE = ("close", "open")
"""Steps in which something is met or left: the motor's force may jump within a sample."""
SETTLE_S = 0.02
LATE_S = 0.35
"""Time at the beginning of a step in which the digit still falls open, or the rope becomes slack."""
STOP_DEG = 2.0
"""Angle from a stop within which nobody knows what the stop bears."""
LEAST_TENSION_N = 2.0
"""Mean tension of a stretch of a log that counts as taut."""


@dataclass(frozen=True, slots=True)
class TendonData:
    """One tendon during the time of its digit; row j of every array belongs to the instant t = j periods.

    Attributes:
        tendon: name.
        digit: name.
        period: [s].
        t: (n,) [s] on the log's clock.
        travel: (n,) cable travel at the spool [m]; NaN where it was not read.
        tension: (n,) load cell, tared [N]; NaN where it was not read.
        command: (n,) motor force at the cable that the drive was told from this instant on [N].
        joints: (n, joints) joint encoders of the digit [rad]; NaN where they were not read.
        limp: rope slack: the load cell shows its offset.
        stop: taut, on the open stop.
        free: taut, moving with nothing in the way.
        acting: the motor equation holds.
    """

    tendon: str
    digit: str
    period: float
    t: Array
    travel: Array
    tension: Array
    command: Array
    joints: Array
    limp: Mask
    stop: Mask
    free: Mask
    acting: Mask


def tendon_data(log: RunLog, hand: Hand) -> list[TendonData]:
    """Data of every tendon that was excited, or of all tendons if the log is not one of an excitation.

    A tick's measurements were taken at the instant of the tick before, so they are moved there.

    Args:
        log: of any run.
        hand: that ran.
    """
    period = log.header.period_ns * 1e-9
    phases = phase_of_each(log.phases, log.k)
    excited = {name.partition(" ")[0] for name in phases if name.partition(" ")[2] in (*ON_STOP, *FREE)}
    settle, late = round(SETTLE_S / period), round(LATE_S / period)
    active = (log.mode == Mode.ACTIVE)[:-1]
    whole = np.append(np.diff(log.k) == 1, True)[:-1]
    contact = log.field("contact")[:-1]
    gain = _logged_gain(log, len(hand.tendon))
    found = []
    for i, tendon in enumerate(hand.tendon):
        d = next(d for d, name in enumerate(hand.digit_names) if _has(hand, name, i))
        digit, spool = hand.digit_names[d], hand.motor_of(tendon.name).spool_radius_m
        data = TendonData(
            tendon=tendon.name,
            digit=digit,
            period=period,
            t=log.times[:-1],
            travel=log.field("motor_position")[1:, i] * spool,
            tension=log.field("tension_raw")[1:, i],
            command=log.field("motor_torque_goal")[:-1, i] / spool / gain[i],
            joints=log.field("joint_encoder")[1:, hand.digit_joints[digit]],
            limp=_during(phases, digit, TARES, late)[:-1],
            stop=_during(phases, digit, ON_STOP, settle)[:-1] & active,
            free=_during(phases, digit, FREE, settle)[:-1] & active,
            acting=active & whole & ~_during(phases, digit, UNSURE, 0)[:-1],
        )
        if excited:
            found += [_cut(data, phases, digit)] if digit in excited else []
        else:
            taut = (log.field("tension_goal")[:-1, i] > LEAST_TENSION_N) & (data.tension > LEAST_TENSION_N)
            free = active & taut & (contact[:, d] < 0.5) & _unheld(log, hand, digit)[:-1]
            found.append(replace(data, free=free))
    return found


def _logged_gain(log: RunLog, tendons: int) -> list[float]:
    """(N,) torque gain that the run's controller already made up for."""
    text = log.header.attachments.get(ATTACHMENT, b"{}")
    with Reading(f"{ATTACHMENT} in the log"):
        setup = json.loads(text)
        if not isinstance(setup, dict):
            raise ValueError("not a table")
        known = setup.get("torque_gain") or [1.0] * tendons
        if len(known) != tendons:
            raise ValueError(f"{len(known)} torque gains of {tendons} tendons")
        return [float(gain) for gain in known]


def _has(hand: Hand, digit: str, tendon: int) -> bool:
    place = hand.digit_tendons[digit]
    return bool(place.start <= tendon < place.stop)


def _unheld(log: RunLog, hand: Hand, digit: str) -> Mask:
    """Ticks in which a digit follows a trajectory, away from the stops, and has done so for a while."""
    joints = hand.digit_joints[digit]
    (part,) = (one for one in hand.digit if one.name == digit)
    q, margin = np.degrees(log.field("q")[:, joints]), STOP_DEG
    inside = (q > np.array(part.joint_min_deg) + margin) & (q < np.array(part.joint_max_deg) - margin)
    moving = ~np.isnan(log.field("q_goal")[:, joints]).any(axis=1)
    return _lasting(np.asarray(moving & inside.all(axis=1)), round(LATE_S * 1e9 / log.header.period_ns))


def _lasting(mask: Mask, late: int) -> Mask:
    """Where a mask has held for more than ``late`` ticks."""
    last = np.maximum.accumulate(np.where(mask, -1, np.arange(len(mask))))
    return np.asarray(np.arange(len(mask)) - last > late)


def _during(phases: NDArray[np.str_], digit: str, steps: tuple[str, ...], settle: int) -> Mask:
    """Ticks of some steps of a digit, each without its first ``settle`` ticks."""
    inside = np.isin(phases, [f"{digit} {step}" for step in steps])
    settled = inside.copy()
    for shift in range(1, settle):
        settled[shift:] &= phases[shift:] == phases[:-shift]
    return np.asarray(settled)


def _cut(data: TendonData, phases: NDArray[np.str_], digit: str) -> TendonData:
    """Only the time in which the digit was excited."""
    own = np.flatnonzero(np.char.startswith(phases[:-1], f"{digit} "))
    place = slice(int(own[0]), int(own[-1]) + 1)
    parts = {
        name: getattr(data, name)[place]
        for name in ("t", "travel", "tension", "command", "joints", "limp", "stop", "free", "acting")
    }
    return replace(data, **parts)
