"""State of a controller: a block of numbers, and decisions other than numbers."""

from typing import Any, NamedTuple

import numpy as np
import xxhash
from numpy.typing import NDArray

from handctl.controller.pending_gains import PendingGains
from handctl.core import block as s
from handctl.core.block import STATE
from handctl.core.estimate import Estimate, Measured
from handctl.core.gains.gains import Gains
from handctl.core.kept import Kept
from handctl.core.model import HandModel
from handctl.core.plain import plain_bytes
from handctl.core.schema import Block, Layout
from handctl.core.types import Mode
from handctl.drives.contract import DriveState, Phase
from handctl.programs.program import Progress
from handctl.programs.streams import StreamPlan
from handctl.safety.judge import Counting, Latched


class Decisions(NamedTuple):
    """State outside the block, changed by events, not in every tick.

    Attributes:
        drives: set-up of each drive. The values of a drive are in the block, and NaN or 0 here.
        progress: of the program.
        latched: latched faults.
        counting: faults reported by buses and host, with consecutive ticks.
        refusals: ticks of the last second with a malformed request.
        failure: reason of an early end of the run, a line. Empty without failure.
        unconfirmed: motors without a confirmed disable.
        gains: replacement of the gains at the start. None before a change.
        pending: requested gains in design.
        commander: client that commands, see ``requests.CommandBase``. None: any client may.
        stream: open stream of targets.
    """

    drives: tuple[DriveState, ...]
    progress: Progress
    latched: tuple[Latched, ...] = ()
    counting: tuple[Counting, ...] = ()
    refusals: tuple[int, ...] = ()
    failure: str = ""
    unconfirmed: tuple[str, ...] = ()
    gains: Gains | None = None
    pending: PendingGains | None = None
    commander: str | None = None
    stream: StreamPlan | None = None


# Serialized parts by identity: most decisions are the same objects from tick to tick.
_parts = Kept[Any](plain_bytes)


def _decided(decisions: Decisions) -> bytes:
    """Hash the decisions to 8 bytes. Only a new object is serialized again."""
    drives = b"".join([_parts(drive) for drive in decisions.drives])
    goals = b"".join([_parts(goal) for goal in decisions.progress.goals])
    rest = [_parts(part) for part in decisions[1:]]
    return xxhash.xxh3_64_digest(b"".join([drives, goals, *rest]))


_decisions = Kept[Decisions](_decided)


def layout_of(model: HandModel, groups: int) -> Layout:
    """Return the layout of a hand's state.

    Args:
        model: the hand.
        groups: number of frame groups of the sensor node.
    """
    n = model.tendon_count
    joints = len(model.hand.joints)
    return Layout(STATE, {
        "tendon": n,
        "joint": joints,
        "digit": len(model.digits),
        "coordinate": model.coordinate_count,
        "node": n + 1,
        "group": groups,
        "instance": max(n + 1, joints),
        "run": 1,
    })  # fmt: skip


def drive_values(
    tendon: NDArray[np.float64], tendon_int: NDArray[np.int64], n: int
) -> tuple[float, float, float, float, int, int]:
    """Return the block's values of a drive, as arguments of ``DriveState.with_values``."""
    position, velocity, torque, temperature = tendon[s.POSITION : s.POSITION + 4, n].tolist()
    return position, velocity, torque, temperature, int(tendon_int[s.FEEDBACK_NS, n]), int(tendon_int[s.FEEDBACKS, n])


class State:
    """State between ticks.

    A tick works on a copy. The block is copied as a whole. Decisions are immutable and shared.

    Attributes:
        layout: of the block.
        block: see ``core.block``.
        decisions: see ``Decisions``.
        tendon: (rows, N) table of real numbers in the block.
        tendon_int: (rows, N) table of integers in the block.
    """

    __slots__ = ("_run", "_run_int", "block", "decisions", "layout", "tendon", "tendon_int")

    def __init__(self, layout: Layout, block: Block, decisions: Decisions) -> None:
        """Make views of the tables in a block.

        Args:
            layout: of the block.
            block: numbers of the state, not copied.
            decisions: see ``Decisions``.
        """
        self.layout = layout
        self.block = block
        self.decisions = decisions
        self.tendon: NDArray[np.float64] = layout.table(block, "tendon")
        self.tendon_int: NDArray[np.int64] = layout.table(block, "tendon_int")
        # "run" has one column, so a row number is directly the position.
        self._run = block[layout.start("run") :]
        self._run_int = block[layout.start("run_int") :].view(np.int64)

    def copy(self) -> "State":
        """Return an independent copy."""
        return State(self.layout, self.block.copy(), self.decisions)

    def decide(self, **changes: Any) -> None:
        """Replace some of the decisions."""
        self.decisions = self.decisions._replace(**changes)

    def digest(self) -> bytes:
        """Return a hash of 8 bytes over the whole state."""
        return xxhash.xxh3_64_digest(self.block.data, int.from_bytes(_decisions(self.decisions), "little"))

    # Tables and single numbers of the block.

    def view(self, name: str) -> NDArray[Any]:
        """Return a field of the block by name."""
        return self.layout.view(self.block, name)

    def number(self, row: int) -> float:
        """Return a real number of the run."""
        return float(self._run[row])

    def set_number(self, row: int, value: float) -> None:
        """Set a real number of the run."""
        self._run[row] = value

    def whole(self, row: int) -> int:
        """Return an integer of the run."""
        return int(self._run_int[row])

    def set_whole(self, row: int, value: int) -> None:
        """Set an integer of the run."""
        self._run_int[row] = value

    @property
    def k(self) -> int:
        """Number of the last tick; -1 before the first."""
        return self.whole(s.K)

    @property
    def mode(self) -> Mode:
        """Return the mode of the hand."""
        return _MODES[self.whole(s.MODE)]

    @mode.setter
    def mode(self, mode: Mode) -> None:
        self.set_whole(s.MODE, mode)

    @property
    def mode_since(self) -> float:
        """Return the start of the mode [s]."""
        return self.number(s.MODE_SINCE)

    @mode_since.setter
    def mode_since(self, t: float) -> None:
        self.set_number(s.MODE_SINCE, t)

    @property
    def goal_time(self) -> float:
        """Return the program's time [s], stopped while safety holds the hand."""
        return self.number(s.GOAL_TIME)

    @goal_time.setter
    def goal_time(self, t: float) -> None:
        self.set_number(s.GOAL_TIME, t)

    @property
    def armed(self) -> bool:
        """Return True if arming is requested."""
        return bool(self.whole(s.ARMED))

    @armed.setter
    def armed(self, armed: bool) -> None:
        self.set_whole(s.ARMED, armed)

    @property
    def clearing(self) -> bool:
        """Return True while latched errors of the drives are being cleared, before arming."""
        return bool(self.whole(s.CLEARING))

    @clearing.setter
    def clearing(self, clearing: bool) -> None:
        self.set_whole(s.CLEARING, clearing)

    @property
    def started(self) -> bool:
        """Return True if encoder and load cell of every tendon have been read once."""
        return bool(self.whole(s.STARTED))

    @property
    def estimate(self) -> Estimate:
        """Return the present estimates, for programs."""
        layout = self.layout
        block = self.block
        joint = layout.table(block, "joint")
        digit = layout.table(block, "digit")
        return Estimate(self.tendon, joint, digit, self.tendon_int[s.REGIME])

    @property
    def measured(self) -> Measured:
        """Return the measurements of the tick."""
        return Measured(self.tendon, self.layout.table(self.block, "joint"))

    @property
    def sensor_counts(self) -> tuple[int, int, int]:
        """Count SYNCs sent, accepted tension frames, and frames in reply to an older SYNC."""
        return self.whole(s.SYNCS), self.whole(s.TENSION_FRAMES), self.whole(s.STALE)

    # Decisions by their names.

    @property
    def progress(self) -> Progress:
        """Return the progress of the program."""
        return self.decisions.progress

    @property
    def latched(self) -> tuple[Latched, ...]:
        """Return the latched faults."""
        return self.decisions.latched

    @property
    def failure(self) -> str:
        """Return the reason of an early end of the run, one line. Empty without failure."""
        return self.decisions.failure

    @property
    def unconfirmed(self) -> tuple[str, ...]:
        """Return the motors without a confirmed disable."""
        return self.decisions.unconfirmed

    # Drives: set-up from the decisions, values from the block.

    def drive(self, n: int) -> DriveState:
        """Return a drive's state."""
        return self.decisions.drives[n].with_values(*drive_values(self.tendon, self.tendon_int, n))

    @property
    def drives(self) -> tuple[DriveState, ...]:
        """Return the states of all drives."""
        return tuple([self.drive(n) for n in range(len(self.decisions.drives))])

    @property
    def phases(self) -> tuple[Phase, ...]:
        """Return the phase of each drive."""
        return tuple([drive.phase for drive in self.decisions.drives])


_MODES = {int(mode): mode for mode in Mode}
