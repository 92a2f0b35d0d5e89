"""Tension filter, which estimates tension, excursion and contact force of each tendon.

The measurements come from load cells, motor encoders and joint encoders. One linear Kalman filter
contains the states of all tendons. ``correct_tension_filter`` corrects the states of the filter by
the measurements. The package ``filterpy``, called in ``controller.tick``, predicts the states to
the present time. ``derive_estimate`` computes the estimate from the states of the filter. A missing
or saturated measurement has no innovation. After a missing or saturated measurement, the covariance
of the states is propagated until it is steady. A single outlier of a load cell is rejected. The
measurements that arrive in a tick are one control period old, because they were taken just before
the command of the previous tick took effect.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.estimation import filter_covariance
from handctl.core.estimation.filter_types import (
    FREE_REGIME,
    HELD_REGIME,
    SLACK_REGIME,
    STATE_COUNT,
)
from handctl.core.estimation.slack_detection import (
    is_nearly_taut,
    is_regime_over,
    regime_evidence,
    regime_evidence_without_cell,
    set_offset_of_newly_taut_tendon,
)
from handctl.core.estimation.statics import (
    subtract_torque_of_passing_tendons,
    value_from_other_tendons,
    write_static_torque,
    write_tensions_at_joints,
    write_tensions_for_torque,
)
from handctl.core.estimation.varying_moment_arms import motor_speed
from handctl.core.state_block import StateTables
from handctl.core.tick_types import ARMING_MODE, RELAX_MODE
from handctl.hand.tendons import CAPSTAN_FRICTION_SPEED_M_S

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

MAX_STOP_DISTANCE_TO_COME_TO_REST_M = 2e-5
"""Distance of the excursion from the stop of the open digit below which an arriving digit counts as at rest [m]."""
MAX_STOP_DISTANCE_TO_STAY_AT_REST_M = 1e-4
"""Distance of the excursion from the stop of the open digit up to which a digit at rest stays at rest [m]."""
MAX_PULL_TO_COME_TO_REST = 0.8
"""Pull of a tendon below which its digit comes to rest on the stop of the open digit, relative to the springs' force.

The fraction is so small that friction cannot hold the digit just above the stop.
"""
MAX_PULL_TO_STAY_AT_REST = 1.05
"""Pull of a tendon below which its digit stays on the stop of the open digit, relative to the springs' force."""
SLACK_LENGTH_M = 2e-4
"""Length of slack above which a load cell certainly measures no tension, but only its error [m]."""
OUTLIER_GATE_SIGMAS = 5.0
"""Innovation above which a single load-cell sample is rejected, in standard deviations of the innovation."""
STEP_GATE_SIGMAS = 2.5
"""Innovation above which two load-cell samples in a row count as a step of the tension, in standard deviations.

The innovations of both load-cell samples must have the same sign.
"""
TENSION_STEP_CORRECTION_FRACTION = 0.8
"""Fraction of the second innovation of a tension step that is added to the tension at once."""
NIS_AVERAGING_TIME_S = 1.0
"""Averaging time of the normalised innovation squared (NIS) by which the model of a tendon is judged [s].

The ideal mean of NIS is 2.
"""
MIN_INCONSISTENT_NIS = 8.0
"""Mean normalised innovation squared (NIS) of a tendon above which the model of the tendon counts as inconsistent."""
MAX_CONSISTENT_NIS = 4.0
"""Mean normalised innovation squared (NIS) of a tendon below which the model counts as consistent again."""
NOISE_NIS_AVERAGING_TIME_S = 0.25
"""Averaging time of the NIS that decides about added process noise [s]."""
NOISE_NIS_LIMIT = 3.2
"""Mean NIS of a tendon above which process noise is added to its filter."""
MAX_ADDED_NOISE_S = 20.0
"""Time for which added process noise is kept after the mean NIS has fallen below its limit [s]."""
ADDED_NOISE_MAX_PERIOD_S = 5e-3
"""Longest control period at which process noise is added [s].

At 100 Hz, a filter with added process noise passes encoder noise on to the torque. With added
process noise, the tensions of the hand jamia11 with ODrives oscillated up to 234 N instead of 147
N, and the controller reported a tendon as snapped.
"""
NOISE_NIS_LIMIT_OF_HAND = 2.5
"""Mean NIS over all tendons of the hand above which process noise is added to all tendons.

If the friction of all tendons differs from the hand file, the mean over all tendons shows the
difference sooner than the NIS of a single tendon.
"""
MAX_NIS_SAMPLE = 100.0
"""Upper limit of each NIS sample, so that a single sample does not make the model of a tendon inconsistent."""


@kernel_helper
def filter_kind(x: StateTables, n: int) -> int:
    """Return the index of a tendon's filter design.

    Without added process noise, the index is the value of the tendon's regime. While the tendon's
    filter has added process noise, the index is the value of the regime plus 3.
    """
    regime = x.tendon_int[s.REGIME, n]
    return regime + 3 if x.tendon[s.ADDED_NOISE_TIME_S, n] > 0.0 else regime


@kernel_helper
def correct_tension_filter(x: StateTables, c: ConstantTables, missed_ticks: int) -> None:
    """Correct the filter by the measurements of a tick, and judge the regime of each tendon.

    The regime depends on three conditions: the tendon is slack, the digit is on its open stop, or
    the digit is in contact. A taut tendon is in the regime ``HELD`` if its digit is in planned
    contact or blocked (see ``is_in_contact``), or on its open stop.

    Args:
        x: state tables.
        c: constants of the hand.
        missed_ticks: ticks missed since the last tick.
    """
    count = x.tendon.shape[1]
    for n in range(count):
        # The kind of filter design can change in the code below, but the measurements are judged by
        # the kind of design that predicted them.
        x.tendon_int[s.FILTER_KIND, n] = x.tendon_int[s.LAST_FILTER_KIND, n] = filter_kind(x, n)
    z = _usable_measurements(x)
    innovation = _innovations(x, c, z)
    propagates_covariance = (
        missed_ticks > 0
        or x.run_int[s.COVARIANCE_PROPAGATED] == 1
        or _is_measurement_missing(x, c, z)
    )
    gain = np.zeros((count, STATE_COUNT, 3))
    information = np.zeros((count, 3))
    cell_sigma = np.zeros(count)
    covariances_after = np.zeros(
        (count, STATE_COUNT, STATE_COUNT) if propagates_covariance else (0, 0, 0)
    )
    for n in range(count):
        kind = x.tendon_int[s.FILTER_KIND, n]
        _write_steady_gain(c, n, kind, gain[n], information[n])
        cell_sigma[n] = c.design[n, kind, h.CELL_SIGMA_OFFSET]
        if propagates_covariance:
            cell_sigma[n] = filter_covariance.correct_tendon_covariance(
                x, c, n, z[n], gain[n], covariances_after[n], information[n]
            )
    _gate_and_correct_states(x, c, innovation, gain, cell_sigma)
    _correct_slack_by_taut_tendons(x, c)
    _update_consistency(x, c, innovation, information, propagates_covariance)
    force = _update_regimes(x, c)
    _choose_filter_kinds(x)
    _write_external_tension(x, c, force)
    if propagates_covariance:
        filter_covariance.predict_covariances(x, c, covariances_after, missed_ticks)


@kernel_helper
def _usable_measurements(x: StateTables) -> Matrix:
    """Return the usable measurements (N, 3) of motor encoder, load cell and joint encoders.

    Missing measurements are NaN.

    A lost or saturated measurement counts as missing. The load-cell reading of a slack tendon
    normally counts as missing. The reading is used only if the tendon length is known, and the
    spool must still wind up more than ``SLACK_LENGTH_M``.
    """
    z = np.empty((x.tendon.shape[1], 3))
    for n in range(len(z)):
        z[n, 0] = x.tendon[s.MEASURED_TRAVEL, n]
        z[n, 1] = x.tendon[s.MEASURED_TENSION, n]
        z[n, 2] = x.tendon[s.MEASURED_EXCURSION, n]
        if x.tendon_int[s.IS_CELL_SATURATED, n]:
            z[n, 1] = math.nan
        if x.tendon_int[s.REGIME, n] == SLACK_REGIME:
            stretch = (
                x.tendon[s.SPOOL_TRAVEL, n]
                - x.tendon[s.EXCURSION, n]
                - x.tendon[s.STRETCH_OFFSET, n]
            )
            if not (stretch < -SLACK_LENGTH_M and x.tendon_int[s.TENDON_LENGTH_KNOWN, n]):
                z[n, 1] = math.nan
    return z


@kernel_helper
def _innovations(x: StateTables, c: ConstantTables, z: Matrix) -> Matrix:
    """Return the measurements minus their expected values, (N, 3).

    The innovation of a missing measurement is NaN.
    """
    innovation = np.empty_like(z)
    for n in range(len(z)):
        for m in range(3):
            expected = 0.0
            for i in range(STATE_COUNT):
                expected += (
                    c.design[
                        n,
                        x.tendon_int[s.FILTER_KIND, n],
                        h.MEASUREMENT_MATRIX_OFFSET + STATE_COUNT * m + i,
                    ]
                    * x.tendon[s.SPOOL_TRAVEL + i, n]
                )
            innovation[n, m] = z[n, m] - expected
    return innovation


@kernel_helper
def _is_measurement_missing(x: StateTables, c: ConstantTables, z: Matrix) -> bool:
    """Return True if the constant gains of the filter are invalid because of a missing measurement.

    For a slack tendon, the constant gains need no load-cell reading.
    """
    for n in range(len(z)):
        is_assumed_zero = (
            x.tendon_int[s.REGIME, n] != SLACK_REGIME and c.tendon_int[h.CELL_GROUP, n] >= 0
        )
        if math.isnan(z[n, 0]) or (math.isnan(z[n, 1]) and is_assumed_zero):
            return True
    return False


@kernel_helper
def _write_steady_gain(
    c: ConstantTables, n: int, design_kind: int, gain: Matrix, information: Vector
) -> None:
    """Write the constant gain (7, 3) of a tendon's filter, and three numbers of the inverse innovation covariance."""
    for i in range(STATE_COUNT):
        for m in range(3):
            gain[i, m] = c.design[n, design_kind, h.KALMAN_GAIN_OFFSET + 3 * i + m]
    for i in range(3):
        information[i] = c.design[n, design_kind, h.INFORMATION_OFFSET + i]


@kernel_helper
def _gate_and_correct_states(
    x: StateTables, c: ConstantTables, innovations: Matrix, gain: Matrix, cell_sigma: Vector
) -> None:
    """Correct the states of the filter by the innovations.

    A single outlier of a load cell is rejected, but two outliers in a row are accepted.

    Args:
        x: state tables.
        c: constants of the hand.
        innovations: (N, 3) innovations. The innovation of a missing measurement is NaN. Rejected
            innovations become NaN.
        gain: (N, 7, 3) gains.
        cell_sigma: (N,) standard deviation of the innovation of each load cell [N].
    """
    for n in range(len(innovations)):
        cell = innovations[n, 1]
        sigmas = 0.0 if math.isnan(cell) else cell / cell_sigma[n]
        last_innovation = x.tendon[s.CELL_INNOVATION_SIGMAS, n]
        is_repeated = (
            abs(sigmas) > STEP_GATE_SIGMAS
            and last_innovation * sigmas > 0.0
            and abs(last_innovation) > STEP_GATE_SIGMAS
        )
        tension_jump = 0.0
        if is_repeated and x.tendon_int[s.REGIME, n] != SLACK_REGIME:
            steady_correction = 0.0
            kind = x.tendon_int[s.FILTER_KIND, n]
            for i in range(STATE_COUNT):
                steady_correction += (
                    c.design[n, kind, h.TENSION_ROW_OFFSET + i]
                    * c.design[n, kind, h.KALMAN_GAIN_OFFSET + 3 * i + 1]
                )
            # The code below adds the correction by the gain, so only the rest of TENSION_STEP_CORRECTION_FRACTION is
            # applied here.
            tension_jump = max(TENSION_STEP_CORRECTION_FRACTION - steady_correction, 0.0) * cell
        if abs(sigmas) > OUTLIER_GATE_SIGMAS and not is_repeated:
            innovations[n, 1] = math.nan
        x.tendon[s.CELL_INNOVATION_SIGMAS, n] = sigmas
        for i in range(STATE_COUNT):
            for m in range(3):
                if not math.isnan(innovations[n, m]):
                    x.tendon[s.SPOOL_TRAVEL + i, n] += gain[n, i, m] * innovations[n, m]
        # At the same travel, more tension means more stretch of the tendon, and therefore less
        # excursion.
        x.tendon[s.EXCURSION, n] -= tension_jump / c.tendon[h.TENDON_STIFFNESS, n]


@kernel_helper
def _correct_slack_by_taut_tendons(x: StateTables, c: ConstantTables) -> None:
    """Compute the excursion of slack tendons from the other tendons, in digits with more tendons than coordinates.

    The excursions of a digit are the product R q of its moment arms and joint angles. If only one
    tendon of a digit is slack, the excursions of the other tendons determine the excursion of the
    slack tendon. If several tendons of a digit are slack, each tick is one step of an iterative
    (Gauss-Seidel) solution.
    """
    for n in range(x.tendon.shape[1]):
        if c.tendon_int[h.IS_REDUNDANT_DIGIT, n] and x.tendon_int[s.REGIME, n] == SLACK_REGIME:
            excursion = value_from_other_tendons(
                c, n, x.tendon[s.EXCURSION], c.tendon[h.EXCURSION_MODEL_OFFSET, n]
            )
            rate = value_from_other_tendons(c, n, x.tendon[s.EXCURSION_RATE], 0.0)
            if not math.isnan(excursion):
                x.tendon[s.EXCURSION, n] = excursion
                x.tendon[s.EXCURSION_RATE, n] = rate


@kernel_helper
def _normalised_innovation_squared(
    innovation: Vector, information: Vector, has_no_cell: bool
) -> float:
    """Return the normalised innovation squared (NIS) of encoder and load cell.

    Return NaN if the encoder or the load-cell measurement is missing.

    For a tendon without a load cell (``has_no_cell``), the result is twice the NIS of the encoder
    alone. With and without a load cell, the result has a mean of 2 if the model is correct.
    """
    if has_no_cell:
        return 2.0 * information[0] * innovation[0] * innovation[0]
    encoder = innovation[0]
    cell = innovation[1]
    return (information[0] * encoder + information[1] * cell) * encoder + information[2] * (
        cell * cell
    )


@kernel_helper
def _update_consistency(
    x: StateTables,
    c: ConstantTables,
    innovations: Matrix,
    information: Matrix,
    propagates_covariance: bool,
) -> None:
    """Average the normalised innovations squared (NIS), and judge if each tendon's model is consistent.

    The NIS is averaged over a long and over a short time. The long average of the NIS decides when
    the controller informs the operator. The short average of the NIS decides when process noise is
    added. The short average uses the covariance without added noise, because added noise would hide
    an error of the model.
    """
    nominal = np.empty(3)
    for n in range(len(innovations)):
        has_no_cell = c.tendon_int[h.CELL_GROUP, n] < 0
        nis = _normalised_innovation_squared(innovations[n], information[n], has_no_cell)
        x.tendon[s.NIS, n] = nis
        x.tendon[s.INNOVATION, n] = innovations[n, 1]
        kind = x.tendon_int[s.FILTER_KIND, n]
        if kind >= 3 and not propagates_covariance:
            for i in range(3):
                nominal[i] = c.design[n, kind - 3, h.INFORMATION_OFFSET + i]
            nis = _normalised_innovation_squared(innovations[n], nominal, has_no_cell)
        if math.isnan(nis):
            continue
        nis = min(nis, MAX_NIS_SAMPLE)
        period = c.run[h.CONTROL_PERIOD]
        # The averages are first-order low-pass filters. The control period is short compared with
        # the averaging times.
        x.tendon[s.NIS_MEAN, n] += period / NIS_AVERAGING_TIME_S * (nis - x.tendon[s.NIS_MEAN, n])
        if period <= ADDED_NOISE_MAX_PERIOD_S:
            x.tendon[s.RECENT_NIS_MEAN, n] += (
                period / NOISE_NIS_AVERAGING_TIME_S * (nis - x.tendon[s.RECENT_NIS_MEAN, n])
            )
    for n in range(len(innovations)):
        limit = (
            MAX_CONSISTENT_NIS if x.tendon_int[s.MODEL_INCONSISTENT, n] else MIN_INCONSISTENT_NIS
        )
        is_inconsistent = x.tendon[s.NIS_MEAN, n] > limit
        if is_inconsistent != x.tendon_int[s.MODEL_INCONSISTENT, n]:
            x.run_int[s.CONSISTENCY_CHANGED] = 1
        x.tendon_int[s.MODEL_INCONSISTENT, n] = is_inconsistent
    _judge_noise(x, c)


@kernel_helper
def _judge_noise(x: StateTables, c: ConstantTables) -> None:
    """Use the short average of the NIS to select the tendons whose filters get added process noise.

    The added noise is kept for ``MAX_ADDED_NOISE_S``. If the model has a wrong friction, the
    innovations show the error only while the tendon moves. A wrong friction has the largest effect
    when the motion reverses.
    """
    if c.run[h.CONTROL_PERIOD] > ADDED_NOISE_MAX_PERIOD_S:
        return
    nis_sum = 0.0
    count = x.tendon.shape[1]
    for n in range(count):
        nis_sum += x.tendon[s.RECENT_NIS_MEAN, n]
    limit = NOISE_NIS_LIMIT if nis_sum < NOISE_NIS_LIMIT_OF_HAND * count else 0.0
    for n in range(count):
        remaining_time = max(x.tendon[s.ADDED_NOISE_TIME_S, n] - c.run[h.CONTROL_PERIOD], 0.0)
        x.tendon[s.ADDED_NOISE_TIME_S, n] = (
            MAX_ADDED_NOISE_S if x.tendon[s.RECENT_NIS_MEAN, n] > limit else remaining_time
        )


@kernel_helper
def filtered_tension(x: StateTables, c: ConstantTables, n: int) -> float:
    """Return the tension of a tendon at its load cell [N], computed from the filter states.

    The computed tension can be negative.
    """
    tension = 0.0
    kind = x.tendon_int[s.FILTER_KIND, n]
    for i in range(STATE_COUNT):
        tension += c.design[n, kind, h.TENSION_ROW_OFFSET + i] * x.tendon[s.SPOOL_TRAVEL + i, n]
    return tension


@kernel_helper
def write_free_angles(x: StateTables, c: ConstantTables, row: int, result: Vector) -> None:
    """Write the angles or rates (J,) of the joints of free digits, q = B R_r^+ s.

    B is the coupling of the joints. R_r are the reduced moment arms, and s are the excursions or
    their rates. With varying moment arms, the angles also have an offset, see
    ``varying_moment_arms``.

    Args:
        x: state tables.
        c: constants of the hand.
        row: row of the tendon table with the values s: ``EXCURSION`` for angles, ``EXCURSION_RATE``
            for rates.
        result: (J,) result: angles [rad] or rates [rad/s].
    """
    for j in range(len(result)):
        result[j] = c.joint[h.ANGLE_OFFSET, j] if row == s.EXCURSION else 0.0
        for n in range(x.tendon.shape[1]):
            result[j] += c.joint_tendon_table[h.EXCURSION_TO_JOINTS, j, n] * x.tendon[row, n]


@kernel_helper
def _resistance_and_pull_forces(x: StateTables, c: ConstantTables) -> Matrix:
    """Return the resistance, and two estimates of the pull, for each tendon at the joints (3, N) [N].

    Row 0, the resistance, is the tension at the joints that balances springs and gravity. Row 2,
    the pull, is the estimated tension at the joints, after the friction of the pulleys. If the
    control law has computed a friction state for a tendon, friction is computed from this state. If
    the friction state of a tendon is unknown, friction is computed from the speed of the tendon at
    the spool. The estimated speed of the digit is not used, because this estimate is rough, and its
    sign would chatter.

    Row 1, the speed-signed pull, is the pull with friction that is always computed from the speed
    of the tendon at the spool. The test for the open stop uses the speed-signed pull, because this
    force is the first to show that a digit leaves the stop.
    """
    count = x.tendon.shape[1]
    joints = x.joint.shape[1]
    force = np.zeros((3, count))
    q = np.zeros(joints)
    torque = np.zeros(joints)
    write_free_angles(x, c, s.EXCURSION, q)
    write_static_torque(c, q, torque)
    tension = np.empty(count)
    friction_by_speed = np.empty(count)
    friction_states = np.empty(count)
    is_friction_state_known = False
    for n in range(count):
        tension[n] = filtered_tension(x, c, n)
        friction_by_speed[n] = math.tanh(motor_speed(x, c, n) / CAPSTAN_FRICTION_SPEED_M_S)
        friction_state = x.tendon[s.FRICTION_STATE, n]
        friction_states[n] = friction_by_speed[n] if math.isnan(friction_state) else friction_state
        is_friction_state_known |= friction_states[n] != friction_by_speed[n]
    subtract_torque_of_passing_tendons(
        c, q, tension, friction_states if is_friction_state_known else friction_by_speed, torque
    )
    write_tensions_for_torque(c, torque, force[0])
    write_tensions_at_joints(c, q, tension, friction_by_speed, force[1])
    write_tensions_at_joints(
        c, q, tension, friction_states if is_friction_state_known else friction_by_speed, force[2]
    )
    return force


@kernel_helper
def _update_regimes(x: StateTables, c: ConstantTables) -> Matrix:
    """Update the regime of each tendon, and correct the filter states of newly taut tendons.

    For a newly taut tendon, the function corrects either the stretch offset or the excursion, see
    ``set_offset_of_newly_taut_tendon``. The regime of a tendon depends on three conditions: the
    tendon is slack, the digit is on its open stop, or the digit is in contact. Return the forces of
    ``_resistance_and_pull_forces``, computed with the new regimes.
    """
    force = _resistance_and_pull_forces(x, c)
    has_changed = False
    for n in range(x.tendon.shape[1]):
        regime = x.tendon_int[s.REGIME, n]
        cell = x.tendon[s.MEASURED_TENSION, n]
        # While a tendon is slack, only the motor encoder determines the slack length that the spool
        # must still wind up.
        is_almost_taut = (
            regime == SLACK_REGIME
            and x.tendon_int[s.TENDON_LENGTH_KNOWN, n] == 1
            and is_nearly_taut(x, n)
        )
        has_no_cell = c.tendon_int[h.CELL_GROUP, n] < 0
        evidence_count = x.tendon_int[s.REGIME_EVIDENCE, n]
        tension = filtered_tension(x, c, n)
        if has_no_cell:
            # In the model of a slack tendon, the tension is 0, so the estimated disturbance force
            # of a newly taut tendon equals minus the tension.
            cell = -x.tendon[s.MOTOR_DISTURBANCE, n]
            evidence_count = regime_evidence_without_cell(regime, evidence_count, tension, cell)
        else:
            evidence_count = regime_evidence(
                regime, evidence_count, tension, cell, x.tendon[s.CELL_ERROR, n], is_almost_taut
            )
        if c.tendon_int[h.IS_SPOOL_PAIR, n]:
            # The spool of a spool pair turns the joint in both directions. At least one tendon of a
            # spool pair is always taut.
            evidence_count = 0
            regime = FREE_REGIME
        elif is_regime_over(regime, evidence_count, has_no_cell):
            evidence_count = 0
            if regime == SLACK_REGIME:
                set_offset_of_newly_taut_tendon(x, c, n, cell)
                x.tendon_int[s.TENDON_LENGTH_KNOWN, n] = 1
            regime = FREE_REGIME if regime == SLACK_REGIME else SLACK_REGIME
        x.tendon_int[s.REGIME_EVIDENCE, n] = evidence_count
        was_on_stop = x.tendon_int[s.DIGIT_ON_OPEN_STOP, n] == 1
        is_on_stop = c.tendon_int[h.HAS_RETURN_SPRINGS, n] == 1
        if is_on_stop:
            # For a tendon that opens its digit, the pull and the excursion are negative in the test
            # for the open stop.
            side = c.tendon[h.CLOSING_SIGN, n]
            open_excursion = c.tendon[h.OPEN_EXCURSION, n]
            is_on_stop = _is_at_stop(
                was_on_stop,
                side * (x.tendon[s.EXCURSION, n] - open_excursion),
                side * force[1, n],
                side * force[0, n],
            )
        x.tendon_int[s.DIGIT_ON_OPEN_STOP, n] = is_on_stop
        if regime != SLACK_REGIME:
            if is_on_stop and not was_on_stop:
                # The digit has come to rest on its open stop. While a digit is on its open stop,
                # the excursions of its tendons are known, so the error of each estimated excursion
                # is added to the stretch offset.
                open_excursion = c.tendon[h.OPEN_EXCURSION, n]
                x.tendon[s.STRETCH_OFFSET, n] += x.tendon[s.EXCURSION, n] - open_excursion
                x.tendon[s.EXCURSION, n] = open_excursion
                x.tendon[s.EXCURSION_RATE, n] = 0.0
                has_changed = True
            regime = (
                HELD_REGIME
                if is_on_stop or is_in_contact(x, c.tendon_int[h.DIGIT_OF_TENDON, n])
                else FREE_REGIME
            )
        has_changed |= regime != x.tendon_int[s.REGIME, n]
        x.tendon_int[s.REGIME, n] = regime
    if has_changed:
        for n in range(x.tendon.shape[1]):
            x.tendon_int[s.FILTER_KIND, n] = filter_kind(x, n)
        force = _resistance_and_pull_forces(x, c)
    return force


@kernel_helper
def is_in_contact(x: StateTables, d: int) -> bool:
    """Return True if a digit is blocked, or if it is in planned contact while its motors are allowed to make torque."""
    makes_torque = ARMING_MODE <= x.run_int[s.HAND_MODE] <= RELAX_MODE
    return (makes_torque and x.digit_int[s.PLANNED_CONTACT, d] == 1) or x.digit_int[
        s.IS_BLOCKED, d
    ] == 1


@kernel_helper
def _is_at_stop(was_at_stop: bool, excursion: float, force: float, spring_force: float) -> bool:
    """Return True if springs hold a digit on its open stop against the pull of a tendon."""
    if was_at_stop:
        return (
            excursion < MAX_STOP_DISTANCE_TO_STAY_AT_REST_M
            and force < spring_force * MAX_PULL_TO_STAY_AT_REST
        )
    return (
        excursion < MAX_STOP_DISTANCE_TO_COME_TO_REST_M
        and force < spring_force * MAX_PULL_TO_COME_TO_REST
    )


@kernel_helper
def _choose_filter_kinds(x: StateTables) -> None:
    """Choose the filter design of each tendon for the prediction."""
    for n in range(x.tendon.shape[1]):
        x.tendon_int[s.FILTER_KIND, n] = filter_kind(x, n)


@kernel_helper
def _write_external_tension(x: StateTables, c: ConstantTables, force: Matrix) -> None:
    """Write the part of each tendon's load force that springs, gravity and friction do not explain.

    The value is positive if the load force acts against the closing of the digit.

    The value is 0 for a slack tendon, and while the digit is at its open stop.
    """
    for n in range(x.tendon.shape[1]):
        x.tendon[s.EXTERNAL_TENSION, n] = 0.0
        if x.tendon_int[s.REGIME, n] != SLACK_REGIME and not x.tendon_int[s.DIGIT_ON_OPEN_STOP, n]:
            damping = c.tendon[h.LOAD_DAMPING, n] * x.tendon[s.EXCURSION_RATE, n]
            # The load force is the pull of the tendon minus the resistance of springs and gravity.
            # If an object resists the closing digit, the load force is positive.
            x.tendon[s.EXTERNAL_TENSION, n] = force[2, n] - force[0, n] - damping


@kernel_helper
def write_estimate_before_start(x: StateTables) -> None:
    """Write the estimate of a tick before the filter has started.

    Before the filter has started, the external tension is 0, and the innovation is NaN.
    """
    for n in range(x.tendon.shape[1]):
        x.tendon[s.EXTERNAL_TENSION, n] = 0.0
        x.tendon[s.INNOVATION, n] = x.tendon[s.NIS, n] = math.nan
        x.tendon_int[s.FILTER_KIND, n] = filter_kind(x, n)


@kernel_helper
def derive_estimate(x: StateTables, c: ConstantTables) -> None:
    """Compute tensions, their standard deviations, and joint angles of free digits from the predicted filter states."""
    for n in range(x.tendon.shape[1]):
        tension = filtered_tension(x, c, n)
        # Only a spool pair can have a negative tension, and a single tendon cannot.
        x.tendon[s.TENSION, n] = tension if c.tendon_int[h.IS_SPOOL_PAIR, n] else max(tension, 0.0)
        x.tendon[s.TENSION_SIGMA, n] = math.sqrt(
            c.design[n, x.tendon_int[s.FILTER_KIND, n], h.TENSION_VARIANCE_OFFSET]
        )
        if x.run_int[s.COVARIANCE_PROPAGATED]:
            x.tendon[s.TENSION_SIGMA, n] = filter_covariance.predicted_tension_sigma(x, c, n)
    write_free_angles(x, c, s.EXCURSION, x.joint[s.Q])
    write_free_angles(x, c, s.EXCURSION_RATE, x.joint[s.DQ])
