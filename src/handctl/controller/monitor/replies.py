"""Unsolicited and duplicate replies: a node sends more replies than this host has sent requests.

A motor replying before the first request of this host was addressed by a second controller
(H13). A single frame is enough, as for the second controller's own frames. A reply more than
requests is a duplicate (B05), or a masquerade if the bytes differ (B06). Only frames accepted
as a reply by the drive or the sensor node count. A heartbeat or a frame with an old counter does not.
The code runs only in ticks with excess replies.
"""

from collections.abc import Sequence

from handctl.controller.state import State
from handctl.core import block as s
from handctl.drives.contract import Drive
from handctl.drives.frame import Frame
from handctl.drives.sensors.node import SensorNode


def unsolicited(
    drives: tuple[Drive, ...], sensors: SensorNode, before: State, state: State, frames: Sequence[Frame]
) -> tuple[str, ...]:
    """Judge the excess replies of a tick, and write duplicates into ``DUPLICATES``.

    Args:
        drives: of the hand.
        sensors: of the hand.
        before: state before the tick.
        state: with the data received in the tick.
        frames: received in the tick.

    Returns:
        A phrase for each motor replying without a request.
    """
    duplicates = state.view("twice")
    surplus = state.view("surplus").tolist()
    signs = []
    for n, count in enumerate(surplus):
        # 1: replied without a request. More: number of replies to one request.
        if count == 1:
            signs.append(f"{drives[n].name} answering it")
        elif count:
            duplicates[n] = _differ(_answers(drives[n], before, n, frames), count - 1)
    for group, count in enumerate(state.view("group_answered").tolist()):
        if count > 1:
            counter = before.whole(s.SYNC_COUNTER)
            can_id = sensors.ids[group]
            # The low four bits of the first payload byte echo the counter of the SYNC.
            fresh = [
                frame.data
                for frame in frames
                if (frame.bus, frame.can_id) == (sensors.bus, can_id) and frame.data and frame.data[0] & 0xF == counter
            ]
            duplicates[-1] = max(duplicates[-1], _differ(fresh, 1))
    return tuple(signs)


def _differ(payloads: list[bytes], due: int) -> int:
    """Return 2 if the excess replies differ from the last due reply, else 1."""
    return 2 if len(set(payloads[due - 1 :])) > 1 else 1


def _answers(drive: Drive, before: State, n: int, frames: Sequence[Frame]) -> list[bytes]:
    """Return the payloads counted as replies by a drive's state machine, in order."""
    drive_state = before.drive(n)
    payloads = []
    for frame in frames:
        after = drive.receive(drive_state, frame)
        payloads += [frame.data] if after.feedback_count > drive_state.feedback_count else []
        drive_state = after
    return payloads
