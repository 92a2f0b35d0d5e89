"""Shutdown after an exception inside a tick: command every drive to disable until confirmation."""

from collections.abc import Sequence
from typing import NamedTuple

from handctl.controller.state import State
from handctl.controller.tick import Controller
from handctl.core import block as s
from handctl.drives.contract import DriveTarget, Phase
from handctl.drives.frame import Frame


class ShutdownStep(NamedTuple):
    """Result of a shutdown step.

    Attributes:
        state: with the drives' latest replies.
        frames: to be sent.
        enabled: motors possibly on, without a confirmation of the contrary.
    """

    state: State
    frames: tuple[Frame, ...]
    enabled: tuple[str, ...]


def shutdown_step(controller: Controller, state: State, t_ns: int, received: Sequence[Frame]) -> ShutdownStep:
    """Take in received frames and command every drive to disable.

    SYNC continues, because some drives reply to SYNC.

    Args:
        controller: with the drives.
        state: from the last complete tick, or from the step before.
        t_ns: time of the step [ns].
        received: frames since the step before.

    Returns:
        The next state, the frames to send, and the unconfirmed motors.
    """
    after = state.copy()
    enabled = []
    after.set_whole(s.K, state.k + 1)
    frames = [controller.sensors.sync(after.k)] if controller.sends_sync else []
    for n, drive in enumerate(controller.drives):
        drive_state = after.drive(n)
        for frame in received:
            drive_state = drive.receive(drive_state, frame)
        # Repeated in every step until confirmed: a disable frame may be lost.
        drive_state, new_frames = drive.advance(drive_state, t_ns, DriveTarget.DISABLE, 0.0)
        controller.keep(after, n, drive_state)
        frames += new_frames
        if drive_state.phase == Phase.ENABLED:
            enabled.append(drive.name)
    return ShutdownStep(after, tuple(frames), tuple(enabled))
