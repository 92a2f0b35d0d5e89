"""Faults between nodes and host: frames that are lost, late, doubled, changed or invented."""

import random
from collections.abc import Sequence
from dataclasses import dataclass, field

from firmware_sim.bus.frame import EXTENDED, Frame
from firmware_sim.faults.text import Fault

NEVER_NS = 1 << 62
"""Time at which what is held for another reason comes [ns]."""


@dataclass
class Active:
    """A fault that has begun.

    Attributes:
        fault: as data. chance: its own.
        felt: how often it did something. first_ns: when it did so first [ns]; -1 before.
        held: frames that are kept back, with the time at which they shall come [ns].
        calls: how often it was asked.
    """

    fault: Fault
    chance: random.Random
    felt: int = 0
    first_ns: int = -1
    held: list[tuple[int, Frame]] = field(default_factory=list)
    calls: int = 0

    def feel(self, t_ns: int) -> None:
        """It has done something."""
        self.felt += 1
        if self.first_ns < 0:
            self.first_ns = t_ns

    def strikes(self) -> bool:
        """Whether it hits this frame."""
        return self.fault.p >= 1.0 or self.chance.random() < self.fault.p


def deaf(active: Sequence[Active], t_ns: int) -> bool:
    """Whether a frame to the node is lost on the way."""
    for one in active:
        if one.fault.kind in ("deaf", "off") and one.strikes():
            one.feel(t_ns)
            return True
    return False


def transmit(active: Sequence[Active], frames: list[Frame], t_ns: int) -> list[Frame]:
    """What becomes of frames that a node sends."""
    for one in active:
        change = CHANGES.get(one.fault.kind)
        if change and frames:
            frames = change(one, frames, t_ns)
    return frames


def due(active: Sequence[Active], t_ns: int) -> list[Frame]:
    """Frames whose delay is over."""
    frames = []
    for one in active:
        if one.held:
            frames += [frame._replace(t_ns=at_ns) for at_ns, frame in one.held if at_ns <= t_ns]
            one.held = [pair for pair in one.held if pair[0] > t_ns]
    return frames


def _drop(one: Active, frames: list[Frame], t_ns: int) -> list[Frame]:
    kept = [frame for frame in frames if not one.strikes()]
    if len(kept) < len(frames):
        one.feel(t_ns)
    return kept


def _delay(one: Active, frames: list[Frame], t_ns: int) -> list[Frame]:
    kept = []
    for frame in frames:
        if one.strikes():
            one.held.append((t_ns + round(one.fault.size * 1e6), frame))
            one.feel(t_ns)
        else:
            kept.append(frame)
    return kept


def _duplicate(one: Active, frames: list[Frame], t_ns: int) -> list[Frame]:
    sent = []
    for frame in frames:
        sent.append(frame)
        if one.strikes():
            sent.append(frame)
            one.feel(t_ns)
    return sent


def _twin(one: Active, frames: list[Frame], t_ns: int) -> list[Frame]:
    sent = []
    for frame in frames:
        sent.append(frame)
        if len(frame.data) >= 4 and one.strikes():
            other = bytearray(frame.data)
            other[2] ^= 0x04
            sent.append(frame._replace(data=bytes(other)))
            one.feel(t_ns)
    return sent


def _reorder(one: Active, frames: list[Frame], t_ns: int) -> list[Frame]:
    """Keep the first frame back until behind the next."""
    late = [frame for _, frame in one.held]
    one.held = []
    if not late and one.strikes():
        one.held = [(NEVER_NS, frame) for frame in frames[:1]]
        one.feel(t_ns)
        return frames[1:]
    return frames + late


def _corrupt(one: Active, frames: list[Frame], t_ns: int) -> list[Frame]:
    sent = []
    for frame in frames:
        if frame.data and one.strikes():
            bits = one.chance.sample(range(8 * len(frame.data)), min(int(one.fault.size), 8 * len(frame.data)))
            word = int.from_bytes(frame.data, "little")
            for bit in bits:
                word ^= 1 << bit
            frame = frame._replace(data=word.to_bytes(len(frame.data), "little"))
            one.feel(t_ns)
        sent.append(frame)
    return sent


def _shorten(one: Active, frames: list[Frame], t_ns: int) -> list[Frame]:
    sent = []
    for frame in frames:
        if frame.data and one.strikes():
            frame = frame._replace(data=frame.data[: -max(1, int(one.fault.size))])
            one.feel(t_ns)
        sent.append(frame)
    return sent


def _extend(one: Active, frames: list[Frame], t_ns: int) -> list[Frame]:
    sent = []
    for frame in frames:
        if one.strikes():
            frame = frame._replace(can_id=frame.can_id | EXTENDED)
            one.feel(t_ns)
        sent.append(frame)
    return sent


def _slow(one: Active, frames: list[Frame], t_ns: int) -> list[Frame]:
    one.calls += 1
    if one.calls % max(2, int(one.fault.size)):
        one.feel(t_ns)
        return []
    return frames


def _off(one: Active, frames: list[Frame], t_ns: int) -> list[Frame]:
    one.feel(t_ns)
    return []


def _replay(one: Active, frames: list[Frame], t_ns: int) -> list[Frame]:
    """Send what was sent ``size`` answers ago; until there are so many, the frames themselves."""
    one.calls += 1
    one.held += [(NEVER_NS + one.calls, frame) for frame in frames]
    then = one.calls - int(one.fault.size)
    if then <= 0:
        return frames
    one.feel(t_ns)
    old = [frame for number, frame in one.held if number == NEVER_NS + then]
    one.held = [(number, frame) for number, frame in one.held if number > NEVER_NS + then]
    return [frame._replace(t_ns=t_ns) for frame in old]


CHANGES = {
    "drop": _drop, "delay": _delay, "duplicate": _duplicate, "twin": _twin, "reorder": _reorder, "corrupt": _corrupt,
    "shorten": _shorten, "extend": _extend, "slow": _slow, "off": _off, "replay": _replay,
}  # fmt: skip
"""What each kind does to what a node sends."""
