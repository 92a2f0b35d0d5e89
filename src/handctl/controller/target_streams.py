"""Functions that open and close a stream of targets, and apply the targets to the controller's state."""

import math

import numpy as np

from handctl.controller.controller_state import ControllerState
from handctl.core import state_block as s
from handctl.core.control_law import streamed_motion
from handctl.core.control_law.digit_goal import GoalKind
from handctl.core.control_law.streamed_motion import CLIP_TOLERANCE
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, StreamTarget, TickEvent, Vector
from handctl.programs.program import ProgramProgress, coordinates_from_excursion
from handctl.programs.requests import OpenStreamRequest
from handctl.programs.stream_plans import (
    TARGET_UNIT_BY_SPACE,
    StreamPlan,
    StreamStatus,
    is_target_plausible,
    loop_fractions,
    mapping_of_stream,
    nearest_holdable_posture,
    stop_moving_digits,
    stream_plan_or_refusal,
    streamed_digits,
    streamed_goals,
    target_tensions,
)

MAX_TARGET_AGE_S = 0.1
"""Age beyond which a target is ignored [s], because later targets replace an old target."""
MAX_TARGET_INTERVAL_PERIODS = 2.5
"""Longest time between two targets for which the speed between the targets is computed [periods of the stream]."""
MAX_SETPOINT_LEAD_N = 6.0
"""Largest distance of a streamed setpoint above the estimated tension [N].

The tension of a free digit's tendon is not larger than the force of the digit's springs and
friction. A setpoint far above the tension of a free digit would spin the motor, which resembles a
snapped tendon (T01) or an oscillation (N14b). Setpoints also stay ``MAX_SETPOINT_LEAD_N`` below the
largest allowed tension, because the tension can overshoot.
"""


def present_references(model: HandModel, state: ControllerState) -> tuple[Vector, ...]:
    """Return the present motion reference of each digit, (3, n): position, rate and acceleration."""
    rows = state.layout.table(state.block, "coordinate")[s.TRAJECTORY : s.TRAJECTORY + 3]
    return tuple(rows[:, coordinate_slice] for coordinate_slice in model.digit_coordinates)


def present_setpoints(model: HandModel, state: ControllerState) -> tuple[Vector, ...]:
    """Return the present tension setpoints of each digit [N]."""
    return tuple(state.tendon[s.TENSION_SETPOINT, tendons] for tendons in model.digit_tendons)


def open_stream(model: HandModel, state: ControllerState, request: OpenStreamRequest) -> TickEvent:
    """Open a stream.

    Until the first target arrives, the digits of the stream keep their present motion reference.
    """
    stream = stream_plan_or_refusal(model, request)
    if isinstance(stream, str):
        return TickEvent("info", "request", "", f"refused: {stream}")
    close_stream(model, state)
    digits = streamed_digits(model, stream)
    if stream.is_angle_stream:
        _prepare_motion(model, state, digits)
    for row in (
        s.ACCEPTED_TARGET_COUNT,
        s.CLIPPED_TARGET_COUNT,
        s.LATE_TARGET_COUNT,
        s.REFUSED_TARGET_COUNT,
    ):
        state.run_integers[row] = 0
    state.run_integers[s.STREAM_SEQUENCE] = -1
    state.run_integers[s.STREAM_STATE] = s.OPEN_STREAM
    state.tendon[s.STIFFNESS_FRACTION], state.tendon[s.DAMPING_FRACTION] = loop_fractions(
        model, stream
    )
    tension = None if stream.is_angle_stream else present_setpoints(model, state)
    state.decide(stream=stream, progress=streamed_goals(state.progress, digits, tension))
    text = f"stream {stream.space} of {len(stream.names)} values at {request.rate_Hz:g} Hz, {stream.interpolation}"
    if stream.joint_stiffness is not None:
        fractions = state.tendon[
            s.STIFFNESS_FRACTION, [model.digits[d].tendons.start for d in digits]
        ]
        text += f", {100 * fractions.min():.0f} % of the stiffness of the gains"
    return TickEvent("info", "request", "", text)


def _prepare_motion(model: HandModel, state: ControllerState, digits: tuple[int, ...]) -> None:
    """Set the start of a joint-angle stream to the present motion reference of each streamed digit."""
    rows = state.layout.table(state.block, "coordinate")
    reference = present_references(model, state)
    for d in digits:
        if state.progress.goals[d].kind != GoalKind.MOTION:
            # If a digit has no reference, its motion starts at rest from the present angles.
            reference[d][0] = coordinates_from_excursion(model.digits[d], state.estimate)
            reference[d][1:] = 0.0
    rows[s.STREAM_TARGET] = np.clip(rows[s.TRAJECTORY], *model.coordinate_limits)
    rows[s.STREAM_RANGE : s.STREAM_RANGE + 2] = model.coordinate_limits
    rows[s.STREAM_SEGMENT : s.STREAM_SEGMENT + 6] = rows[s.STREAM_TARGET_RATE] = 0.0
    state.run_reals[s.STREAM_SEGMENT_START] = 0.0
    state.run_reals[s.STREAM_DURATION] = 0.0


def close_stream(model: HandModel, state: ControllerState) -> None:
    """Close the open stream, if there is one. The digits of the stream come to rest."""
    if state.decisions.stream is None:
        return
    state.decide(stream=None, progress=bring_to_rest(model, state, streamed_digits_only=True))
    state.run_integers[s.STREAM_STATE] = 0
    state.tendon[[s.STIFFNESS_FRACTION, s.DAMPING_FRACTION]] = 1.0


def bring_to_rest(
    model: HandModel, state: ControllerState, streamed_digits_only: bool = False
) -> ProgramProgress:
    """Replace the goals of all moving digits by goals at which the digits come to rest.

    Return the new progress of the program, which contains the replaced goals.
    """
    reach_by_digit = tuple(digit.coordinate_limits for digit in model.digits)
    setpoints = present_setpoints(model, state)
    return stop_moving_digits(
        state.progress,
        present_references(model, state),
        setpoints,
        state.goal_time,
        reach_by_digit,
        streamed_digits_only,
    )


def apply_target(
    model: HandModel, state: ControllerState, target: StreamTarget | None, t_ns: int
) -> tuple[TickEvent, ...]:
    """Apply a target of a stream, and begin the motion to the target.

    Args:
        model: model of the hand.
        state: state of the tick, modified in place.
        target: parsed target, or None if the target has a wrong form.
        t_ns: time of the tick [ns].

    Returns:
        An event for the first clipped, the first ignored and the first refused target of a stream.
        Later clipped, ignored or refused targets are only counted in the state.
    """
    stream = state.decisions.stream
    if (
        stream is None
        or state.mode != HandMode.ACTIVE
        or (target is not None and target.stream != stream.name)
    ):
        return ()  # the target belongs to another client, or to a stream that has ended
    if target is None or not is_target_plausible(stream, target.values):
        expected = f"{len(stream.names)} finite numbers of {TARGET_UNIT_BY_SPACE[stream.space]}"
        return _count_target(
            state,
            s.REFUSED_TARGET_COUNT,
            f"refused: a target that is no target, expected {expected}",
        )
    sent_ns = min(target.sent_ns, t_ns)
    is_running = state.run_integers[s.STREAM_STATE] == s.RUNNING_STREAM
    # If several targets arrive in one tick, each of them can have the time of the tick.
    is_outdated = (
        target.number <= state.run_integers[s.STREAM_SEQUENCE]
        or sent_ns < state.run_integers[s.STREAM_SENT_NS]
    )
    if (is_running and is_outdated) or t_ns - sent_ns > 1e9 * MAX_TARGET_AGE_S:
        return _count_target(
            state, s.LATE_TARGET_COUNT, "ignored: a target that is repeated, overtaken or too old"
        )
    begin_stream = _begin_segment if stream.is_angle_stream else _begin_tension_ramp
    is_clipped = begin_stream(model, state, stream, np.array(target.values), sent_ns, t_ns)
    state.run_integers[s.STREAM_SENT_NS] = sent_ns
    state.run_integers[s.STREAM_SEQUENCE] = target.number
    state.run_integers[s.STREAM_STATE] = s.RUNNING_STREAM
    _count_target(state, s.ACCEPTED_TARGET_COUNT)
    limit = (
        "the range of a joint, or one that taut tendons cannot hold"
        if stream.is_angle_stream
        else "the tension limits"
    )
    return (
        _count_target(state, s.CLIPPED_TARGET_COUNT, f"clipped: a target beyond {limit}")
        if is_clipped
        else ()
    )


def _begin_tension_ramp(
    model: HandModel,
    state: ControllerState,
    stream: StreamPlan,
    target_values: Vector,
    sent_ns: int,
    t_ns: int,
) -> bool:
    """Begin to change the tension setpoints linearly to the values of a target.

    Return True if the values were clipped.

    Arguments: see ``_begin_segment``.
    """
    setpoint = state.tendon[s.TENSION_SETPOINT]
    goal_tensions = target_tensions(model, stream, target_values, setpoint, state.estimate.q)
    limited_tensions = np.clip(goal_tensions, model.floor, model.ceiling)
    goal_tension = np.minimum(
        limited_tensions, np.maximum(state.tendon[s.TENSION], model.floor) + MAX_SETPOINT_LEAD_N
    )
    goal_tension = np.maximum(
        np.minimum(goal_tension, model.ceiling - MAX_SETPOINT_LEAD_N), model.floor
    )
    step = model.hand.stream.tension_rate_N_per_s * model.period
    ticks = max((sent_ns - t_ns) / 1e9 + stream.horizon, model.period) / model.period
    for d in streamed_digits(model, stream):
        tendons = model.digit_tendons[d]
        state.tendon[s.TENSION_TARGET, tendons] = goal_tension[tendons]
        state.tendon[s.TENSION_SETPOINT_STEP, tendons] = np.minimum(
            np.abs(goal_tension - setpoint)[tendons] / ticks, step
        )
    is_streamed = np.array([name in stream.names for name in model.hand.tendon_names])
    return stream.space == "tension" and bool(
        (np.abs(limited_tensions - goal_tensions) > CLIP_TOLERANCE)[is_streamed].any()
    )


def _begin_segment(
    model: HandModel,
    state: ControllerState,
    stream: StreamPlan,
    target_values: Vector,
    sent_ns: int,
    t_ns: int,
) -> bool:
    """Begin to move the motion references to the values of a target.

    Return True if the values were clipped.

    Args:
        model: model of the hand.
        state: state of the tick, modified in place.
        stream: stream of the target.
        target_values: (V,) values of the target.
        sent_ns: time at which the client sent the target [ns].
        t_ns: time of the tick [ns].
    """
    rows = state.layout.table(state.block, "coordinate")
    mapping = mapping_of_stream(model, stream.space, stream.names)
    goal_coordinates = np.where(
        mapping.is_streamed, mapping.matrix @ target_values, rows[s.STREAM_TARGET]
    )
    held_coordinates = goal_coordinates
    if mapping.digits_not_fully_holdable:
        held_coordinates = np.clip(goal_coordinates, *model.coordinate_limits)
        for d in mapping.digits_not_fully_holdable:
            digit = model.digits[d]
            coordinate_slice = model.digit_coordinates[d]
            held_coordinates[coordinate_slice] = nearest_holdable_posture(
                digit, held_coordinates[coordinate_slice], model.floor[digit.tendons]
            )
    # The motion starts at the reference of the last tick, so the reference already moves in the
    # present tick.
    start_time = t_ns / 1e9 - model.period * (1 + state.run_integers[s.MISSED_TICKS])
    duration = max(sent_ns / 1e9 + stream.horizon - start_time, model.period)
    target_interval = (sent_ns - state.run_integers[s.STREAM_SENT_NS]) / 1e9
    is_steady = (
        state.run_integers[s.STREAM_STATE] == s.RUNNING_STREAM
        and target_interval <= MAX_TARGET_INTERVAL_PERIODS * stream.period
    )
    # The time between two targets that arrive together is unrelated to the rate of the stream. The
    # time between two targets counts as at least half a period of the stream.
    target_interval = max(target_interval, 0.5 * stream.period) if is_steady else math.inf
    return streamed_motion.begin_segments(
        state.block, state.layout.offsets, goal_coordinates, held_coordinates, start_time, duration, target_interval,
        math.radians(model.hand.stream.speed_deg_s), int(stream.interpolation == "minimum_jerk"),
    )  # fmt: skip


def _count_target(
    state: ControllerState, counter_row: int, event_text: str = ""
) -> tuple[TickEvent, ...]:
    """Add one to a counter of targets, an integer in the table ``run_int`` of the state.

    If ``event_text`` is not empty and the counter becomes 1, return an event with this text.
    """
    count = state.run_integers[counter_row] + 1
    state.run_integers[counter_row] = count
    return (TickEvent("info", "stream", "", event_text),) if event_text and count == 1 else ()


def stream_status(state: ControllerState) -> StreamStatus:
    """Return the status of the open stream of targets."""
    if state.decisions.stream is None:
        return _EMPTY_STREAM_STATUS
    is_running = state.run_integers[s.STREAM_STATE] == s.RUNNING_STREAM
    age_s = (
        (state.run_integers[s.TICK_TIME_NS] - state.run_integers[s.STREAM_SENT_NS]) / 1e9
        if is_running
        else math.nan
    )
    rows = (
        s.ACCEPTED_TARGET_COUNT,
        s.CLIPPED_TARGET_COUNT,
        s.LATE_TARGET_COUNT,
        s.REFUSED_TARGET_COUNT,
        s.LIMITED_COORDINATE_COUNT,
    )
    return StreamStatus(
        state.run_integers[s.STREAM_SEQUENCE],
        age_s,
        *[state.run_integers[row] for row in rows],
    )


_EMPTY_STREAM_STATUS = StreamStatus()
