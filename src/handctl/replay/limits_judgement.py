"""Judgement of a recorded run by new safety limits.

The judgement lists the ticks in which the new limits would have stopped the hand. For each listed
tick, the judgement gives the reading that exceeds the limit.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import Field

from handctl.controller.tick import Controller
from handctl.core.tick_types import TickEvent
from handctl.document import Document, load_document
from handctl.errors import ConfigError
from handctl.log.read.reader import RunLog
from handctl.replay.controller_rebuild import rebuild_controller
from handctl.replay.log_execution import gc_disabled
from handctl.replay.log_runner import TICKS_PER_PROGRESS_REPORT, refusal_error
from handctl.safety.faults.table import FAULT_BY_ID
from handctl.safety.safety_action import SafetyAction
from handctl.safety.safety_limits import (
    MIN_SILENT_TICKS,
    MIN_STALLED_TICKS,
    SafetyLimits,
    tick_count_for_time,
)

TensionLimit = Annotated[float, Field(gt=0, le=1000)]


class LimitsFile(Document):
    """Content of a limits file.

    If the limits file does not contain a limit, the value from the run applies.
    """

    schema_: int = Field(1, alias="schema", ge=1, le=1)
    tension_trip_N: TensionLimit | dict[str, TensionLimit] | None = None
    """Tension limit, either one for all tendons or one for each tendon by name [N]."""
    silent_ms: float | None = Field(None, gt=0, le=10_000)
    stalled_ms: float | None = Field(None, gt=0, le=10_000)
    temperature_soft_degC: float | None = Field(None, gt=0, le=200)
    temperature_hard_degC: float | None = Field(None, gt=0, le=200)


class StoppingFault(NamedTuple):
    """Fault that would stop the hand with the new limits.

    Attributes:
        k, t_s: number and time [s] of the tick in which the fault occurs.
        fault, title: id and title of the fault.
        instance: motor, tendon or bus that has the fault.
        value: reading that exceeds the limit, in the unit of the limit.
        action: reaction to the fault.
        occurs_in_logged_run: True if the fault also occurred in the same tick of the recorded run,
            with the limits of the recorded run.
    """

    k: int
    t_s: float
    fault: str
    title: str
    instance: str
    value: float
    action: str
    occurs_in_logged_run: bool


@dataclass(frozen=True, slots=True)
class LimitsJudgement:
    """Effect of new limits on a recorded run.

    Attributes:
        ticks: number of judged ticks.
        stopped_tick_count: number of ticks in which the new limits demand HOLD or a more severe reaction.
        ticks_stopped_by_old_limits: number of ticks in which the limits of the recorded run
            demanded HOLD or a more severe reaction.
        stopping_faults: the fault with which each stop of the hand begins, in order.
        stop_count_by_fault: number of stops of the hand for each fault, by the id of the fault.
    """

    ticks: int
    stopped_tick_count: int
    ticks_stopped_by_old_limits: int
    stopping_faults: tuple[StoppingFault, ...]
    stop_count_by_fault: dict[str, int]


def load_limits(path: Path, controller: Controller) -> SafetyLimits:
    """Return the limits of a controller, with the values of a limits file in place of the old values.

    Raises:
        ConfigError: the file cannot be read or names a tendon that the hand does not have.
    """
    new_limits = load_document(path, LimitsFile)
    old_limits = controller.derived_constants.limits
    period = controller.model.period
    trip_by_tendon = (
        new_limits.tension_trip_N if isinstance(new_limits.tension_trip_N, dict) else {}
    )
    for name in trip_by_tendon.keys() - set(old_limits.tendons):
        raise ConfigError(
            repr(name), f"{path}: tension_trip_N", "one of " + ", ".join(old_limits.tendons)
        )
    rows = zip(old_limits.tendons, old_limits.tension_trip, strict=True)
    tension_trip = tuple(trip_by_tendon.get(name, old_trip) for name, old_trip in rows)
    if isinstance(new_limits.tension_trip_N, float):
        tension_trip = (new_limits.tension_trip_N,) * len(tension_trip)
    max_silence_ms = new_limits.silent_ms
    max_stall_ms = new_limits.stalled_ms
    soft_limit_degC = new_limits.temperature_soft_degC
    hard_limit_degC = new_limits.temperature_hard_degC
    return replace(
        old_limits,
        tension_trip=tension_trip,
        silent_ticks=tick_count_for_time(max_silence_ms / 1e3, period, MIN_SILENT_TICKS)
        if max_silence_ms
        else old_limits.silent_ticks,
        silent_ticks_of_single_motor=tick_count_for_time(
            max_silence_ms / 1e3, period, MIN_SILENT_TICKS
        )
        if max_silence_ms
        else old_limits.silent_ticks_of_single_motor,
        stalled_ticks=tick_count_for_time(max_stall_ms / 1e3, period, MIN_STALLED_TICKS)
        if max_stall_ms
        else old_limits.stalled_ticks,
        temperature_soft=soft_limit_degC or old_limits.temperature_soft,
        temperature_hard=hard_limit_degC or old_limits.temperature_hard,
    )


def judge_by_limits(
    log: RunLog, path: Path, progress: Callable[[int], None] | None = None
) -> LimitsJudgement:
    """Judge every tick of a run by new safety limits, and return the effect of these limits.

    The log itself is not changed.

    Args:
        log: log of the run.
        path: limits file.
        progress: function called at intervals with the number of ticks judged so far.

    Raises:
        ConfigError: the limits file is wrong.
        LogError: the controller cannot be executed on the log.
    """
    controller = rebuild_controller(log)
    limits = load_limits(path, controller)
    with gc_disabled():
        return _judge_ticks(log, controller, limits, progress)


def _judge_ticks(
    log: RunLog,
    controller: Controller,
    limits: SafetyLimits,
    progress: Callable[[int], None] | None,
) -> LimitsJudgement:
    """Judge each tick with the new limits.

    The judgement of a tick starts from the logged state of the controller. Only the debounce
    counters and the latched faults are carried from tick to tick under the new limits.
    """
    controller_with_new_limits = replace(controller, replacement_limits=limits)
    state = controller.initial_state()
    state_with_new_limits = controller_with_new_limits.initial_state()
    limit_stops: list[StoppingFault] = []
    ticks = stopped_ticks = ticks_stopped_by_old_limits = 0
    for logged_tick in log.ticks():
        entry = logged_tick.tick_in
        # In every tick, the controller starts from the state that it had in the recorded run. Only
        # the debounce counters and latched faults that follow from the new limits are carried from
        # tick to tick.
        start_state = state.copy()
        start_state.view("fault_ticks")[...] = state_with_new_limits.view("fault_ticks")
        start_state.decide(
            latched_faults=state_with_new_limits.latched_faults,
            reported_faults=state_with_new_limits.decisions.reported_faults,
        )
        try:
            state_with_new_limits, verdict = controller_with_new_limits.tick(start_state, entry)
            state, tick_output = controller.tick(state, entry)
        except ValueError as error:
            raise refusal_error(error, entry.k) from None
        logged_faults = {
            _fault_id_in_text(event) + event.where
            for event in tick_output.events
            if event.name == "fault"
        }
        ticks += 1
        if progress and ticks % TICKS_PER_PROGRESS_REPORT == 0:
            progress(ticks)
        stopped_ticks += verdict.action >= SafetyAction.HOLD
        ticks_stopped_by_old_limits += tick_output.action >= SafetyAction.HOLD
        for event in verdict.events:
            if (
                event.name == "fault"
                and FAULT_BY_ID[_fault_id_in_text(event)].action >= SafetyAction.HOLD
            ):
                fault = FAULT_BY_ID[_fault_id_in_text(event)]
                t_s = entry.t_ns / 1e9
                # The text of a fault event ends with the reading in brackets.
                value = float(event.text.rpartition("(")[2].partition(")")[0])
                is_in_log = fault.id + event.where in logged_faults
                limit_stops.append(
                    StoppingFault(
                        entry.k,
                        t_s,
                        fault.id,
                        fault.title,
                        event.where,
                        value,
                        fault.action.name,
                        is_in_log,
                    )
                )
    counts = Counter(stop.fault for stop in limit_stops)
    return LimitsJudgement(
        ticks, stopped_ticks, ticks_stopped_by_old_limits, tuple(limit_stops), dict(counts)
    )


def _fault_id_in_text(event: TickEvent) -> str:
    """Return the fault id with which the text of an event begins."""
    return event.text.partition(" ")[0]
