"""After an error inside a tick: every drive is told to disable until it has said that it is off."""

from collections.abc import Sequence
from typing import NamedTuple

from handctl.controller.state import State
from handctl.controller.tick import Controller
from handctl.core import block as s
from handctl.drives.contract import Phase, Want
from handctl.drives.frame import Frame


class LettingGo(NamedTuple):
    """One step of it.

    Attributes:
        state: with what the drives have said since.
        frames: to be sent.
        enabled: motors that have not said yet that they are off, of those that may be on.
    """

    state: State
    frames: tuple[Frame, ...]
    enabled: tuple[str, ...]


def let_go(controller: Controller, state: State, t_ns: int, heard: Sequence[Frame]) -> LettingGo:
    """Take in what was heard, and tell every drive to disable; SYNC goes on, at which some of them speak.

    Args:
        controller: whose drives they are.
        state: from the last tick that was whole, or from the step before.
        t_ns: time of the step [ns].
        heard: frames since the step before.
    """
    after, enabled = state.copy(), []
    after.set_whole(s.K, state.k + 1)
    frames = [controller.sensors.sync(after.k)]
    for n, drive in enumerate(controller.drives):
        known = after.drive(n)
        for frame in heard:
            known = drive.receive(known, frame)
        known, told = drive.advance(known, t_ns, Want.DISABLE, 0.0)
        controller.keep(after, n, known)
        frames += told
        if known.phase == Phase.ENABLED:
            enabled.append(drive.name)
    return LettingGo(after, tuple(frames), tuple(enabled))
