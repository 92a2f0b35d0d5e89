"""Frames of a run that came late, and frames that were lost, counted from its log."""

from typing import NamedTuple

from handctl.controller.setup import make_sensors
from handctl.hand.description import Hand
from handctl.log.read.reader import RunLog


class FrameCounts(NamedTuple):
    """What went wrong with the frames of a run.

    Attributes:
        late: answers of the load cells to an older SYNC.
        lost: tension frames that never came, and frames that a bus refused.
    """

    late: int
    lost: int


def frame_counts(log: RunLog, hand: Hand) -> FrameCounts:
    """Count late and lost frames by feeding the logged frames to the decoder of the sensor node."""
    node = make_sensors(hand)
    state, refused = node.initial(), 0
    for tick in log.ticks():
        for frame in tick.tick_in.frames:
            state = node.receive(state, frame)
        for frame in tick.frames:
            if frame.bus == node.bus and frame.can_id == node.sync_id and frame.data:
                state = state._replace(asked=frame.data[0] & 0xF, syncs=state.syncs + 1)
        refused += sum(event.number for event in tick.tick_in.io_events if event.kind == "enobufs")
    return FrameCounts(state.stale, refused + node.lost(state))
