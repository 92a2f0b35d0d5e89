"""Faults on the bus between nodes and host: frames are lost, late, duplicated, changed or replayed."""

import random
from collections.abc import Sequence
from dataclasses import dataclass, field

from firmware_sim.bus.frame import EXTENDED_FLAG, Frame
from firmware_sim.faults.fault_text import Fault

NEVER_NS = 1 << 62
"""Release time of stored frames that the clock never releases, because the fault itself releases these frames [ns]."""


@dataclass
class ActiveFault:
    """An injected fault that waits for its start, acts, or has ended.

    Attributes:
        fault: the data of the fault.
        rng: generator of the fault's random numbers.
        effect_count: number of effects of the fault until now.
        first_effect_ns: time of the fault's first effect [ns], or -1 if the fault has had no effect
            yet.
        delayed_frames: frames that the fault has stored, with their release times [ns].
        answer_count: number of answers handled by the fault until now.
    """

    fault: Fault
    rng: random.Random
    effect_count: int = 0
    first_effect_ns: int = -1
    delayed_frames: list[tuple[int, Frame]] = field(default_factory=list)
    answer_count: int = 0

    def count_effect(self, t_ns: int) -> None:
        """Count an effect of the fault at the given time."""
        self.effect_count += 1
        if self.first_effect_ns < 0:
            self.first_effect_ns = t_ns

    def affects_frame(self) -> bool:
        """Decide at random whether the fault affects the present frame."""
        return self.fault.p >= 1.0 or self.rng.random() < self.fault.p


def is_request_lost(active_faults: Sequence[ActiveFault], t_ns: int) -> bool:
    """Return True if a fault makes the node lose a frame from the host."""
    for active_fault in active_faults:
        if active_fault.fault.kind in ("deaf", "off") and active_fault.affects_frame():
            active_fault.count_effect(t_ns)
            return True
    return False


def frames_after_faults(
    active_faults: Sequence[ActiveFault], frames: list[Frame], t_ns: int
) -> list[Frame]:
    """Apply the faults of a node to frames sent by the node.

    Returns:
        The frames that the bus carries now.
    """
    for active_fault in active_faults:
        change = FRAME_CHANGE_BY_FAULT_KIND.get(active_fault.fault.kind)
        if change and frames:
            frames = change(active_fault, frames, t_ns)
    return frames


def released_frames(active_faults: Sequence[ActiveFault], t_ns: int) -> list[Frame]:
    """Return the delayed frames whose release time has passed."""
    frames = []
    for active_fault in active_faults:
        if active_fault.delayed_frames:
            frames += [
                frame._replace(t_ns=release_ns)
                for release_ns, frame in active_fault.delayed_frames
                if release_ns <= t_ns
            ]
            active_fault.delayed_frames = [
                pair for pair in active_fault.delayed_frames if pair[0] > t_ns
            ]
    return frames


def _drop_frames(active_fault: ActiveFault, frames: list[Frame], t_ns: int) -> list[Frame]:
    """Drop the frames that the fault affects."""
    unaffected_frames = [frame for frame in frames if not active_fault.affects_frame()]
    if len(unaffected_frames) < len(frames):
        active_fault.count_effect(t_ns)
    return unaffected_frames


def _delay_frames(active_fault: ActiveFault, frames: list[Frame], t_ns: int) -> list[Frame]:
    """Store the frames that the fault affects, until the delay of these frames is over."""
    unaffected_frames = []
    for frame in frames:
        if active_fault.affects_frame():
            active_fault.delayed_frames.append((t_ns + round(active_fault.fault.size * 1e6), frame))
            active_fault.count_effect(t_ns)
        else:
            unaffected_frames.append(frame)
    return unaffected_frames


def _duplicate_frames(active_fault: ActiveFault, frames: list[Frame], t_ns: int) -> list[Frame]:
    """Send two copies of each frame that the fault affects."""
    sent_frames = []
    for frame in frames:
        sent_frames.append(frame)
        if active_fault.affects_frame():
            sent_frames.append(frame)
            active_fault.count_effect(t_ns)
    return sent_frames


def _add_conflicting_frames(
    active_fault: ActiveFault, frames: list[Frame], t_ns: int
) -> list[Frame]:
    """Send a second frame with the same identifier but with another payload, as a second node would."""
    sent_frames = []
    for frame in frames:
        sent_frames.append(frame)
        if len(frame.data) >= 4 and active_fault.affects_frame():
            twin_data = bytearray(frame.data)
            # The inverted bit lies in the middle of a payload value. So the second frame looks
            # plausible but differs from the true frame.
            twin_data[2] ^= 0x04
            sent_frames.append(frame._replace(data=bytes(twin_data)))
            active_fault.count_effect(t_ns)
    return sent_frames


def _reorder_frames(active_fault: ActiveFault, frames: list[Frame], t_ns: int) -> list[Frame]:
    """Hold back the first frame of an answer, and send this frame after the frames of the next answer."""
    delayed_frames = [frame for _, frame in active_fault.delayed_frames]
    active_fault.delayed_frames = []
    if not delayed_frames and active_fault.affects_frame():
        active_fault.delayed_frames = [(NEVER_NS, frame) for frame in frames[:1]]
        active_fault.count_effect(t_ns)
        return frames[1:]
    return frames + delayed_frames


def _corrupt_frames(active_fault: ActiveFault, frames: list[Frame], t_ns: int) -> list[Frame]:
    """Invert random bits in the payload of each frame that the fault affects."""
    sent_frames = []
    for frame in frames:
        if frame.data and active_fault.affects_frame():
            bits = active_fault.rng.sample(
                range(8 * len(frame.data)), min(int(active_fault.fault.size), 8 * len(frame.data))
            )
            word = int.from_bytes(frame.data, "little")
            for bit in bits:
                word ^= 1 << bit
            frame = frame._replace(data=word.to_bytes(len(frame.data), "little"))
            active_fault.count_effect(t_ns)
        sent_frames.append(frame)
    return sent_frames


def _shorten_frames(active_fault: ActiveFault, frames: list[Frame], t_ns: int) -> list[Frame]:
    """Remove the last bytes from the payload of each frame that the fault affects."""
    sent_frames = []
    for frame in frames:
        if frame.data and active_fault.affects_frame():
            frame = frame._replace(data=frame.data[: -max(1, int(active_fault.fault.size))])
            active_fault.count_effect(t_ns)
        sent_frames.append(frame)
    return sent_frames


def _extend_frames(active_fault: ActiveFault, frames: list[Frame], t_ns: int) -> list[Frame]:
    """Turn frames with 11-bit identifiers into frames with 29-bit identifiers.

    Frames with 29-bit identifiers stay unchanged.
    """
    sent_frames = []
    for frame in frames:
        if not frame.can_id & EXTENDED_FLAG and active_fault.affects_frame():
            frame = frame._replace(can_id=frame.can_id | EXTENDED_FLAG)
            active_fault.count_effect(t_ns)
        sent_frames.append(frame)
    return sent_frames


def _slow_frames(active_fault: ActiveFault, frames: list[Frame], t_ns: int) -> list[Frame]:
    """Drop the answers of a node, except every n-th answer.

    The number n is the size of the fault.
    """
    active_fault.answer_count += 1
    if active_fault.answer_count % max(2, int(active_fault.fault.size)):
        active_fault.count_effect(t_ns)
        return []
    return frames


def _remove_all_frames(active_fault: ActiveFault, frames: list[Frame], t_ns: int) -> list[Frame]:
    """Drop all frames of a node, as if the node had no power."""
    active_fault.count_effect(t_ns)
    return []


def _replay_frames(active_fault: ActiveFault, frames: list[Frame], t_ns: int) -> list[Frame]:
    """Replace the frames of every answer of a node by the frames of an earlier answer.

    The inserted frames come from the answer that the node sent ``fault.size`` answers earlier. The
    first ``fault.size`` answers stay unchanged.
    """
    active_fault.answer_count += 1
    # The release time of the stored frames is NEVER_NS plus the number of the answer. So
    # ``released_frames`` never releases the stored frames.
    active_fault.delayed_frames += [
        (NEVER_NS + active_fault.answer_count, frame) for frame in frames
    ]
    replayed_answer_number = active_fault.answer_count - int(active_fault.fault.size)
    if replayed_answer_number <= 0:
        return frames
    active_fault.count_effect(t_ns)
    old_frames = [
        frame
        for number, frame in active_fault.delayed_frames
        if number == NEVER_NS + replayed_answer_number
    ]
    active_fault.delayed_frames = [
        (number, frame)
        for number, frame in active_fault.delayed_frames
        if number > NEVER_NS + replayed_answer_number
    ]
    return [frame._replace(t_ns=t_ns) for frame in old_frames]


FRAME_CHANGE_BY_FAULT_KIND = {
    "drop": _drop_frames, "delay": _delay_frames, "duplicate": _duplicate_frames, "twin": _add_conflicting_frames,
    "reorder": _reorder_frames, "corrupt": _corrupt_frames,
    "shorten": _shorten_frames, "extend": _extend_frames, "slow": _slow_frames, "off": _remove_all_frames,
    "replay": _replay_frames,
}  # fmt: skip
"""Function that changes the frames sent by a node, by kind of fault."""
