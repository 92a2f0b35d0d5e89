"""Conversion of the controller's state to a snapshot and back.

A snapshot contains the state as bytes. With a snapshot, a log can be executed again from the middle
of the run. A snapshot consists of the identity of the state block's layout (8 bytes), the state
block, and the decisions as JSON. Only code whose state block has the same schema can read the
snapshot.
"""

import json

import numpy as np

from handctl.controller.controller_state import (
    ClientLease,
    ControllerDecisions,
    ControllerState,
    serialized_decisions,
)
from handctl.controller.pending_gains import PendingGains
from handctl.core.block_schema import BlockLayout
from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.trajectory import (
    BlendTrajectory,
    ChirpTrajectory,
    CurveTrajectory,
    MinimumJerk,
    SampledTrajectory,
    StreamedTrajectory,
)
from handctl.core.gains.gains import Gains
from handctl.core.plain_data import (
    json_from_serialized_bytes,
    object_from_plain_data,
    register_restorable_types,
)
from handctl.drives.cia402.progress import Cia402Progress
from handctl.drives.cia404.amplifier import AmplifierState
from handctl.drives.contract import DrivePhase, DriveState, DriveTarget
from handctl.drives.mit.cubemars import CubemarsProgress
from handctl.drives.mit.progress import MitProgress
from handctl.drives.moteus.progress import MoteusProgress
from handctl.drives.moteus.settings import DiagnosticChannel
from handctl.drives.odrive.progress import OdriveProgress
from handctl.drives.readback import ReadbackCursor, RecheckCursor
from handctl.drives.robstride.progress import RobstrideProgress
from handctl.programs.grip import GripState
from handctl.programs.program import ProgramProgress
from handctl.programs.stream_plans import StreamPlan
from handctl.programs.task import Task
from handctl.safety.tick_verdict import LatchedFault, ReportedFault

register_restorable_types(
    ControllerDecisions, DriveState, DrivePhase, DriveTarget, ProgramProgress, GripState, DigitGoal, GoalKind,
    MinimumJerk, BlendTrajectory, CurveTrajectory,
    SampledTrajectory,
    ChirpTrajectory, StreamedTrajectory, StreamPlan, Task, LatchedFault, ReportedFault, Gains, PendingGains,
    RecheckCursor, ReadbackCursor,
    MitProgress,
    CubemarsProgress, OdriveProgress, Cia402Progress, MoteusProgress, DiagnosticChannel, RobstrideProgress, ClientLease,
    AmplifierState,
)  # fmt: skip

LAYOUT_IDENTITY_SIZE = 8
"""Size of the layout's identity [bytes]."""


def snapshot_bytes(state: ControllerState) -> bytes:
    """Return the snapshot of a controller's state as bytes."""
    numbers, decisions = snapshot_parts(state)
    return numbers + json_from_serialized_bytes(decisions)


def snapshot_parts(state: ControllerState) -> tuple[bytes, bytes]:
    """Return both parts of the snapshot of a controller's state: the numbers, and the serialized decisions.

    The numbers are the beginning of the snapshot. The function ``json_from_serialized_bytes``
    converts the decisions to the rest of the snapshot. The control loop leaves this conversion to
    the recorder process, because the conversion takes 0.1 to 0.4 ms with eleven motors.
    """
    return state.layout.identity + state.block.tobytes(), serialized_decisions(state.decisions)


def restore_state(layout: BlockLayout, packed_snapshot: bytes) -> ControllerState:
    """Return the state stored in a snapshot.

    Args:
        layout: layout of the state block of the controller that has written the snapshot.
        packed_snapshot: bytes of the snapshot.

    Raises:
        ValueError: the data are not a snapshot of a controller with the given layout.
    """
    # All numbers of the state block have 8 bytes.
    end = LAYOUT_IDENTITY_SIZE + 8 * layout.size
    if packed_snapshot[:LAYOUT_IDENTITY_SIZE] != layout.identity or len(packed_snapshot) < end:
        raise ValueError(f"a snapshot of {len(packed_snapshot)} bytes of another schema or hand")
    block = np.frombuffer(packed_snapshot, np.float64, layout.size, LAYOUT_IDENTITY_SIZE).copy()
    try:
        decisions = object_from_plain_data(json.loads(packed_snapshot[end:]))
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"decisions that cannot be read: {error}") from None
    if not isinstance(decisions, ControllerDecisions):
        raise ValueError("no decisions in it")
    return ControllerState(layout, block, decisions)
