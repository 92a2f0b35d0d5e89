"""Execution of the controller on the inputs of a log, with a tally of the differences."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

import numpy as np

from handctl.controller.snapshot import restore
from handctl.controller.state import State
from handctl.controller.tick import Controller
from handctl.core.gains.gains import Gains
from handctl.core.types import TickIn, TickOut
from handctl.errors import LogError
from handctl.log.read.reader import RunLog
from handctl.log.record import TickRecord
from handctl.replay.difference import Columns, Difference, differences, of_states, same, same_decisions
from handctl.replay.rebuild import rebuild

TOLD = 200
"""Ticks between two reports of progress."""

Watch = Callable[[TickIn, TickOut], None]
Told = Callable[[int], None]


def distance(difference: Difference) -> float:
    """Compute the size of a numeric difference: absolute below 1, relative above.

    Returns:
        0 for texts, infinity if one of the numbers is NaN.
    """
    was = difference.logged
    now = difference.computed
    if isinstance(was, str) or isinstance(now, str):
        return 0.0
    apart = abs(was - now)
    return math.inf if math.isnan(apart) else apart / max(1.0, abs(was))


@dataclass(slots=True)
class Tally:
    """Differences found so far, see Execution."""

    ticks: int = 0
    differing: int = 0
    undecided: int = 0
    first: Difference | None = None
    state: Difference | None = None
    largest: Difference | None = None

    def with_later(self, later: "Tally") -> "Tally":
        """Return the sum of this tally and the tally of a later part of the log."""
        both = Tally(
            self.ticks + later.ticks,
            self.differing + later.differing,
            self.undecided + later.undecided,
            self.first or later.first,
            self.state or later.state,
            self.largest,
        )
        both._larger(later.largest)
        return both

    def see(self, found: list[Difference], decided: bool) -> None:
        """Add the differences of one tick.

        Args:
            found: the differences.
            decided: True if the decisions are equal.
        """
        self.differing += 1
        self.undecided += not decided
        self.first = self.first or found[0]
        for one in found:
            if one.ulps is not None:
                self._larger(one)

    def _larger(self, other: Difference | None) -> None:
        """Keep the larger of two numeric differences."""
        if other and (self.largest is None or distance(other) > distance(self.largest)):
            self.largest = other


@dataclass(frozen=True, slots=True)
class Course:
    """A log and its controller.

    Attributes:
        log: a run.
        controller: controller of the log.
        columns: names of the telemetry columns.
        snapshots: snapshots of the log by tick.
    """

    log: RunLog
    controller: Controller
    columns: Columns
    snapshots: Mapping[int, bytes]

    @staticmethod
    def of(log: RunLog, gains: Gains | None = None) -> "Course":
        """Create the controller of a log, with its own or other gains. Raises as `rebuild`."""
        # With other gains the states differ from those of the log.
        snapshots: Mapping[int, bytes] = {} if gains else log.snapshots
        return Course(log, rebuild(log, gains), Columns.of(log.header), snapshots)

    def run(self, start: int, stop: int, state: State, watch: Watch | None, told: Told | None) -> tuple[State, Tally]:
        """Execute a part of the log.

        Args:
            start: index of the first tick.
            stop: index behind the last tick.
            state: state before the first tick.
            watch: called with every tick.
            told: called now and then with the number of further ticks.

        Returns:
            State after the last tick, and the differences.

        Raises:
            LogError: the log is damaged, or the controller refuses an input.
        """
        tally = Tally()
        tick = self.controller.tick
        for logged, numbers in self._logged(start, stop):
            try:
                state, out = tick(state, logged.tick_in)
            except ValueError as error:
                raise refusal(error, logged.tick_in.k) from None
            tally.ticks += 1
            if told and tally.ticks % TOLD == 0:
                told(TOLD)
            if watch:
                watch(logged.tick_in, out)
            if not same(logged, numbers, out):
                tally.see(list(differences(self.columns, logged, numbers, out)), same_decisions(logged, out))
                if tally.state is None and logged.tick_in.k in self.snapshots:
                    tally.state = self._of_state(logged, state)
        return state, tally

    def _logged(self, start: int, stop: int) -> Iterator[tuple[TickRecord, bytes]]:
        """Yield the ticks from one index to another, each with its telemetry."""
        firsts = self.log.first_of_chunk
        # Chunks are read as a whole. The surplus ticks at both ends are cut off below.
        chunk, last = np.searchsorted(firsts, (start, stop), side="right") - 1
        chunks = slice(int(chunk), int(last) + 1)
        both = zip(self.log.ticks(chunks), self.log.packed(chunks), strict=True)
        return islice(both, start - int(firsts[chunk]), stop - int(firsts[chunk]))

    def _of_state(self, logged: TickRecord, state: State) -> Difference | None:
        """Compare the state after a tick with the snapshot in the log."""
        try:
            was = restore(self.controller.layout, self.snapshots[logged.tick_in.k])
        except ValueError:
            return None  # of a version whose states have other fields
        return of_states(self.log.header, logged, was, state)


def refusal(error: ValueError, k: int) -> LogError:
    """Return the error of a controller that refuses a tick."""
    return LogError(f"the controller refuses: {error}", f"tick {k}", "a value that fits")
