"""State of a controller.

The state consists of a block of numbers, and of an object that contains the values that are not
numbers. The values in this object are called the decisions.
"""

from typing import Any, NamedTuple, cast

import numpy as np
import xxhash
from numpy.typing import NDArray

from handctl.controller.pending_gains import PendingGains
from handctl.core import state_block as s
from handctl.core import tick_stages
from handctl.core.block_schema import BlockArray, BlockLayout
from handctl.core.gains.gains import Gains
from handctl.core.hand_estimate import HandEstimate, TickMeasurements
from handctl.core.hand_model import HandModel
from handctl.core.identity_cache import IdentityCache, SequenceCache
from handctl.core.plain_data import (
    join_serialized_fields,
    join_serialized_items,
    logged_type_name,
    serialized_bytes,
)
from handctl.core.state_block import STATE_SCHEMA
from handctl.core.tick_types import HandMode
from handctl.drives.cia404.amplifier import AmplifierState
from handctl.drives.contract import DrivePhase, DriveState
from handctl.drives.frame import make_tuple
from handctl.drives.readback import RecheckCursor
from handctl.programs.program import ProgramProgress
from handctl.programs.stream_plans import StreamPlan
from handctl.safety.tick_verdict import LatchedFault, ReportedFault


class ClientLease(NamedTuple):
    """Lease of the client that commands the hand.

    The lease limits the time for which the client is allowed to be silent.

    Attributes:
        client: client that commands the hand.
        duration_ns: longest silence of the client until moving digits come to rest [ns]. If the
            silence lasts twice as long as ``duration_ns``, the hand relaxes.
        renewed_ns: time of the client's last command or sign of life [ns].
        is_at_rest: True if the digits have come to rest because of the silence that began at
            ``renewed_ns``.
    """

    client: str
    duration_ns: int
    renewed_ns: int
    is_at_rest: bool = False


class ControllerDecisions(NamedTuple):
    """Values in the controller's state that change only at events.

    The decisions are the values that are not in the state block.

    Attributes:
        drives: state of each drive, without the numbers. The numbers of the drives are in the state
            block. In the attribute ``drives``, the numbers are NaN or 0.
        progress: state of the program, with the point that the program has reached.
        latched_faults: faults that stay latched until an operator clears them.
        reported_faults: faults that buses and the host report, each with the number of consecutive
            ticks in which it was reported.
        refusals: ticks within the last second that contained a malformed request.
        failure: reason why the run has ended early, in one line. The text is empty if the run has
            not failed.
        unconfirmed_motors: names of motors whose drives have not confirmed that they are disabled.
        gains: gains that have replaced the gains of the start of the run. The value is None before
            the first change of gains.
        pending_gains: requested gains whose controller design is in progress.
        commanding_client: client that is allowed to send commands, or None if any client is
            allowed, see ``requests.CommandRequestBase``.
        stream: open stream of targets.
        lease: lease of the commanding client, or None for a client without a lease.
        amplifiers: state of each CiA 404 amplifier. The value is empty if the load cells have no
            CiA 404 amplifiers.
    """

    drives: tuple[DriveState, ...]
    progress: ProgramProgress
    latched_faults: tuple[LatchedFault, ...] = ()
    reported_faults: tuple[ReportedFault, ...] = ()
    refusals: tuple[int, ...] = ()
    failure: str = ""
    unconfirmed_motors: tuple[str, ...] = ()
    gains: Gains | None = None
    pending_gains: PendingGains | None = None
    commanding_client: str | None = None
    stream: StreamPlan | None = None
    lease: ClientLease | None = None
    amplifiers: tuple[AmplifierState, ...] = ()


def _serialized_part(state_part: object) -> bytes:
    """Serialize one part of the decisions of the controller.

    While a digit closes, the progress of the program changes in every tick. The progress keeps
    references to the same goal objects, so the bytes of the goals are cached.
    """
    if isinstance(state_part, ProgramProgress):
        return join_serialized_fields(state_part, _progress_field_cache)
    return serialized_bytes(state_part)


# Most decisions are the same objects in many ticks, so the serialized form of each part is cached
# by the identity of the object.
_progress_field_cache = SequenceCache[Any](serialized_bytes)
_serialized_bytes_cache = IdentityCache[Any, bytes](_serialized_part)
_drives_cache, _goals_cache, _other_parts_cache = (
    SequenceCache[Any](_serialized_bytes_cache) for _ in range(3)
)


def _hash_decisions(decisions: ControllerDecisions) -> int:
    """Return a hash of the decisions, an integer of 64 bits.

    If a part of the decisions has not changed since an earlier tick, the function takes the
    serialized bytes of this part from a cache.
    """
    drives = _drives_cache(decisions.drives)
    goals = _goals_cache(decisions.progress.goals)
    # For a hand without amplifiers, the hash equals the hash in logs of handctl versions that did
    # not support amplifiers.
    other_hashes = _other_parts_cache(decisions[1:] if decisions.amplifiers else decisions[1:-1])
    digest = xxhash.xxh3_64_digest(b"".join([*drives, *goals, *other_hashes]))
    return int.from_bytes(digest, "little")


_SERIALIZED_DECISIONS_TYPE = serialized_bytes(logged_type_name(ControllerDecisions))
_decision_hash_cache = IdentityCache[ControllerDecisions, int](_hash_decisions)


def serialized_decisions(decisions: ControllerDecisions) -> bytes:
    """Return ``serialized_bytes(decisions)``, joined from the bytes of its parts.

    If a part has not changed since an earlier tick, the function takes the bytes from a cache.
    """
    drives = join_serialized_items(_drives_cache(decisions.drives))
    other_parts = [_serialized_bytes_cache(part) for part in decisions[1:]]
    return join_serialized_items([_SERIALIZED_DECISIONS_TYPE, drives, *other_parts])


def layout_of_state(model: HandModel, group_count: int) -> BlockLayout:
    """Return the layout of the state block for a hand.

    Args:
        model: model of the hand.
        group_count: number of groups of frames of the sensor node.
    """
    n = model.tendon_count
    joints = len(model.hand.joints)
    return STATE_SCHEMA.layout({
        "tendon": n,
        "joint": joints,
        "digit": len(model.digits),
        "coordinate": model.coordinate_count,
        "node": n + 1,
        "group": group_count,
        "instance": max(n + 1, joints),
        "run": 1,
        "servo": n if any(motor.closes_position_loop for motor in model.hand.motor) else 0,
    })  # fmt: skip


def drive_values(
    layout: BlockLayout, block: BlockArray, n: int
) -> tuple[float, float, float, float, int, int, RecheckCursor]:
    """Read the numbers of a drive from the state block.

    The result contains the arguments of ``DriveState.with_values``.
    """
    position, velocity, torque, temperature, t_ns, count, *recheck = tick_stages.read_drive_values(
        block, layout.offsets, n
    )
    return position, velocity, torque, temperature, t_ns, count, RecheckCursor(*recheck)


class ControllerState:
    """State of the controller between ticks.

    A tick works on a copy of the state of the last tick. The copied state has its own block of
    numbers. The object with the decisions is immutable, so both states share this object.

    Attributes:
        layout: layout of the state block.
        block: numbers of the state, see ``core.state_block``.
        decisions: decisions of the controller, see ``ControllerDecisions``.
        run_reals: real numbers of the run, by row of the table ``run``.
        run_integers: integers of the run, by row of the table ``run_int``.
    """

    __slots__ = ("block", "decisions", "layout", "run_integers", "run_reals")

    def __init__(
        self, layout: BlockLayout, block: BlockArray, decisions: ControllerDecisions
    ) -> None:
        """Store a block of numbers without copying the block, and create views of the tables in the block.

        Args:
            layout: layout of the state block.
            block: numbers of the state, not copied.
            decisions: decisions of the controller, see ``ControllerDecisions``.
        """
        self.layout = layout
        self.block = block
        self.decisions = decisions
        # The table "run" has a single column, so the row number of a field is also its position in
        # the table. An element of a memoryview is read four times as fast as an element of an array.
        elements = block.data
        self.run_reals = cast("memoryview[float]", elements[layout.starts["run"] :])
        self.run_integers = elements.cast("B").cast("q")[layout.starts["run_int"] :]

    def copy(self) -> "ControllerState":
        """Return an independent copy of the state."""
        return ControllerState(self.layout, self.block.copy(), self.decisions)

    def decide(self, **changes: Any) -> None:
        """Replace some fields of the decisions in the state."""
        self.decisions = self.decisions._replace(**changes)

    def digest(self) -> bytes:
        """Return an 8-byte hash of the whole state."""
        return xxhash.xxh3_64_digest(self.block.data, _decision_hash_cache(self.decisions))

    # Tables and single numbers of the block.

    @property
    def tendon(self) -> NDArray[np.float64]:
        """Return the table of real numbers with one column per tendon (rows, N)."""
        return self.layout.table(self.block, "tendon")

    @property
    def tendon_int(self) -> NDArray[np.int64]:
        """Return the table of integers with one column per tendon (rows, N)."""
        return self.layout.table(self.block, "tendon_int")

    def view(self, name: str) -> NDArray[Any]:
        """Return a view of the field with the given name in the state block."""
        return self.layout.view(self.block, name)

    @property
    def k(self) -> int:
        """Return the number of the last tick, or -1 before the first tick."""
        return self.run_integers[s.K]

    @property
    def mode(self) -> HandMode:
        """Return the mode of the hand."""
        return _MODE_BY_NUMBER[self.run_integers[s.HAND_MODE]]

    @mode.setter
    def mode(self, mode: HandMode) -> None:
        self.run_integers[s.HAND_MODE] = mode

    @property
    def mode_start_time(self) -> float:
        """Return the time at which the present mode began [s]."""
        return self.run_reals[s.MODE_START_TIME]

    @mode_start_time.setter
    def mode_start_time(self, t: float) -> None:
        self.run_reals[s.MODE_START_TIME] = t

    @property
    def goal_time(self) -> float:
        """Return the time since the start of the program [s].

        The program time does not increase while the safety monitor makes the hand hold its
        position.
        """
        return self.run_reals[s.GOAL_TIME]

    @goal_time.setter
    def goal_time(self, t: float) -> None:
        self.run_reals[s.GOAL_TIME] = t

    @property
    def is_arming_requested(self) -> bool:
        """Return True if the arming of the drives is requested."""
        return bool(self.run_integers[s.ARMING_REQUESTED])

    @is_arming_requested.setter
    def is_arming_requested(self, is_armed: bool) -> None:
        self.run_integers[s.ARMING_REQUESTED] = is_armed

    @property
    def is_clearing_errors(self) -> bool:
        """Return True if the drives are clearing their latched errors before arming."""
        return bool(self.run_integers[s.CLEARING_DRIVE_ERRORS])

    @is_clearing_errors.setter
    def is_clearing_errors(self, is_clearing: bool) -> None:
        self.run_integers[s.CLEARING_DRIVE_ERRORS] = is_clearing

    @property
    def has_started(self) -> bool:
        """Return True if the encoder and the load cell of every tendon have been read at least once."""
        return bool(self.run_integers[s.FILTER_STARTED])

    @property
    def estimate(self) -> HandEstimate:
        """Return the estimated state of the hand in this tick, as an object with named quantities."""
        return make_tuple(HandEstimate, (self.layout, self.block))

    @property
    def measurements(self) -> TickMeasurements:
        """Return the measurements of this tick, as an object with named quantities."""
        return make_tuple(TickMeasurements, (self.layout, self.block))

    @property
    def sensor_counts(self) -> tuple[int, int, int]:
        """Return the counts of sent SYNC frames, accepted tension frames, and answers to an earlier SYNC frame."""
        return (
            self.run_integers[s.SYNC_COUNT],
            self.run_integers[s.TENSION_FRAME_COUNT],
            self.run_integers[s.STALE_FRAME_COUNT],
        )

    # The decisions, each by its name.

    @property
    def progress(self) -> ProgramProgress:
        """Return the progress of the program."""
        return self.decisions.progress

    @property
    def latched_faults(self) -> tuple[LatchedFault, ...]:
        """Return the faults that are latched."""
        return self.decisions.latched_faults

    @property
    def failure(self) -> str:
        """Return the reason why the run has ended early, in one line.

        The text is empty if the run has not failed.
        """
        return self.decisions.failure

    @property
    def unconfirmed_motors(self) -> tuple[str, ...]:
        """Return the names of the motors whose drives have not confirmed that they are disabled."""
        return self.decisions.unconfirmed_motors

    # States of the drives. The set-up of the drives is in the decisions, and the numbers of the
    # drives are in the state block.

    def drive(self, motor_index: int) -> DriveState:
        """Return the state of one drive."""
        return self.decisions.drives[motor_index].with_values(
            *drive_values(self.layout, self.block, motor_index)
        )

    @property
    def drives(self) -> tuple[DriveState, ...]:
        """Return the states of all drives."""
        return tuple([self.drive(n) for n in range(len(self.decisions.drives))])

    @property
    def drive_phases(self) -> tuple[DrivePhase, ...]:
        """Return the phase of each drive."""
        return tuple([drive.phase for drive in self.decisions.drives])


_MODE_BY_NUMBER = {int(mode): mode for mode in HandMode}
