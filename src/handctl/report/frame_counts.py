"""Counts of late frames, lost frames and ticks without replies in the log of a run."""

from typing import NamedTuple

from handctl.controller.run_setup import make_sensors
from handctl.hand.description import Hand
from handctl.log.read.reader import RunLog


class FrameCounts(NamedTuple):
    """Count of late frames, count of lost frames, and count of ticks without replies during a run.

    The replies that are missing in a tick can arrive in the next tick, and then count as late
    frames.

    Attributes:
        late_frames: number of load-cell frames that answer an older SYNC frame than the latest one.
        lost_frames: number of frames with tensions that never arrived, plus the number of frames
            that a bus refused to send.
        silent_ticks: number of ticks in which no frame of any node came after a SYNC frame. In a
            silent tick, either the nodes or the host had paused. The replies to the SYNC frame of a
            silent tick arrive late, in the next tick.
    """

    late_frames: int
    lost_frames: int
    silent_ticks: int


def frame_counts(log: RunLog, hand: Hand) -> FrameCounts:
    """Count the late frames, the lost frames and the ticks without replies during a run.

    A frame with load-cell readings counts as late if it answers an older SYNC frame than the latest
    one.
    """
    node = make_sensors(hand)
    sync_counter = -1
    sync_ns = 0
    sync_frames = 0
    silent_ids = set(node.ids) if node.amplifiers else set[int]()
    fresh_frames = 0
    late_frame_count = 0
    refused_count = 0
    silent_tick_count = 0
    for tick in log.ticks():
        silent_tick_count += sync_frames > 0 and all(
            frame.bus != node.bus for frame in tick.tick_in.frames
        )
        for frame in tick.tick_in.frames:
            if frame.bus != node.bus or frame.can_id not in node.ids:
                continue
            group = node.ids.index(frame.can_id)
            silent_ids.discard(frame.can_id)
            if len(frame.data) == node.lengths[group] and not silent_ids:
                fresh_answers = node.answers(
                    frame.data, sync_counter
                ) and frame.t_ns >= node.earliest_answer_time_ns(sync_ns)
                late_frame_count += not fresh_answers
                fresh_frames += fresh_answers and group < node.tension_frames
        for frame in tick.frames:
            if (
                frame.bus == node.bus
                and frame.can_id == node.sync_id
                and len(frame.data) == node.sync_message.length
            ):
                sync_counter = frame.data[0] & 0xF if frame.data else 0
                sync_ns = tick.tick_in.t_ns
                # The amplifier of the load cells replies to a SYNC frame only after the set-up of
                # the amplifier is complete.
                sync_frames += not silent_ids
        refused_count += sum(
            event.number for event in tick.tick_in.io_events if event.kind == "enobufs"
        )
    return FrameCounts(
        late_frame_count,
        refused_count + node.lost_frame_count(sync_frames, fresh_frames, late_frame_count),
        silent_tick_count,
    )
