"""Counts of late frames, lost frames, and silent ticks of a run, from its log."""

from typing import NamedTuple

from handctl.controller.setup import make_sensors
from handctl.hand.description import Hand
from handctl.log.read.reader import RunLog


class FrameCounts(NamedTuple):
    """Number of late and lost frames of a run, and of silent ticks that may explain these.

    Attributes:
        late: number of load-cell replies to an older SYNC.
        lost: number of tension frames that never arrived, and of frames refused by a bus.
        silent: number of ticks after a SYNC without a frame from any node. The nodes or the host
            had paused, and the replies arrive late in the next tick.
    """

    late: int
    lost: int
    silent: int


def frame_counts(log: RunLog, hand: Hand) -> FrameCounts:
    """Return the number of late frames, lost frames, and silent ticks.

    Each frame of the load cells is compared with the SYNC before it.
    """
    node = make_sensors(hand)
    sync_counter = -1
    sync_frames = 0
    fresh_frames = 0
    late = 0
    refused = 0
    silent = 0
    for tick in log.ticks():
        silent += sync_frames > 0 and all(frame.bus != node.bus for frame in tick.tick_in.frames)
        for frame in tick.tick_in.frames:
            if frame.bus != node.bus or frame.can_id not in node.ids:
                continue
            group = node.ids.index(frame.can_id)
            if len(frame.data) == node.lengths[group]:
                # The low four bits of the first byte repeat the counter of the SYNC.
                fresh = frame.data[0] & 0xF == sync_counter
                late += not fresh
                fresh_frames += fresh and group < node.tension_frames
        for frame in tick.frames:
            if frame.bus == node.bus and frame.can_id == node.sync_id and frame.data:
                sync_counter = frame.data[0] & 0xF
                sync_frames = sync_frames + 1
        refused += sum(event.number for event in tick.tick_in.io_events if event.kind == "enobufs")
    return FrameCounts(late, refused + node.lost(sync_frames, fresh_frames, late), silent)
