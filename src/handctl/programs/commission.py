"""Program that commissions a hand.

Commissioning finds the tares and the motor zeros, and proves that each motor pulls its own tendon.
The motors gently pull one tendon after the other. The other tendons stay slack. During a pull, only
the load cell and the motor encoder of the pulled tendon may respond. The pull is too weak to move a
digit against its springs, so the program does not test the joint encoders.

A tendon without a load cell has no tare. For a tendon without a load cell, the motor force shows
when the tendon becomes taut.

In a digit without springs, a single tendon would move the digit. Therefore all tendons of the digit
first pull together, and press the joints against their lower limits. After all tendons of the digit
have pulled together, the program increases the tension of one tendon after the other. At the lower
joint limits, the tendon excursions are known, or joint encoders measure them. The program subtracts
these excursions from the motor zeros.

Load cells drift while many tendons are pulled one by one. Therefore all motors are without torque
for a moment before each pull. The load-cell readings without torque are the reference for the
responses of all load cells. The program also renews the tare of the next tendon from its load-cell
reading without torque.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from handctl.core.calibration import Calibration, TendonCalibration
from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.tension_allocation import tensions_for_torque
from handctl.core.hand_estimate import HandEstimate, TickMeasurements
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent, Vector
from handctl.drives.contract import Drive
from handctl.drives.sensors.sensor_node import TARE_MAX_N, TARE_MIN_N
from handctl.drives.signals import SignalCoding, SignalQuantity
from handctl.hand.description import Hand
from handctl.hand.dynamics import static_torque
from handctl.hand.file.error_text import lines_by_text
from handctl.programs.program import TARE_PHASE, ProgramProgress, ProgressAndEvents

PULL_TENSION_N = 3.0
"""Tension with which the program pulls a tendon [N]."""
PULL_FORCE_LIMIT_N = 12.0
"""Largest motor force during the pull of a tendon: the sum of pull tension, friction and a margin [N].

The limit of the motor force matters if a load cell does not respond.
"""
TARE_DURATION_S = 0.5
"""Averaging time of the first tare of the load cells [s]."""
REST_SETTLING_S = 0.3
"""Time without motor torque before the program reads the load cells again [s]."""
REST_DURATION_S = 0.2
"""Averaging time of the load-cell readings without torque, before each pull [s]."""
PULL_SETTLING_S = 0.7
"""Time from the moment at which a pulled tendon becomes taut until its measurement [s].

In a digit without springs, the same time passes from the end of a pull to the reading of all load
cells.
"""
TAKE_UP_TIMEOUT_S = 3.0
"""Longest allowed time until a pulled tendon becomes taut [s]."""
HOLD_TIMEOUT_S = 10.0
"""Longest allowed time until all tendons of a digit without springs become taut [s]."""
HOLD_SETTLING_TIMEOUT_S = 3.0
"""Time from the moment at which all tendons of a digit without springs are taut until their measurement [s].

Before the first pull, the digit needs the time to move to its lower joint limits. The digit stays
at its lower joint limits for the pulls of all its tendons, so only the first pull waits for the
motion.
"""
PRESSING_TORQUE_FACTOR = 1.5
"""Torque that presses a digit without springs on its lower limits, as a multiple of the torque of a pull."""
MEASUREMENT_DURATION_S = 0.3
"""Averaging time of the response to a pull [s]."""
MIN_RESPONSE_FRACTION = 0.6
"""Smallest accepted response of the pulled tendon's load cell, as a fraction of the pull tension."""
MAX_CROSSTALK_FRACTION = 0.3
"""Largest accepted response of any other load cell, as a fraction of the pull tension."""
MIN_EXCHANGED_ENCODER_MOTION_M = 0.1e-3
"""Smallest motion of another motor that shows exchanged encoders, if the motor of the pulled tendon moves less [m].

A motor without torque moves its tendon by less than 0.1 mm. A simulated motor without torque moves
by at most 10 um. A motor whose tendon contracts after an earlier pull moves by at most 70 um.
"""

(
    TARE_SUM,
    TARE_SAMPLES,
    ZERO_COLUMN,
    ANSWER_COLUMN,
    CROSSTALK_COLUMN,
    PULL_SUM,
    REST_SUM,
    REST_SAMPLES,
    START_TRAVEL,
) = range(9)
COLUMN_COUNT = 9
"""Number of columns of the table in `ProgramProgress.record`.

The constants before ``COLUMN_COUNT`` are the indices of the table's columns.
"""
TOUCHING_BEFORE_PULL = -1
"""Value of `ProgramProgress.touching[0]` before the pull of a tendon.

During a pull, `ProgramProgress.touching[0]` is 0 until the tendon is taut. After the tendon has
become taut, it is 1 more than the number of readings.
"""


@dataclass(frozen=True, slots=True)
class CommissionProgram:
    """Program that commissions a hand, with one step for the tares and one step for each tendon.

    Step 0 tares all load cells, and step i + 1 pulls tendon i. `ProgramProgress.record` is a table
    with a row for each tendon. The columns of the table are:

    - sum and number of the tare samples,
    - motor zero [rad], response [N], and crosstalk [N],
    - sum of the load-cell samples during the present pull,
    - sum and number of the load-cell samples just before the pull,
    - travel at the start of the pull [m].
    """

    def initial_progress(self, model: HandModel) -> ProgramProgress:
        """Return the progress at the start of the commissioning.

        The motors make no torque, and all entries of the table are zero.
        """
        empty_table = (0.0,) * (COLUMN_COUNT * model.tendon_count)
        return replace(
            ProgramProgress.initial(len(model.digits), TARE_PHASE), since=-1.0, record=empty_table
        )

    def advance(
        self,
        model: HandModel,
        progress: ProgramProgress,
        estimate: HandEstimate,
        measurements: TickMeasurements,
        t: float,
    ) -> ProgressAndEvents:
        """Advance the commissioning by one tick. The interface `Program` explains the arguments."""
        if progress.finished:
            return progress, ()
        if progress.since < 0.0:
            return replace(progress, since=t), (TickEvent("info", "phase", "", _tare_text(model)),)
        if progress.step == 0:
            return self._tare_cells(model, progress, measurements, t)
        if progress.touching[0] == TOUCHING_BEFORE_PULL:
            return self._renew_tare(model, progress, measurements, t)
        if progress.phase == _hold_phase(model, progress.step - 1):
            return self._advance_hold(model, progress, estimate, measurements, t)
        return self._advance_tendon_pull(model, progress, estimate, measurements, t)

    def _tare_cells(
        self, model: HandModel, progress: ProgramProgress, measured: TickMeasurements, t: float
    ) -> ProgressAndEvents:
        table = _commissioning_table(progress)
        tension = _measured_or_estimated_tensions(model, measured)
        if not np.isnan(tension).any():
            table[:, TARE_SUM] += tension
            table[:, TARE_SAMPLES] += 1.0
        progress = _with_commissioning_table(progress, table)
        if t - progress.since < TARE_DURATION_S:
            return progress, ()
        return self._check_tare(model, progress) or self._next_tendon(
            model, _with_new_tare(progress), t
        )

    def _check_tare(self, model: HandModel, progress: ProgramProgress) -> ProgressAndEvents | None:
        """Return a failed progress if the tare of a load cell is near a limit of its measuring range.

        If all tares are usable, return None.
        """
        tare = _tares_from_table(_commissioning_table(progress))
        worst_tendon = int(np.maximum(tare - TARE_MAX_N, TARE_MIN_N - tare).argmax())
        if TARE_MIN_N <= tare[worst_tendon] <= TARE_MAX_N:
            return None
        reading = f"{tare[worst_tendon]:.1f} N without tension"
        bounds = f"from {TARE_MIN_N:g} to {TARE_MAX_N:g} N"
        return self._refuse_tendon(
            model, progress, worst_tendon, f"load cell reads {reading}, which can be tared {bounds}"
        )

    def _renew_tare(
        self, model: HandModel, progress: ProgramProgress, measured: TickMeasurements, t: float
    ) -> ProgressAndEvents:
        """Read all load cells while no motor makes torque, and renew the tare of the present tendon.

        After the reading, the program pulls the present tendon. A tare is renewed only if the
        tendon has never been taut, because friction can hold tension in a tendon that was pulled
        before. The tares of all tendons in a digit without springs are renewed together.
        """
        if t - progress.since < REST_SETTLING_S:
            return progress, ()
        tension = _measured_or_estimated_tensions(model, measured)
        if np.isnan(tension + measured.travel).any():
            return progress, ()
        i = progress.step - 1
        table = _commissioning_table(progress)
        table[:, REST_SUM] += tension
        table[:, REST_SAMPLES] += 1.0
        samples = table[i, REST_SAMPLES]
        # The averaging ends after a fixed number of readings, so it takes longer if readings are
        # missing.
        if samples * model.period < REST_DURATION_S:
            return _with_commissioning_table(progress, table), ()
        # The new average of a tare has as much weight as all earlier readings together.
        tendons_with_new_tare = (
            slice(i, i + 1)
            if model.redundancy.has_return_springs[i]
            else model.digit_tendons[model.digit_of_tendon[i]]
        )
        table[tendons_with_new_tare, TARE_SUM] += (
            table[tendons_with_new_tare, REST_SUM]
            / samples
            * table[tendons_with_new_tare, TARE_SAMPLES]
        )
        table[tendons_with_new_tare, REST_SUM] = 0.0
        table[:, START_TRAVEL] = measured.travel
        progress = _with_new_tare(_with_commissioning_table(progress, table))
        if not model.redundancy.has_return_springs[i]:
            hold_progress, events = self._begin_holding_digit(model, progress, t, is_taut=False)
            return self._check_tare(model, progress) or (hold_progress, events)
        goals = tuple(_pull_goal(tendons, i) for tendons in model.digit_tendons)
        name = model.hand.tendon_names[i]
        pull_progress = replace(
            progress, since=t, goals=goals, phase=f"pull {name}", touching=(0,) * len(goals)
        )
        event = TickEvent("info", "phase", name, f"pulling {name} with {PULL_TENSION_N:g} N")
        return self._check_tare(model, progress) or (pull_progress, (event,))

    def _begin_holding_digit(
        self, model: HandModel, progress: ProgramProgress, t: float, is_taut: bool
    ) -> ProgressAndEvents:
        """Press the digit of the present step's tendon against its lower joint limits, with all tendons taut.

        Args:
            model: model of the hand.
            progress: progress of the commissioning.
            t: time [s].
            is_taut: True if all tendons of the digit are already taut.
        """
        i = progress.step - 1
        goals = _hold_goals(model, i, np.zeros(model.tendon_count))
        phase = _hold_phase(model, i)
        table = _commissioning_table(progress)
        table[:, [PULL_SUM, REST_SUM, REST_SAMPLES]] = 0.0
        hold_progress = replace(
            _with_commissioning_table(progress, table),
            since=t,
            goals=goals,
            phase=phase,
            touching=(int(is_taut),) * len(goals),
        )
        digit = model.hand.digit_names[model.digit_of_tendon[i]]
        return hold_progress, () if is_taut else (
            TickEvent("info", "phase", digit, f"{phase}: all its tendons together"),
        )

    def _advance_hold(
        self,
        model: HandModel,
        progress: ProgramProgress,
        estimate: HandEstimate,
        measurements: TickMeasurements,
        t: float,
    ) -> ProgressAndEvents:
        """Wait until the pressed digit is at rest, and read the load cells and the motor zero angles.

        After the reading, the program pulls the present tendon.
        """
        i = progress.step - 1
        digit_tendons = model.digit_tendons[model.digit_of_tendon[i]]
        touching_ticks = progress.touching[0]
        if touching_ticks == 0:
            if not estimate.is_slack[digit_tendons].any():
                # When all tendons are taut, they press the joints against their limits. From this
                # tick on, the filter must treat the digit as a digit in contact.
                contact = tuple(d == model.digit_of_tendon[i] for d in range(len(model.digits)))
                return replace(
                    progress, touching=(1, *progress.touching[1:]), since=t, contact=contact
                ), ()
            if t - progress.since <= HOLD_TIMEOUT_S:
                return progress, ()
            slack = digit_tendons.start + int(np.flatnonzero(estimate.is_slack[digit_tendons])[0])
            return self._refuse_tendon(
                model, progress, slack, _missing_response_reason(model, measurements)
            )
        is_first_tendon = i == digit_tendons.start
        settling_time_s = HOLD_SETTLING_TIMEOUT_S if is_first_tendon else PULL_SETTLING_S
        if t - progress.since < settling_time_s:
            return progress, ()
        excursion = np.where(
            model.hand.tendons_with_encoders,
            measurements.excursion,
            model.redundancy.excursion_at_lower_limits,
        )[digit_tendons]
        tension = _measured_or_estimated_tensions(model, measurements, estimate)
        if (
            np.isnan(tension).any()
            or np.isnan(measurements.travel[digit_tendons] + excursion).any()
        ):
            return progress, ()
        table = _commissioning_table(progress)
        table[:, REST_SUM] += tension
        table[:, REST_SAMPLES] += 1.0
        if is_first_tendon:
            stretch = tension[digit_tendons] / model.tendon_constants.stiffness[digit_tendons]
            table[digit_tendons, ZERO_COLUMN] += (
                measurements.travel[digit_tendons] - stretch - excursion
            ) / model.tendon_constants.spool_radius[digit_tendons]
        progress = replace(
            _with_commissioning_table(progress, table),
            touching=(touching_ticks + 1, *progress.touching[1:]),
        )
        if touching_ticks * model.period < MEASUREMENT_DURATION_S:
            return progress, ()
        if is_first_tendon:
            table[digit_tendons, ZERO_COLUMN] /= touching_ticks
        added_tension = np.zeros(model.tendon_count)
        added_tension[i] = PULL_TENSION_N
        name = model.hand.tendon_names[i]
        pull_progress = replace(
            _with_commissioning_table(progress, table),
            since=t,
            goals=_hold_goals(model, i, added_tension),
            phase=f"pull {name}",
            touching=(1,) * len(progress.goals),
        )
        return pull_progress, (
            TickEvent("info", "phase", name, f"pulling {name} with {PULL_TENSION_N:g} N more"),
        )

    def _advance_tendon_pull(
        self,
        model: HandModel,
        progress: ProgramProgress,
        estimate: HandEstimate,
        measurements: TickMeasurements,
        t: float,
    ) -> ProgressAndEvents:
        """Pull the present tendon.

        The method waits until the tendon is taut and its tension has settled, and measures the
        response.
        """
        i = progress.step - 1
        touching_ticks = progress.touching[0]
        if touching_ticks == 0 and not estimate.is_slack[i]:
            progress = replace(progress, touching=(1, *progress.touching[1:]), since=t)
        if touching_ticks == 0:
            is_late = t - progress.since > TAKE_UP_TIMEOUT_S
            return (
                self._refuse_tendon(
                    model, progress, i, _missing_response_reason(model, measurements)
                )
                if is_late
                else (progress, ())
            )
        if t - progress.since < PULL_SETTLING_S:
            return progress, ()
        tension = _measured_or_estimated_tensions(model, measurements, estimate)
        if np.isnan(tension + measurements.travel).any():
            return progress, ()
        table = _commissioning_table(progress)
        table[:, PULL_SUM] += tension
        if model.redundancy.has_return_springs[i]:
            # The motor angle [rad] is the travel of the tendon [m] divided by the radius of the
            # spool.
            table[i, ZERO_COLUMN] += measurements.travel[i] / model.tendon_constants.spool_radius[i]
        samples = progress.touching[0]
        if samples * model.period >= MEASUREMENT_DURATION_S:
            other_encoder = _encoder_that_turned(model, table, i, measurements.travel)
            if other_encoder is not None:
                name = model.hand.tendon_names[other_encoder]
                text = f"the motor encoder of {name} turns instead of its own: exchanged?"
                return self._refuse_tendon(model, progress, i, text)
            return self._judge_response(
                model,
                _with_commissioning_table(
                    progress, _table_with_pull_results(model, table, i, samples)
                ),
                i,
                t,
            )
        return replace(
            _with_commissioning_table(progress, table),
            touching=(samples + 1, *progress.touching[1:]),
        ), ()

    def _judge_response(
        self, model: HandModel, progress: ProgramProgress, i: int, t: float
    ) -> ProgressAndEvents:
        """Accept the measured response of tendon i, or end the commissioning with a failure."""
        answer, crosstalk = _commissioning_table(progress)[i, [ANSWER_COLUMN, CROSSTALK_COLUMN]]
        if answer < MIN_RESPONSE_FRACTION * PULL_TENSION_N:
            sensor = "load cell" if model.hand.has_cell[i] else "motor"
            return self._refuse_tendon(
                model,
                progress,
                i,
                f"{sensor} answers {answer:.2f} N to a pull of {PULL_TENSION_N:g} N",
            )
        if crosstalk > MAX_CROSSTALK_FRACTION * PULL_TENSION_N:
            text = f"another load cell answers {crosstalk:.2f} N: swapped, or two tendons touch"
            return self._refuse_tendon(model, progress, i, text)
        event = TickEvent(
            "info",
            "commission",
            model.hand.tendon_names[i],
            _response_text(model, i, answer, crosstalk),
        )
        progress, entered = self._next_tendon(model, progress, t)
        return progress, (event, *entered)

    def _next_tendon(
        self, model: HandModel, progress: ProgramProgress, t: float
    ) -> ProgressAndEvents:
        """Release the present tendon.

        After the release, the program waits until the next tendon can be pulled. After the last
        tendon, the program finishes.
        """
        step = progress.step + 1
        is_same_digit = (
            1 < step <= model.tendon_count
            and model.digit_of_tendon[step - 1] == model.digit_of_tendon[step - 2]
        )
        if is_same_digit and not model.redundancy.has_return_springs[step - 1]:
            return self._begin_holding_digit(model, replace(progress, step=step), t, is_taut=True)
        zero_torque_goals = (DigitGoal(),) * len(model.digits)
        if step > model.tendon_count:
            finished_progress = replace(
                progress, finished=True, phase="end", goals=zero_torque_goals
            )
            return finished_progress, (TickEvent("info", "phase", "", "commissioned"),)
        return replace(
            progress,
            step=step,
            since=t,
            goals=zero_torque_goals,
            phase="rest",
            contact=(False,) * len(zero_torque_goals),
            touching=(TOUCHING_BEFORE_PULL,) * len(zero_torque_goals),
        ), ()

    def _refuse_tendon(
        self, model: HandModel, progress: ProgramProgress, i: int, reason: str
    ) -> ProgressAndEvents:
        """End the commissioning because the pull of tendon i has failed."""
        name = model.hand.tendon_names[i]
        progress_after_failure = replace(
            progress,
            finished=True,
            failure=f"{name}: {reason}",
            goals=(DigitGoal(),) * len(progress.goals),
        )
        return progress_after_failure, (TickEvent("error", "commission", name, reason),)


def _tare_text(model: HandModel) -> str:
    """Return the event text for the start of commissioning."""
    if model.hand.has_cell.any():
        return "tare: all motors limp"
    return "no load cells to tare: all motors limp. Swapped tendons are not checked"


def _response_text(model: HandModel, i: int, answer: float, crosstalk: float) -> str:
    """Return the event text after tendon i was pulled and has responded correctly.

    Only load cells can show that a wrong tendon was pulled. If no tendon except tendon i has a load
    cell, the text states that swapped tendons are not checked.

    Args:
        model: model of the hand.
        i: index of the tendon.
        answer: response of the tendon's own load cell, or of its motor [N].
        crosstalk: largest response of any other load cell [N].
    """
    has_cell = model.hand.has_cell
    response_text = (
        f"answers {answer:.2f} N" if has_cell[i] else f"taut at {answer:.2f} N by its motor"
    )
    if (has_cell & (np.arange(model.tendon_count) != i)).any():
        return f"{response_text}, other load cells {crosstalk:.2f} N"
    return f"{response_text}; no other load cell, so swapped tendons are not checked"


def _missing_response_reason(model: HandModel, measured: TickMeasurements) -> str:
    """Return a text with the probable reason why the load cell of the pulled tendon does not respond.

    If the load cell of another tendon responds, the text names that tendon.
    """
    measured_tensions = np.nan_to_num(measured.tension)
    other_tendon = int(measured_tensions.argmax())
    if measured_tensions[other_tendon] < MIN_RESPONSE_FRACTION * PULL_TENSION_N:
        return "does not become taut"
    name = model.hand.tendon_names[other_tendon]
    return f"does not become taut, but the load cell of {name} reads {measured_tensions[other_tendon]:.1f} N: swapped?"


def _pull_goal(tendons: slice, i: int) -> DigitGoal:
    """Return the goal of a digit while tendon i is pulled.

    If tendon i belongs to another digit, the goal is zero torque.
    """
    if not tendons.start <= i < tendons.stop:
        return DigitGoal()
    tension = np.zeros(tendons.stop - tendons.start)
    tension[i - tendons.start] = PULL_TENSION_N
    return DigitGoal(GoalKind.TENSION, tension=tension, rate=20.0, force_limit=PULL_FORCE_LIMIT_N)


def _measured_or_estimated_tensions(
    model: HandModel, measurements: TickMeasurements, estimate: HandEstimate | None = None
) -> Vector:
    """Return the tensions (N,) [N] of all tendons in a tick.

    The tension of a tendon with a load cell is the reading of the load cell. The tension of a
    tendon without a load cell is the estimated tension. If no estimate is given, a tendon without a
    load cell counts as slack.
    """
    return np.where(
        model.hand.has_cell, measurements.tension, 0.0 if estimate is None else estimate.tension
    )


def _hold_phase(model: HandModel, i: int) -> str:
    """Return the name of the phase in which tendon i pulls together with all other tendons of the same digit."""
    return f"hold {model.hand.digit_names[model.digit_of_tendon[i]]}"


def _hold_goals(model: HandModel, i: int, extra_tension: Vector) -> tuple[DigitGoal, ...]:
    """Return goals that press the joints in the digit of tendon i against their lower limits.

    The motors of all other digits make no torque.

    Args:
        model: model of the hand.
        i: index of the tendon.
        extra_tension: (N,) additional tension [N].
    """
    held_digit = model.digit_of_tendon[i]
    digit = model.digits[held_digit]
    tendons = model.digit_tendons[held_digit]
    arms = digit.with_moment_arms_at(digit.joint_min).reduced_moment_arms
    # A stronger pull of one tendon must not move the digit away from its joint limits. The joint
    # torque of the pull is at most the pull tension times the largest moment arm of a closing
    # tendon.
    pressing_torque = PRESSING_TORQUE_FACTOR * PULL_TENSION_N * np.maximum(arms, 0.0).max(axis=0)
    torque = digit.coupling.T @ np.asarray(static_torque(digit, digit.joint_min)) - pressing_torque
    tension = tensions_for_torque(arms, torque, model.floor[tendons], model.ceiling[tendons])[0]
    limit = float(np.abs(tension).max()) + PULL_FORCE_LIMIT_N
    goal = DigitGoal(
        GoalKind.TENSION, tension=tension + extra_tension[tendons], rate=20.0, force_limit=limit
    )
    return tuple(goal if d == held_digit else DigitGoal() for d in range(len(model.digits)))


def _commissioning_table(progress: ProgramProgress) -> Vector:
    """Return the table (N, COLUMNS) of a commissioning progress."""
    return np.array(progress.record).reshape(-1, COLUMN_COUNT)


def _with_commissioning_table(progress: ProgramProgress, table: Vector) -> ProgramProgress:
    """Return a copy of a commissioning progress in which the given table replaces the old table."""
    return replace(progress, record=tuple(table.ravel().tolist()))


def _tares_from_table(table: Vector) -> Vector:
    """Return the tares (N,) [N] that a commissioning table contains."""
    return np.asarray(table[:, TARE_SUM] / np.maximum(table[:, TARE_SAMPLES], 1.0))


def _with_new_tare(progress: ProgramProgress) -> ProgramProgress:
    """Return a copy of a progress with new load-cell tares, which are computed from the commissioning table.

    The new tares apply from the next reading on.
    """
    return replace(progress, tare=tuple(_tares_from_table(_commissioning_table(progress)).tolist()))


def _table_with_pull_results(model: HandModel, table: Vector, i: int, samples: int) -> Vector:
    """Return a copy of the commissioning table with the results for tendon i. All sums in the copy are zero."""
    rest_tensions = table[:, REST_SUM] / table[i, REST_SAMPLES]
    rise = table[:, PULL_SUM] / samples - rest_tensions
    if model.redundancy.has_return_springs[i]:
        # The pull stretches the tendon, so that the motor turns beyond the position at which the
        # tendon becomes taut.
        stretch = (
            rise[i] / model.tendon_constants.stiffness[i] / model.tendon_constants.spool_radius[i]
        )
        table[i, ZERO_COLUMN] = (
            table[i, ZERO_COLUMN] / samples
            - stretch
            - model.redundancy.excursion_at_lower_limits[i] / model.tendon_constants.spool_radius[i]
        )
    table[i, ANSWER_COLUMN] = rise[i]
    tendons = np.arange(model.tendon_count)
    # Friction holds tension in a tendon that was pulled before, and the held tension falls without
    # a command. Only an increase of the tension counts as crosstalk.
    spring_tensions = np.where(
        model.redundancy.has_return_springs & (tendons < i), np.maximum(rest_tensions, 0.0), 0.0
    )
    other_tendons = model.hand.has_cell & (tendons != i)
    table[i, CROSSTALK_COLUMN] = np.maximum(rise, -rise - spring_tensions)[other_tendons].max(
        initial=0.0
    )
    table[:, [PULL_SUM, REST_SUM, REST_SAMPLES]] = 0.0
    return table


def _encoder_that_turned(model: HandModel, table: Vector, i: int, travel: Vector) -> int | None:
    """Return the tendon whose motor encoder turned instead of the encoder of tendon i, while tendon i was pulled.

    Return None if no other encoder turned. The function ignores digits without springs, because the
    weight moves such a digit when its motors make no torque.

    Args:
        model: model of the hand.
        table: table of the progress, with the travel at the start of the pull.
        i: index of the pulled tendon.
        travel: (N,) measured travel at the end of the pull [m].
    """
    has_return_springs = model.redundancy.has_return_springs
    joint_travel = np.where(has_return_springs, np.abs(travel - table[:, START_TRAVEL]), 0.0)
    largest = int(joint_travel.argmax())
    are_encoders_exchanged = has_return_springs[i] and joint_travel[largest] > max(
        joint_travel[i], MIN_EXCHANGED_ENCODER_MOTION_M
    )
    return largest if are_encoders_exchanged else None


def idle_torque_warnings(hand: Hand, drives: Sequence[Drive]) -> tuple[str, ...]:
    """Return warnings about motors that make too much torque for commissioning even when they are idle.

    A torque command contains an integer code. For some motors, none of the codes stands for exactly
    zero torque. An idle motor of this kind makes the torque of the code nearest to zero.
    Commissioning accepts a tension from an idle motor up to the fraction ``MAX_CROSSTALK_FRACTION``
    of the pull tension. In simulation with spools of 5 mm, idle AK80-9 motors make a tension of
    0.88 N and pass commissioning. Idle AK70-10 motors (1.2 N) and idle AK10-9 motors (3.2 N) do not
    pass commissioning.

    Args:
        hand: description of the hand.
        drives: drive of each tendon, in the order of the tendons.
    """
    largest = MAX_CROSSTALK_FRACTION * PULL_TENSION_N
    warnings_by_motor: list[tuple[str, str]] = []
    for tendon, drive in zip(hand.tendon_names, drives, strict=True):
        motor = hand.motor_of_tendon(tendon)
        torque = _idle_torque(drive)
        if torque <= largest * motor.spool_radius_m:
            continue
        kind = motor.options.get("motor_type", motor.protocol)
        text = (
            f"no torque command of {kind} means zero: at rest it pulls with "
            f"{torque / motor.spool_radius_m:.1f} N, and handctl commission needs at most {largest:g} N; "
            f"expected spool_radius_m of {torque / largest:.2g}, or a motor of less torque"
        )
        warnings_by_motor.append((motor.name, text))
    return lines_by_text(warnings_by_motor)


def _idle_torque(drive: Drive) -> float:
    """Return the smallest absolute torque [N m at the spool] that a torque command can contain."""
    signals = [
        signal
        for message in drive.cyclic_messages.commands
        for signal in message.signals
        if signal.quantity == SignalQuantity.TORQUE and signal.coding != SignalCoding.FLOAT
    ]
    return max(
        (
            abs(round(-signal.offset / signal.scale) * signal.scale + signal.offset)
            for signal in signals
        ),
        default=0.0,
    )


def calibration_of_result(
    model: HandModel, progress: ProgramProgress, creation_date: str
) -> Calibration:
    """Return the calibration of a finished commissioning.

    Args:
        model: model of the hand.
        progress: finished progress without failure.
        creation_date: date and time of the calibration (ISO 8601, UTC).
    """
    table = _commissioning_table(progress)
    tare = _tares_from_table(table)
    rows = {
        name: TendonCalibration(
            tare_N=float(tare[i]),
            zero_rad=float(table[i, ZERO_COLUMN]),
            answer_N=float(table[i, ANSWER_COLUMN]),
            crosstalk_N=float(table[i, CROSSTALK_COLUMN]),
        )
        for i, name in enumerate(model.hand.tendon_names)
    }
    return Calibration(
        hand=model.hand.name, identity=model.hand.identity, made=creation_date, tendon=rows
    )
