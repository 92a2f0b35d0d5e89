"""The tension filter: from load cell, encoder and joint encoders to tension, excursion and contact force.

All tendons are a single linear filter. ``correct_filter`` updates by the measurements, ``filterpy``
predicts all states to the present (in ``controller.tick``), and ``derive_estimate`` derives the estimate.
A missing or saturated measurement has no innovation. The covariance is then propagated until it is
steady again. A single outlier is rejected. The measurements of a tick were taken a period earlier,
just before the previous command took effect.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.core.estimation import covariance as carried
from handctl.core.estimation.statics import (
    subtract_passing_torque,
    value_from_other_tendons,
    write_static_torque,
    write_tensions_at_joints,
    write_tensions_for_torque,
)
from handctl.core.estimation.structure import motor_speed
from handctl.core.estimation.take_up import (
    is_nearly_taut,
    is_regime_over,
    regime_evidence,
    regime_evidence_without_cell,
    set_offset_of_newly_taut,
)
from handctl.hand.tendons import CAPSTAN_FRICTION_SPEED

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

STATES = 7
FREE = 0
HELD = 1
SLACK = 2
STOP_BAND_REST_M = 2e-5
"""Limit of the excursion at which a digit comes to rest on the open stop [m]."""
STOP_BAND_STAY_M = 1e-4
"""Limit of the excursion at which a digit stays on the open stop [m]."""
STOP_PULL_REST = 0.8
"""Limit of the pull at which a digit comes to rest on the open stop, as a fraction of the springs' requirement.

The fraction is so small that friction cannot hold the digit just above the stop.
"""
STOP_PULL_STAY = 1.05
"""Limit of the pull at which a digit stays on the open stop, as a fraction of the springs' requirement."""
SLACK_LENGTH_M = 2e-4
"""Slack length for a load cell showing nothing but the error [m]."""
OUTLIER_GATE = 5.0
"""Innovation above which a single load-cell sample is rejected, in standard deviations."""
STEP_GATE = 2.5
"""Innovation above which two load-cell samples in a row, on the same side, are accepted without smoothing.

In standard deviations.
"""
STEP_FRACTION = 0.8
"""Fraction of the second innovation accepted at once."""
DOUBT_S = 1.0
"""Averaging time of NIS [s]. The ideal mean is 2."""
DOUBT_ABOVE = 8.0
"""Mean NIS above which the model counts as inconsistent."""
DOUBT_BELOW = 4.0
"""Mean NIS below which the model counts as consistent again."""
NOISE_NIS_S = 0.25
"""Averaging time of NIS for adapting the noise [s]."""
NOISE_NIS_LIMIT = 3.2
"""Mean NIS above which the noise is adapted."""
ADAPTED_NOISE_S = 20.0
"""Duration of an adapted noise [s]."""
ADAPTED_NOISE_PERIOD_S = 5e-3
"""Longest control period with adapted noise [s].

At 100 Hz the faster filter passes encoder noise on to the torque: jamia11 with ODrives swung up to
234 N instead of 147, and reported a snapped tendon.
"""
NOISE_NIS_LIMIT_OF_HAND = 2.5
"""Mean over all tendons of the hand above which noise is adapted.

Wrong friction in all tendons shows sooner than in a single tendon.
"""
MAX_NIS_SAMPLE = 100.0
"""Upper limit of a NIS sample, so a single sample raises no doubt."""


@inner
def filter_kind(x: Tables, n: int) -> int:
    """Return the index of a tendon's filter design: the regime, plus 3 while the filter doubts the model."""
    regime = x.tendon_int[s.REGIME, n]
    return regime + 3 if x.tendon[s.WARY, n] > 0.0 else regime


@inner
def correct_filter(x: Tables, c: ConstantTables, missed: int) -> None:
    """Correct the filter by the measurements of a tick, and judge slack, stops and contact.

    A digit counts as held by ``PLANNED_CONTACT`` or ``BLOCKED``, see ``is_in_contact``.

    Args:
        x: state tables.
        c: constants of the hand.
        missed: ticks missed since the last tick.
    """
    count = x.tendon.shape[1]
    for n in range(count):
        # The kind may change below. The measurements are still judged by the kind of the prediction.
        x.tendon_int[s.KIND, n] = x.tendon_int[s.KIND_BEFORE, n] = filter_kind(x, n)
    z = _usable_measurements(x)
    innovation = _innovations(x, c, z)
    full = missed > 0 or x.run_int[s.CARRIED] == 1 or _is_measurement_missing(x, c, z)
    gain = np.zeros((count, STATES, 3))
    information = np.zeros((count, 3))
    cell_sigma = np.zeros(count)
    after = np.zeros((count, STATES, STATES) if full else (0, 0, 0))
    for n in range(count):
        kind = x.tendon_int[s.KIND, n]
        _write_steady_gain(c, n, kind, gain[n], information[n])
        cell_sigma[n] = c.design[n, kind, h.CELL_SIGMA_AT]
        if full:
            cell_sigma[n] = carried.correct_covariance(x, c, n, z[n], gain[n], after[n], information[n])
    _gate_and_correct(x, c, innovation, gain, cell_sigma)
    _move_slack_with_taut(x, c)
    _judge_consistency(x, c, innovation, information, full)
    force = _judge_regimes(x, c)
    _choose_filter_kinds(x)
    _write_external_tension(x, c, force)
    if full:
        carried.predict_covariances(x, c, after, missed)


@inner
def _usable_measurements(x: Tables) -> Matrix:
    """Return measurements (N, 3) of encoder, load cell and joint encoders, NaN if missing.

    A lost or saturated measurement is missing, as is the load cell of a tendon neither taut nor
    certainly slack.
    """
    z = np.empty((x.tendon.shape[1], 3))
    for n in range(len(z)):
        z[n, 0] = x.tendon[s.MEASURED_TRAVEL, n]
        z[n, 1] = x.tendon[s.MEASURED_TENSION, n]
        z[n, 2] = x.tendon[s.MEASURED_EXCURSION, n]
        if x.tendon_int[s.SATURATED, n]:
            z[n, 1] = math.nan
        if x.tendon_int[s.REGIME, n] == SLACK:
            stretch = x.tendon[s.TRAVEL, n] - x.tendon[s.EXCURSION, n] - x.tendon[s.STRETCH_OFFSET, n]
            if not (stretch < -SLACK_LENGTH_M and x.tendon_int[s.LENGTH_KNOWN, n]):
                z[n, 1] = math.nan
    return z


@inner
def _innovations(x: Tables, c: ConstantTables, z: Matrix) -> Matrix:
    """Return measurements minus expected values, (N, 3), NaN if missing."""
    innovation = np.empty_like(z)
    for n in range(len(z)):
        for m in range(3):
            expected = 0.0
            for i in range(STATES):
                expected += c.design[n, x.tendon_int[s.KIND, n], h.H_AT + STATES * m + i] * x.tendon[s.TRAVEL + i, n]
            innovation[n, m] = z[n, m] - expected
    return innovation


@inner
def _is_measurement_missing(x: Tables, c: ConstantTables, z: Matrix) -> bool:
    """Return True if a measurement assumed by the steady gains is missing. In slack no load cell is assumed."""
    for n in range(len(z)):
        assumed = x.tendon_int[s.REGIME, n] != SLACK and c.tendon_int[h.CELL_GROUP, n] >= 0
        if math.isnan(z[n, 0]) or (math.isnan(z[n, 1]) and assumed):
            return True
    return False


@inner
def _write_steady_gain(c: ConstantTables, n: int, kind: int, gain: Matrix, information: Vector) -> None:
    """Write the steady gain (7, 3) of a tendon and the inverse covariance (3,) of the innovations."""
    for i in range(STATES):
        for m in range(3):
            gain[i, m] = c.design[n, kind, h.K_AT + 3 * i + m]
    for i in range(3):
        information[i] = c.design[n, kind, h.INFORMATION_AT + i]


@inner
def _gate_and_correct(x: Tables, c: ConstantTables, innovation: Matrix, gain: Matrix, cell_sigma: Vector) -> None:
    """Correct the states. Reject a single load-cell outlier, accept two in a row.

    Args:
        x: state tables.
        c: constants of the hand.
        innovation: (N, 3), NaN if missing. Rejected innovations become NaN.
        gain: (N, 7, 3).
        cell_sigma: (N,) standard deviation of the load-cell innovation [N].
    """
    for n in range(len(innovation)):
        cell = innovation[n, 1]
        surprise = 0.0 if math.isnan(cell) else cell / cell_sigma[n]
        before = x.tendon[s.SURPRISE, n]
        again = abs(surprise) > STEP_GATE and before * surprise > 0.0 and abs(before) > STEP_GATE
        jump = 0.0
        if again and x.tendon_int[s.REGIME, n] != SLACK:
            steady = 0.0
            kind = x.tendon_int[s.KIND, n]
            for i in range(STATES):
                steady += c.design[n, kind, h.TENSION_AT + i] * c.design[n, kind, h.K_AT + 3 * i + 1]
            # The steady gain follows below. Only the rest of the accepted fraction is added here.
            jump = max(STEP_FRACTION - steady, 0.0) * cell
        if abs(surprise) > OUTLIER_GATE and not again:
            innovation[n, 1] = math.nan
        x.tendon[s.SURPRISE, n] = surprise
        for i in range(STATES):
            for m in range(3):
                if not math.isnan(innovation[n, m]):
                    x.tendon[s.TRAVEL + i, n] += gain[n, i, m] * innovation[n, m]
        # More tension is a shorter excursion at the same travel.
        x.tendon[s.EXCURSION, n] -= jump / c.tendon[h.STIFFNESS, n]


@inner
def _move_slack_with_taut(x: Tables, c: ConstantTables) -> None:
    """Move the excursions of slack tendons with the taut tendons of the same digit, for tendons in surplus.

    The excursions of a digit are R q. With one slack tendon the equation for it is exact. With
    several, the ticks are the iterations of a Gauss-Seidel solution.
    """
    for n in range(x.tendon.shape[1]):
        if c.tendon_int[h.REDUNDANT, n] and x.tendon_int[s.REGIME, n] == SLACK:
            excursion = value_from_other_tendons(c, n, x.tendon[s.EXCURSION], c.tendon[h.EXPLAINED_OFFSET, n])
            rate = value_from_other_tendons(c, n, x.tendon[s.EXCURSION_RATE], 0.0)
            if not math.isnan(excursion):
                x.tendon[s.EXCURSION, n] = excursion
                x.tendon[s.EXCURSION_RATE, n] = rate


@inner
def _normalised_innovation_squared(innovation: Vector, information: Vector, blind: bool) -> float:
    """Return the normalised innovation squared of encoder and load cell, NaN if either is missing.

    Without load cell (``blind``) it is twice that of the encoder, so that 2 is right as well.
    """
    if blind:
        return 2.0 * information[0] * innovation[0] * innovation[0]
    encoder = innovation[0]
    cell = innovation[1]
    return (information[0] * encoder + information[1] * cell) * encoder + information[2] * (cell * cell)


@inner
def _judge_consistency(x: Tables, c: ConstantTables, innovation: Matrix, information: Matrix, full: bool) -> None:
    """Average NIS, and judge the consistency of the model.

    There are two averages. The slow average informs the operator. The fast average adapts the
    filter's noise. It assumes the model without doubt, so added noise does not hide the cause.
    """
    nominal = np.empty(3)
    for n in range(len(innovation)):
        blind = c.tendon_int[h.CELL_GROUP, n] < 0
        nis = _normalised_innovation_squared(innovation[n], information[n], blind)
        x.tendon[s.NIS, n] = nis
        x.tendon[s.INNOVATION, n] = innovation[n, 1]
        kind = x.tendon_int[s.KIND, n]
        if kind >= 3 and not full:
            for i in range(3):
                nominal[i] = c.design[n, kind - 3, h.INFORMATION_AT + i]
            nis = _normalised_innovation_squared(innovation[n], nominal, blind)
        if math.isnan(nis):
            continue
        nis = min(nis, MAX_NIS_SAMPLE)
        period = c.run[h.PERIOD]
        # First-order low-pass. The period is short against the averaging time.
        x.tendon[s.NIS_MEAN, n] += period / DOUBT_S * (nis - x.tendon[s.NIS_MEAN, n])
        if period <= ADAPTED_NOISE_PERIOD_S:
            x.tendon[s.NIS_FAST, n] += period / NOISE_NIS_S * (nis - x.tendon[s.NIS_FAST, n])
    for n in range(len(innovation)):
        limit = DOUBT_BELOW if x.tendon_int[s.DOUBTFUL, n] else DOUBT_ABOVE
        doubtful = x.tendon[s.NIS_MEAN, n] > limit
        if doubtful != x.tendon_int[s.DOUBTFUL, n]:
            x.run_int[s.CHANGED] = 1
        x.tendon_int[s.DOUBTFUL, n] = doubtful
    _judge_noise(x, c)


@inner
def _judge_noise(x: Tables, c: ConstantTables) -> None:
    """Decide by the last innovations which tendons need more process noise.

    The doubt outlasts the cause: wrong friction is visible only during motion, and has most effect
    at the next reversal.
    """
    if c.run[h.PERIOD] > ADAPTED_NOISE_PERIOD_S:
        return
    total = 0.0
    count = x.tendon.shape[1]
    for n in range(count):
        total += x.tendon[s.NIS_FAST, n]
    limit = NOISE_NIS_LIMIT if total < NOISE_NIS_LIMIT_OF_HAND * count else 0.0
    for n in range(count):
        left = max(x.tendon[s.WARY, n] - c.run[h.PERIOD], 0.0)
        x.tendon[s.WARY, n] = ADAPTED_NOISE_S if x.tendon[s.NIS_FAST, n] > limit else left


@inner
def filtered_tension(x: Tables, c: ConstantTables, n: int) -> float:
    """Return the tension at the load cell by the state of the filter [N]. It may be negative."""
    tension = 0.0
    kind = x.tendon_int[s.KIND, n]
    for i in range(STATES):
        tension += c.design[n, kind, h.TENSION_AT + i] * x.tendon[s.TRAVEL + i, n]
    return tension


@inner
def write_free_angles(x: Tables, c: ConstantTables, row: int, result: Vector) -> None:
    """Write the joint angles (or rates) (J,) of excursions (or their rates) in a row, q = B R_r^+ s.

    With varying moment arms this is the linear relation of ``structure``, which has an offset.
    """
    for j in range(len(result)):
        result[j] = c.joint[h.ANGLE_OFFSET, j] if row == s.EXCURSION else 0.0
        for n in range(x.tendon.shape[1]):
            result[j] += c.joint_tendon[h.EXCURSION_TO_JOINTS, j, n] * x.tendon[row, n]


@inner
def _load_forces(x: Tables, c: ConstantTables) -> Matrix:
    """Return resistance, speed-signed pull and pull of all tendons, (3, N) [N].

    Resistance is the tension in balance with springs and gravity. Without better knowledge,
    friction has the direction of the tendon's speed at the spool. The digit's own speed, of a light
    mass on a spring, is estimated too roughly: the sign would chatter. The speed-signed pull always
    uses the speed at the spool, and is the first sign of a digit leaving a stop.
    """
    count = x.tendon.shape[1]
    joints = x.joint.shape[1]
    force = np.zeros((3, count))
    q = np.zeros(joints)
    torque = np.zeros(joints)
    write_free_angles(x, c, s.EXCURSION, q)
    write_static_torque(c, q, torque)
    tension = np.empty(count)
    quick = np.empty(count)
    developed = np.empty(count)
    better = False
    for n in range(count):
        tension[n] = filtered_tension(x, c, n)
        quick[n] = math.tanh(motor_speed(x, c, n) / CAPSTAN_FRICTION_SPEED)
        friction_state = x.tendon[s.FRICTION_STATE, n]
        developed[n] = quick[n] if math.isnan(friction_state) else friction_state
        better |= developed[n] != quick[n]
    subtract_passing_torque(c, q, tension, developed if better else quick, torque)
    write_tensions_for_torque(c, torque, force[0])
    write_tensions_at_joints(c, q, tension, quick, force[1])
    write_tensions_at_joints(c, q, tension, developed if better else quick, force[2])
    return force


@inner
def _judge_regimes(x: Tables, c: ConstantTables) -> Matrix:
    """Judge slack, stops and contact, and set the offset of a newly taut tendon. Return the new ``_load_forces``."""
    force = _load_forces(x, c)
    changed = False
    for n in range(x.tendon.shape[1]):
        regime = x.tendon_int[s.REGIME, n]
        cell = x.tendon[s.MEASURED_TENSION, n]
        # Only in slack: then the encoder alone tells how much tendon is left to wind in.
        near = regime == SLACK and x.tendon_int[s.LENGTH_KNOWN, n] == 1 and is_nearly_taut(x, n)
        blind = c.tendon_int[h.CELL_GROUP, n] < 0
        points = x.tendon_int[s.TURNING, n]
        tension = filtered_tension(x, c, n)
        if blind:
            # The force that a slack tendon's motor lacks is the tension of a tendon that has become taut.
            cell = -x.tendon[s.DISTURBANCE, n]
            points = regime_evidence_without_cell(regime, points, tension, cell)
        else:
            points = regime_evidence(regime, points, tension, cell, x.tendon[s.CELL_ERROR, n], near)
        if c.tendon_int[h.PAIR, n]:
            # The spool turns the joint both ways. One of the two tendons is always taut.
            points = 0
            regime = FREE
        elif is_regime_over(regime, points, blind):
            points = 0
            if regime == SLACK:
                set_offset_of_newly_taut(x, c, n, cell)
                x.tendon_int[s.LENGTH_KNOWN, n] = 1
            regime = FREE if regime == SLACK else SLACK
        x.tendon_int[s.TURNING, n] = points
        was = x.tendon_int[s.STOPPED, n] == 1
        stopped = c.tendon_int[h.SPRUNG, n] == 1
        if stopped:
            # The pull of a tendon that opens its digit has the sign of its excursion, minus.
            side = c.tendon[h.SIDE, n]
            opened = c.tendon[h.OPEN_EXCURSION, n]
            stopped = _is_at_stop(
                was, side * (x.tendon[s.EXCURSION, n] - opened), side * force[1, n], side * force[0, n]
            )
        x.tendon_int[s.STOPPED, n] = stopped
        if regime != SLACK:
            if stopped and not was:
                # It has come to rest on its open stop: its excursion is known, the rest was offset.
                opened = c.tendon[h.OPEN_EXCURSION, n]
                x.tendon[s.STRETCH_OFFSET, n] += x.tendon[s.EXCURSION, n] - opened
                x.tendon[s.EXCURSION, n] = opened
                x.tendon[s.EXCURSION_RATE, n] = 0.0
                changed = True
            regime = HELD if stopped or is_in_contact(x, c.tendon_int[h.DIGIT, n]) else FREE
        changed |= regime != x.tendon_int[s.REGIME, n]
        x.tendon_int[s.REGIME, n] = regime
    if changed:
        for n in range(x.tendon.shape[1]):
            x.tendon_int[s.KIND, n] = filter_kind(x, n)
        force = _load_forces(x, c)
    return force


@inner
def is_in_contact(x: Tables, d: int) -> bool:
    """Return True if a digit is in contact: by the program under torque, or blocked."""
    acting = 3 <= x.run_int[s.MODE] <= 5  # ARMING, ACTIVE, RELAX
    return (acting and x.digit_int[s.PLANNED_CONTACT, d] == 1) or x.digit_int[s.BLOCKED, d] == 1


@inner
def _is_at_stop(was: bool, excursion: float, force: float, resistance: float) -> bool:
    """Return True if springs hold the digit on the open stop against the tendon."""
    if was:
        return excursion < STOP_BAND_STAY_M and force < resistance * STOP_PULL_STAY
    return excursion < STOP_BAND_REST_M and force < resistance * STOP_PULL_REST


@inner
def _choose_filter_kinds(x: Tables) -> None:
    """Choose the design blocks for the prediction, by the judged regimes and doubts."""
    for n in range(x.tendon.shape[1]):
        x.tendon_int[s.KIND, n] = filter_kind(x, n)


@inner
def _write_external_tension(x: Tables, c: ConstantTables, force: Matrix) -> None:
    """Write the load force beyond the model, positive against closing, 0 in slack and on the open stop."""
    for n in range(x.tendon.shape[1]):
        x.tendon[s.EXTERNAL, n] = 0.0
        if x.tendon_int[s.REGIME, n] != SLACK and not x.tendon_int[s.STOPPED, n]:
            damping = c.tendon[h.LOAD_DAMPING, n] * x.tendon[s.EXCURSION_RATE, n]
            # Sign: pull of the tendon minus requirement. An object that resists closing makes it positive.
            x.tendon[s.EXTERNAL, n] = force[2, n] - force[0, n] - damping


@inner
def write_unknown_estimate(x: Tables) -> None:
    """Write an estimate without information, for the ticks before all sensors were read."""
    for n in range(x.tendon.shape[1]):
        x.tendon[s.EXTERNAL, n] = 0.0
        x.tendon[s.INNOVATION, n] = x.tendon[s.NIS, n] = math.nan
        x.tendon_int[s.KIND, n] = filter_kind(x, n)


@inner
def derive_estimate(x: Tables, c: ConstantTables) -> None:
    """Derive the estimate from the predicted states: tensions, standard deviations, angles of free digits."""
    for n in range(x.tendon.shape[1]):
        tension = filtered_tension(x, c, n)
        # A single tendon cannot push.
        x.tendon[s.TENSION, n] = tension if c.tendon_int[h.PAIR, n] else max(tension, 0.0)
        x.tendon[s.SIGMA, n] = math.sqrt(c.design[n, x.tendon_int[s.KIND, n], h.VARIANCE_AT])
        if x.run_int[s.CARRIED]:
            x.tendon[s.SIGMA, n] = carried.predicted_tension_sigma(x, c, n)
    write_free_angles(x, c, s.EXCURSION, x.joint[s.Q])
    write_free_angles(x, c, s.EXCURSION_RATE, x.joint[s.DQ])
