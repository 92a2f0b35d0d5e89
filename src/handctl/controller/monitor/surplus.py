"""Answers that nobody asked for: one too many from a node that was asked, or any at all from one that was not.

A motor that answers although this host has asked it nothing yet was asked by another one: H13, the second controller,
of which one frame is enough, as one of its own frames is. One answer more than questions is a duplicate (B05) or, with
other bytes, a masquerade (B06). What counts as an answer is what drive and sensor node accept as one: a heartbeat
beside it, or a frame with an old counter, is none. This runs only in ticks in which some node answered too often.
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
    """Judge the surplus of one tick; write duplicates into ``TWICE``.

    Args:
        drives, sensors: of the hand.
        before: state before the tick. state: with what was received in it.
        frames: received in it.

    Returns:
        of motors that were asked nothing and answered, a phrase each.
    """
    twice, surplus = state.view("twice"), state.view("surplus").tolist()
    signs = []
    for n, count in enumerate(surplus):
        if count == 1:
            signs.append(f"{drives[n].name} answering it")
        elif count:
            twice[n] = _differ(_answers(drives[n], before, n, frames), count - 1)
    for group, count in enumerate(state.view("group_answered").tolist()):
        if count > 1:
            asked, can_id = before.whole(s.SYNC_ASKED), sensors.ids[group]
            fresh = [
                frame.data
                for frame in frames
                if (frame.bus, frame.can_id) == (sensors.bus, can_id) and frame.data and frame.data[0] & 0xF == asked
            ]
            twice[-1] = max(twice[-1], _differ(fresh, 1))
    return tuple(signs)


def _differ(payloads: list[bytes], due: int) -> int:
    """Return 2 if what came beyond the questions is not all as the last answer that was due, else 1."""
    return 2 if len(set(payloads[due - 1 :])) > 1 else 1


def _answers(drive: Drive, before: State, n: int, frames: Sequence[Frame]) -> list[bytes]:
    """Return the payloads of the frames that a drive's state machine counts as an answer, in order."""
    known, taken = before.drive(n), []
    for frame in frames:
        after = drive.receive(known, frame)
        taken += [frame.data] if after.feedback_count > known.feedback_count else []
        known = after
    return taken
