"""The whole state of a controller: a block of numbers, and the decisions that are no numbers."""

from typing import Any, NamedTuple

import numpy as np
import xxhash
from numpy.typing import NDArray

from handctl.controller.coming import Coming
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
from handctl.safety.judge import Counting, Latched


class Decisions(NamedTuple):
    """What a tick hands to the next beside the block. It changes when something happens, not in every tick.

    Attributes:
        drives: set-up of each drive; its values are in the block, NaN and 0 here.
        progress: of the program.
        latched: faults that only an operator clears.
        counting: faults that are reported by buses and host, and for how many ticks in a row.
        refusals: ticks of the last second in which a live goal was refused.
        failure: why the run ends early, one line; empty if it does not.
        unconfirmed: motors that have not confirmed that they are disabled.
        gains: set since the start; None before.
        coming: gains that are requested and being designed.
    """

    drives: tuple[DriveState, ...]
    progress: Progress
    latched: tuple[Latched, ...] = ()
    counting: tuple[Counting, ...] = ()
    refusals: tuple[int, ...] = ()
    failure: str = ""
    unconfirmed: tuple[str, ...] = ()
    gains: Gains | None = None
    coming: Coming | None = None


_parts = Kept[Any](plain_bytes)


def _decided(decisions: Decisions) -> bytes:
    """Return 8 bytes that change with every decision; parts that are the same objects are not written again."""
    drives = b"".join([_parts(drive) for drive in decisions.drives])
    goals = b"".join([_parts(goal) for goal in decisions.progress.goals])
    rest = [_parts(part) for part in decisions[1:]]
    return xxhash.xxh3_64_digest(b"".join([drives, goals, *rest]))


_decisions = Kept[Decisions](_decided)


def layout_of(model: HandModel, groups: int) -> Layout:
    """Return the layout of a hand's state; ``groups``: frame groups of its sensor node."""
    n, joints = model.tendon_count, len(model.hand.joints)
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
    """Return what the block has of a drive, as ``DriveState.with_values`` takes it."""
    position, velocity, torque, temperature = tendon[s.POSITION : s.POSITION + 4, n].tolist()
    return position, velocity, torque, temperature, int(tendon_int[s.FEEDBACK_NS, n]), int(tendon_int[s.FEEDBACKS, n])


class State:
    """Everything that one tick hands to the next.

    A tick works on a copy: the block is copied as a whole, decisions are immutable and shared.

    Attributes:
        layout: of the block. block: see ``core.block``.
        decisions: see there.
        tendon, tendon_int: (rows, N) tables of the block.
    """

    __slots__ = ("_run", "_run_int", "block", "decisions", "layout", "tendon", "tendon_int")

    def __init__(self, layout: Layout, block: Block, decisions: Decisions) -> None:
        self.layout, self.block, self.decisions = layout, block, decisions
        self.tendon: NDArray[np.float64] = layout.table(block, "tendon")
        self.tendon_int: NDArray[np.int64] = layout.table(block, "tendon_int")
        self._run = block[layout.start("run") :]
        self._run_int = block[layout.start("run_int") :].view(np.int64)

    def copy(self) -> "State":
        """Return a state that can be changed without changing this one."""
        return State(self.layout, self.block.copy(), self.decisions)

    def decide(self, **changes: Any) -> None:
        """Change decisions."""
        self.decisions = self.decisions._replace(**changes)

    def digest(self) -> bytes:
        """Return 8 bytes that change with every part of the state."""
        return xxhash.xxh3_64_digest(self.block.data, int.from_bytes(_decisions(self.decisions), "little"))

    # Tables and single numbers of the block.

    def view(self, name: str) -> NDArray[Any]:
        """Return a field of the block by its name."""
        return self.layout.view(self.block, name)

    def number(self, row: int) -> float:
        """Return a real number of the run."""
        return float(self._run[row])

    def set_number(self, row: int, value: float) -> None:
        """Set a real number of the run."""
        self._run[row] = value

    def whole(self, row: int) -> int:
        """Return a whole number of the run."""
        return int(self._run_int[row])

    def set_whole(self, row: int, value: int) -> None:
        """Set a whole number of the run."""
        self._run_int[row] = value

    @property
    def k(self) -> int:
        """Number of the last tick; -1 before the first."""
        return self.whole(s.K)

    @property
    def mode(self) -> Mode:
        """Of the hand."""
        return _MODES[self.whole(s.MODE)]

    @mode.setter
    def mode(self, mode: Mode) -> None:
        self.set_whole(s.MODE, mode)

    @property
    def mode_since(self) -> float:
        """When the mode began [s]."""
        return self.number(s.MODE_SINCE)

    @mode_since.setter
    def mode_since(self, t: float) -> None:
        self.set_number(s.MODE_SINCE, t)

    @property
    def goal_time(self) -> float:
        """Time that the program was given [s]; stands still while safety holds."""
        return self.number(s.GOAL_TIME)

    @goal_time.setter
    def goal_time(self, t: float) -> None:
        self.set_number(s.GOAL_TIME, t)

    @property
    def armed(self) -> bool:
        """Whether arming is requested."""
        return bool(self.whole(s.ARMED))

    @armed.setter
    def armed(self, armed: bool) -> None:
        self.set_whole(s.ARMED, armed)

    @property
    def clearing(self) -> bool:
        """Whether what the drives have latched is being cleared, before they are armed."""
        return bool(self.whole(s.CLEARING))

    @clearing.setter
    def clearing(self, clearing: bool) -> None:
        self.set_whole(s.CLEARING, clearing)

    @property
    def started(self) -> bool:
        """Whether encoder and load cell of every tendon were read once."""
        return bool(self.whole(s.STARTED))

    @property
    def estimate(self) -> Estimate:
        """What programs read of the present instant."""
        layout, block = self.layout, self.block
        joint, digit = layout.table(block, "joint"), layout.table(block, "digit")
        return Estimate(self.tendon, joint, digit, self.tendon_int[s.REGIME])

    @property
    def measured(self) -> Measured:
        """Measurements of the present tick."""
        return Measured(self.tendon, self.layout.table(self.block, "joint"))

    @property
    def sensor_counts(self) -> tuple[int, int, int]:
        """SYNCs sent, tension frames accepted, and frames that answered an older SYNC."""
        return self.whole(s.SYNCS), self.whole(s.TENSION_FRAMES), self.whole(s.STALE)

    # Decisions by their names.

    @property
    def progress(self) -> Progress:
        """Of the program."""
        return self.decisions.progress

    @property
    def latched(self) -> tuple[Latched, ...]:
        """Faults that only an operator clears."""
        return self.decisions.latched

    @property
    def failure(self) -> str:
        """Why the run ends early, one line; empty if it does not."""
        return self.decisions.failure

    @property
    def unconfirmed(self) -> tuple[str, ...]:
        """Motors that have not confirmed that they are disabled."""
        return self.decisions.unconfirmed

    # Drives: set-up from the decisions, values from the block.

    def drive(self, n: int) -> DriveState:
        """Return what is known of a drive."""
        return self.decisions.drives[n].with_values(*drive_values(self.tendon, self.tendon_int, n))

    @property
    def drives(self) -> tuple[DriveState, ...]:
        """What is known of all drives."""
        return tuple([self.drive(n) for n in range(len(self.decisions.drives))])

    @property
    def phases(self) -> tuple[Phase, ...]:
        """Where each drive stands."""
        return tuple([drive.phase for drive in self.decisions.drives])


_MODES = {int(mode): mode for mode in Mode}
