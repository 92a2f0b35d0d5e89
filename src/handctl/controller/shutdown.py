"""Shutdown after an exception in a tick.

The host repeats the disable command until every drive confirms that it is disabled.
"""

from collections.abc import Sequence
from typing import NamedTuple

from handctl.controller.controller_state import ControllerState
from handctl.controller.hand_modes import motors_not_confirmed_off
from handctl.controller.tick import Controller
from handctl.core import state_block as s
from handctl.drives.contract import DriveTarget
from handctl.drives.frame import Frame


class ShutdownStep(NamedTuple):
    """Result of a shutdown step.

    Attributes:
        state: state with the latest replies of the drives.
        frames: frames to send.
        enabled: names of motors that are possibly still enabled, see
            ``hand_modes.motors_not_confirmed_off``.
    """

    state: ControllerState
    frames: tuple[Frame, ...]
    enabled: tuple[str, ...]


def shutdown_step(
    controller: Controller, state: ControllerState, t_ns: int, received_frames: Sequence[Frame]
) -> ShutdownStep:
    """Process received frames, and send the disable command to every drive.

    The host continues to send SYNC frames, because some drives reply to SYNC frames.

    Args:
        controller: controller whose drives are disabled.
        state: state of the last complete tick, or of the last shutdown step.
        t_ns: time of the step [ns].
        received_frames: frames received since the last step.

    Returns:
        The next state, the frames to send, and the motors that are not confirmed as disabled.
    """
    state_after = state.copy()
    state_after.run_integers[s.K] = state.k + 1
    frames = (
        [controller.sensors.sync(state_after.k)] if controller.derived_constants.sends_sync else []
    )
    for n, drive in enumerate(controller.drives):
        drive_state = state_after.drive(n)
        for frame in received_frames:
            drive_state = drive.receive(drive_state, frame)
        # A frame can be lost, so the host repeats the disable command until the drive confirms it.
        drive_state, new_frames = drive.advance(drive_state, t_ns, DriveTarget.DISABLE, 0.0)
        controller.store_drive_state(state_after, n, drive_state)
        frames += new_frames
    names = tuple(drive.name for drive in controller.drives)
    return ShutdownStep(state_after, tuple(frames), motors_not_confirmed_off(state_after, names))
