"""Execution of the controller on the inputs in a log.

The differences between the computed outputs and the logged outputs are counted.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np

from handctl.controller.controller_state import ControllerState
from handctl.controller.state_snapshot import restore_state
from handctl.controller.tick import Controller
from handctl.core.gains.gains import Gains
from handctl.core.tick_types import TickIn, TickOut
from handctl.errors import LogError
from handctl.log.code_identity import code_identity
from handctl.log.read.reader import RunLog
from handctl.log.tick_record import TickRecord
from handctl.replay.controller_rebuild import rebuild_controller
from handctl.replay.tick_difference import (
    TelemetryColumns,
    TickDifference,
    are_decisions_equal,
    are_outputs_equal,
    differing_fields,
    state_difference,
)

TICKS_PER_PROGRESS_REPORT = 200
"""Number of ticks between two progress reports."""

TickObserver = Callable[[TickIn, TickOut], None]
ProgressCallback = Callable[[int], None]


def count_progress(report: Callable[[int], None], tick_count: int = 0) -> ProgressCallback:
    """Return a progress function that adds up the executed ticks, and reports their sum.

    Args:
        report: function called with the number of all ticks executed so far.
        tick_count: number of ticks that have been executed before.
    """

    def add_ticks(ticks: int) -> None:
        nonlocal tick_count
        tick_count += ticks
        report(tick_count)

    return add_ticks


def relative_error(difference: TickDifference) -> float:
    """Return the error of a computed value compared with the logged value.

    If the magnitude of the logged number is below 1, the error is the absolute difference. If the
    magnitude of the logged number is 1 or more, the error is the relative difference.

    Returns:
        the error: 0 for texts, and infinity if a number is NaN.
    """
    logged_value = difference.logged
    computed = difference.computed
    if isinstance(logged_value, str) or isinstance(computed, str):
        return 0.0
    distance = abs(logged_value - computed)
    return math.inf if math.isnan(distance) else distance / max(1.0, abs(logged_value))


@dataclass(slots=True)
class DifferenceTally:
    """Counts of the differences that were found so far between the computed and the logged outputs.

    The docstring of LogExecution explains the attributes of this class.
    """

    ticks: int = 0
    differing_ticks: int = 0
    different_decisions: int = 0
    first_difference: TickDifference | None = None
    first_state_difference: TickDifference | None = None
    largest_difference: TickDifference | None = None

    def merged_with_later_tally(self, later_tally: "DifferenceTally") -> "DifferenceTally":
        """Add the tally of a later part of the log to this tally, and return the sum."""
        merged_tally = DifferenceTally(
            self.ticks + later_tally.ticks,
            self.differing_ticks + later_tally.differing_ticks,
            self.different_decisions + later_tally.different_decisions,
            self.first_difference or later_tally.first_difference,
            self.first_state_difference or later_tally.first_state_difference,
            self.largest_difference,
        )
        merged_tally._update_largest_difference(later_tally.largest_difference)
        return merged_tally

    def add_tick(self, tick_differences: list[TickDifference], has_equal_decisions: bool) -> None:
        """Add the differences between one logged tick and the computed tick to the tally.

        Args:
            tick_differences: the differences between the logged and the computed tick.
            has_equal_decisions: True if the logged and the computed tick contain the same decisions.
        """
        self.differing_ticks += 1
        self.different_decisions += not has_equal_decisions
        self.first_difference = self.first_difference or tick_differences[0]
        for difference in tick_differences:
            if difference.ulps is not None:
                self._update_largest_difference(difference)

    def _update_largest_difference(self, new_difference: TickDifference | None) -> None:
        """Store the new difference if it is larger than the largest difference so far."""
        if new_difference and (
            self.largest_difference is None
            or relative_error(new_difference) > relative_error(self.largest_difference)
        ):
            self.largest_difference = new_difference


class LogPart(NamedTuple):
    """Part of a log: the ticks from index `start` to `stop` - 1.

    The attribute `state` is the controller's state before the first tick of the part.
    """

    start: int
    stop: int
    state: ControllerState


@dataclass(frozen=True, slots=True)
class LogRunner:
    """A log, and the controller that is executed on the inputs in the log.

    Attributes:
        log: log of the run.
        controller: controller that was rebuilt from the log.
        telemetry_columns: names of the telemetry columns in the log.
        snapshots: snapshots of the controller's state in the log, by tick number.
        compares_states: True if the hash of the state is compared in each tick. It is False if
            another version of handctl wrote the log, and this version cannot read the states of
            that version.
    """

    log: RunLog
    controller: Controller
    telemetry_columns: TelemetryColumns
    snapshots: Mapping[int, bytes]
    compares_states: bool = True

    @staticmethod
    def from_log(log: RunLog, gains: Gains | None = None) -> "LogRunner":
        """Rebuild the controller of a logged run, with the gains from the log or with the given gains.

        The function raises the errors of `rebuild_controller`.
        """
        # With other gains, the states of the controller differ from the snapshots in the log. If
        # other gains are given, the snapshots are not used.
        snapshots: Mapping[int, bytes] = {} if gains else log.snapshots
        controller = rebuild_controller(log, gains)
        return LogRunner(
            log,
            controller,
            TelemetryColumns.from_header(log.header),
            snapshots,
            _has_comparable_states(log, controller),
        )

    def starts_after_snapshots(self) -> list[int]:
        """Return the indices of all ticks that follow a tick with a snapshot of the state, in ascending order."""
        k = self.log.k
        snapshot_ticks = np.array(sorted(self.snapshots), np.int64)
        at = np.searchsorted(k, snapshot_ticks)
        return [
            int(index) + 1
            for index, tick in zip(at, snapshot_ticks, strict=True)
            if index < len(k) - 1 and k[index] == tick
        ]

    def state_before_tick(self, tick_index: int) -> ControllerState | None:
        """Return the controller's state before a tick, from the snapshot in the log.

        Args:
            tick_index: one of the indices from `starts_after_snapshots`.

        Returns:
            the state, or None if this version cannot read the snapshot, or if the hash of the state
            differs from the logged hash.
        """
        layout = self.controller.derived_constants.layout
        try:
            state = restore_state(layout, self.snapshots[int(self.log.k[tick_index - 1])])
        except ValueError:
            return None
        logged_hash = self.log.state_hash[tick_index - 1].tobytes()
        return state if state.digest() == logged_hash else None

    def part_of_time_range(self, from_s: float, until_s: float) -> LogPart:
        """Return the part of the log between two times.

        The part begins at the last snapshot before `from_s` from which the controller can start. If
        there is no such snapshot, the part begins at the first tick of the log.

        Args:
            from_s: time at which the part must have begun [s of the run].
            until_s: end of the part [s of the run].
        """
        first_tick, stop = np.searchsorted(self.log.times, (from_s, until_s)).tolist()
        stop = max(first_tick, stop)
        starts = [start for start in self.starts_after_snapshots() if start <= first_tick]
        for start in reversed(starts):
            if (state := self.state_before_tick(start)) is not None:
                return LogPart(start, stop, state)
        return LogPart(0, stop, self.controller.initial_state())

    def execute_log_part(
        self,
        first_tick: int,
        tick_end: int,
        state: ControllerState,
        observer: TickObserver | None,
        progress: ProgressCallback | None,
    ) -> tuple[ControllerState, DifferenceTally]:
        """Execute the controller on the inputs of a part of the log.

        Args:
            first_tick: index of the first tick of the part.
            tick_end: index after the last tick of the part.
            state: state of the controller before the first tick.
            observer: function called with the input and the output of every tick.
            progress: function called at intervals with the number of ticks executed since the last
                call.

        Returns:
            the controller's state after the last tick of the part, and the counted differences.

        Raises:
            LogError: the log is damaged, or the controller refuses an input in the log.
        """
        return self.execute_ticks(
            self.logged_ticks(first_tick, tick_end), state, observer, progress
        )

    def execute_ticks(
        self,
        logged_ticks: Iterable[tuple[TickRecord, bytes]],
        state: ControllerState,
        observer: TickObserver | None,
        progress: ProgressCallback | None,
    ) -> tuple[ControllerState, DifferenceTally]:
        """Execute the controller on the inputs of consecutive ticks, see `execute_log_part`.

        Args:
            logged_ticks: ticks from `logged_ticks`.
            state: state of the controller before the first tick.
            observer: function called with the input and the output of every tick.
            progress: function called at intervals with the number of ticks executed since the last
                call.
        """
        difference_tally = DifferenceTally()
        tick = self.controller.tick
        compares_states = self.compares_states
        for logged_tick, numbers in logged_ticks:
            try:
                state, tick_output = tick(state, logged_tick.tick_in)
            except ValueError as error:
                raise refusal_error(error, logged_tick.tick_in.k) from None
            difference_tally.ticks += 1
            if progress and difference_tally.ticks % TICKS_PER_PROGRESS_REPORT == 0:
                progress(TICKS_PER_PROGRESS_REPORT)
            if observer:
                observer(logged_tick.tick_in, tick_output)
            if not are_outputs_equal(logged_tick, numbers, tick_output, compares_states):
                difference_tally.add_tick(
                    list(
                        differing_fields(
                            self.telemetry_columns,
                            logged_tick,
                            numbers,
                            tick_output,
                            compares_states,
                        )
                    ),
                    are_decisions_equal(logged_tick, tick_output),
                )
                if (
                    difference_tally.first_state_difference is None
                    and logged_tick.tick_in.k in self.snapshots
                ):
                    difference_tally.first_state_difference = self._state_difference(
                        logged_tick, state
                    )
        return state, difference_tally

    def logged_ticks(self, first_tick: int, tick_end: int) -> Iterator[tuple[TickRecord, bytes]]:
        """Yield the logged ticks from index `first_tick` to `tick_end` - 1, each with its telemetry."""
        chunk_starts = self.log.first_tick_of_chunk
        # A chunk of the log is always read as a whole. The ticks of a chunk that do not belong to
        # the requested part of the log are dropped below.
        chunk, last_chunk = np.searchsorted(chunk_starts, (first_tick, tick_end), side="right") - 1
        chunks = slice(int(chunk), int(last_chunk) + 1)
        ticks_and_telemetry = zip(
            self.log.ticks(chunks), self.log.packed_telemetry(chunks), strict=True
        )
        return islice(
            ticks_and_telemetry,
            first_tick - int(chunk_starts[chunk]),
            tick_end - int(chunk_starts[chunk]),
        )

    def _state_difference(
        self, logged_tick: TickRecord, state: ControllerState
    ) -> TickDifference | None:
        """Compare the controller's state after a tick with the snapshot in the log, and return the first difference."""
        try:
            snapshot_state = restore_state(
                self.controller.derived_constants.layout, self.snapshots[logged_tick.tick_in.k]
            )
        except ValueError:
            return None  # the snapshot is damaged, or is a state of another version
        return state_difference(self.log.header, logged_tick, snapshot_state, state)


def _has_comparable_states(log: RunLog, controller: Controller) -> bool:
    """Return True if the states of the logged controller have the same fields as the states of this version.

    If another version wrote the log, the first snapshot in the log shows the fields of its states.
    In a log without snapshots, the hash of the first state must equal the hash of the computed
    state.
    """
    if log.header.metadata.get("code") == code_identity():
        return True
    try:
        if log.snapshots:
            first_snapshot = next(iter(log.snapshots.values()))
            restore_state(controller.derived_constants.layout, first_snapshot)
        elif (first_tick := next(log.ticks(), None)) is not None:
            _, tick_output = controller.tick(controller.initial_state(), first_tick.tick_in)
            return first_tick.state_hash == tick_output.state_hash
    except ValueError:
        # The snapshot is from another version, or the controller refuses the first tick. In the
        # latter case, the re-execution reports the refusal.
        return False
    return True


def refusal_error(error: ValueError, k: int) -> LogError:
    """Return the exception for a log in which the controller refuses the inputs of tick `k`."""
    return LogError(f"the controller refuses: {error}", f"tick {k}", "a value that fits")
