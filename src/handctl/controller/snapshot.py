"""A state as bytes, from which a log can be executed again from the middle: the block itself, and the decisions.

A snapshot is ``u32 version, u32 size of the block``, the block, and the plain form of the decisions. It can be read by the
very code that wrote it only: the block has no description of its own.
"""

import marshal
import struct

import numpy as np

from handctl.controller.coming import Coming
from handctl.controller.state import Decisions, State
from handctl.core.gains.gains import Gains
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.law.trajectory import Chirp, Curve, MinimumJerk, Sample
from handctl.core.plain import FORMAT, plain, register, restored
from handctl.core.schema import Layout
from handctl.drives import recheck
from handctl.drives.cia402 import progress as cia402
from handctl.drives.cia402 import settings as cia402_settings
from handctl.drives.contract import DriveState, Phase, Want
from handctl.drives.mit import cubemars
from handctl.drives.mit import progress as mit
from handctl.drives.mit import settings as mit_settings
from handctl.drives.odrive import progress as odrive
from handctl.drives.odrive import settings as odrive_settings
from handctl.programs.grip import Grip
from handctl.programs.program import Progress
from handctl.safety.judge import Counting, Latched

register(
    Decisions, DriveState, Phase, Want, Progress, Grip, DigitGoal, Kind, MinimumJerk, Curve, Sample, Chirp, Latched,
    Counting, Gains, Coming, recheck.Recheck, mit.Progress, cubemars.Progress, odrive.Progress, cia402.Progress,
    mit_settings.Walk, odrive_settings.Walk, cia402_settings.Walk,
)  # fmt: skip

VERSION = 1
HEAD = struct.Struct("<II")


def snapshot(state: State) -> bytes:
    """Return a state as bytes."""
    block = state.block.tobytes()
    return HEAD.pack(VERSION, len(block)) + block + marshal.dumps(plain(state.decisions), FORMAT)


def restore(layout: Layout, data: bytes) -> State:
    """Return the state of a snapshot.

    Args:
        layout: of the controller that wrote it. data: the snapshot.

    Raises:
        ValueError: it is not one of this controller.
    """
    if len(data) < HEAD.size:
        raise ValueError("a snapshot that is too short")
    version, size = HEAD.unpack_from(data)
    if version != VERSION or size != 8 * layout.size or len(data) < HEAD.size + size:
        raise ValueError(f"a snapshot of version {version} with {size} bytes, expected {VERSION} with {8 * layout.size}")
    block = np.frombuffer(data, np.float64, layout.size, HEAD.size).copy()
    try:
        decisions = restored(marshal.loads(data[HEAD.size + size :]))
    except (EOFError, TypeError, ValueError) as error:
        raise ValueError(f"decisions that cannot be read: {error}") from None
    if not isinstance(decisions, Decisions):
        raise ValueError("no decisions in it")
    return State(layout, block, decisions)
