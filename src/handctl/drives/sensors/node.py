"""The sensor node: load cells and joint encoders, in frames of our own (``sensor_node.dbc``).

The host sends SYNC with a counter byte; the node samples at once and answers with the low four bits of that byte in
every frame, so that a stale frame cannot pass for a fresh one. Successive counters do not repeat with period 16: see
``counters``. Up to five channels of 12 bits a frame,
after a counter of four bits, packed from the lowest bit. Tension: 62.5 mN a count from -6 N. Joint angle: 1/4096
turn a count from -180 degrees; joint frames come on every SYNC whose counter is a multiple of ``joint_decimation``.
"""

import functools
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, Self

from handctl.drives.frame import Frame

CHANNELS = 5
CHANNEL_BITS = 12
COUNTER_BITS = 4
SHIFTS = tuple(range(COUNTER_BITS, COUNTER_BITS + CHANNELS * CHANNEL_BITS, CHANNEL_BITS))
FULL = (1 << CHANNEL_BITS) - 1
TENSION_STEP_N = 0.0625
TENSION_ZERO_N = -6.0
TENSION_TOP_N = TENSION_ZERO_N + FULL * TENSION_STEP_N
"""Reading of a channel that is full, as zero is of one that is empty: the cell is saturated."""
LOW_MARGIN_N = 2.0
TARE_LEAST_N, TARE_MOST_N = TENSION_ZERO_N + LOW_MARGIN_N, 6.0
"""What a load cell may read without tension: lower, and noise takes it to the end of its range, so that a broken wire
looks like a loose rope; higher, and its range ends below what ``tension_rail`` says."""
TENSION_RAIL_N = TENSION_TOP_N - TARE_MOST_N
"""Tension, after any tare, from which on a load cell may be saturated."""
COUNTER_PERIOD, DISTINCT = 4096, 8
"""Ticks after which the counters of SYNC repeat, and among which the four bits of the answers are all different."""
JOINT_STEP_RAD = 2 * math.pi / 4096
JOINT_ZERO = 2048
JOINT_FRAMES = 0x10
"""Joint frames begin this far above the tension frames."""


class SensorDescription(Protocol):
    """What is needed of the hand file's section ``sensor_node``."""

    @property
    def sync_id(self) -> int: ...
    @property
    def base_id(self) -> int: ...
    @property
    def tendons(self) -> tuple[str, ...]: ...
    @property
    def joints(self) -> tuple[str, ...]: ...
    @property
    def joint_decimation(self) -> int: ...


class Group(NamedTuple):
    """The latest frame of one identifier.

    Attributes:
        counter: its four bits; -1 before the first.
        t_ns: reception [ns]; -1 before the first.
        frames: accepted so far.
        raw: channel values.
    """

    counter: int = -1
    t_ns: int = -1
    frames: int = 0
    raw: tuple[int, ...] = ()


class SensorState(NamedTuple):
    """What is known of the node.

    Attributes:
        groups: one per frame identifier, tension frames first.
        asked: low four bits of the last SYNC; -1 before the first.
        stale: frames whose counter was not the one asked for.
        misread: frames of a wrong shape on the node's identifiers.
        syncs: SYNCs so far.
    """

    groups: tuple[Group, ...]
    asked: int = -1
    stale: int = 0
    misread: int = 0
    syncs: int = 0


@dataclass(frozen=True, slots=True)
class SensorNode:
    """The node as the host sees it; immutable.

    Attributes:
        bus: index of its bus.
        sync_id: identifier of SYNC.
        ids: identifier of each frame, tension frames first.
        channels: of each frame, the tendon or joint of each of its channels, in the hand's order.
        lengths: of each frame [bytes].
        tension_frames: how many of them carry tensions.
        frame_of: of each tendon of the hand, the tension frame that has its load cell; -1 without one.
        decimation: joint frames come on every such SYNC.
        counters: byte of SYNC by tick, repeated; follows from the decimation.
    """

    bus: int
    sync_id: int
    ids: tuple[int, ...]
    channels: tuple[tuple[int, ...], ...]
    lengths: tuple[int, ...]
    tension_frames: int
    frame_of: tuple[int, ...]
    decimation: int
    counters: bytes = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "counters", counters(self.decimation))

    @classmethod
    def of(cls, node: SensorDescription, bus: int, tendons: tuple[str, ...], joints: tuple[str, ...]) -> Self:
        """The node of a hand.

        Args:
            node: its description.
            bus: index of its bus.
            tendons, joints: all names of the hand, in order.
        """
        tension = _groups([tendons.index(name) for name in node.tendons])
        angle = _groups([joints.index(name) for name in node.joints])
        frame = {index: g for g, group in enumerate(tension) for index in group}
        ids = [node.base_id + g for g in range(len(tension))]
        ids += [node.base_id + JOINT_FRAMES + g for g in range(len(angle))]
        return cls(
            bus=bus,
            sync_id=node.sync_id,
            ids=tuple(ids),
            channels=(*tension, *angle),
            lengths=tuple(_length(len(group)) for group in tension + angle),
            tension_frames=len(tension),
            frame_of=tuple(frame.get(index, -1) for index in range(len(tendons))),
            decimation=node.joint_decimation,
        )

    @property
    def node_ids(self) -> frozenset[int]:
        """Identifiers that the node answers on."""
        return frozenset(self.ids)

    @property
    def host_ids(self) -> frozenset[int]:
        """Identifiers that only the host sends."""
        return frozenset((self.sync_id,))

    @property
    def tension_rail(self) -> float:
        """Tension, after any tare, from which on a load cell may be saturated [N]."""
        return TENSION_RAIL_N

    @property
    def tension_low(self) -> float:
        """Tared reading below which a cell or its wire is broken [N]: near the lower rail, far from any noise."""
        return TENSION_ZERO_N + LOW_MARGIN_N

    @property
    def exchange(self) -> tuple[tuple[int, float], ...]:
        """Frames of a tick as (payload bytes, how many a tick): SYNC, tension frames, and a share of joint frames."""
        rates = [1.0] * self.tension_frames + [1.0 / self.decimation] * (len(self.ids) - self.tension_frames)
        return ((1, 1.0), *zip(self.lengths, rates, strict=True))

    def initial(self) -> SensorState:
        """State before anything was heard."""
        return SensorState((Group(),) * len(self.ids))

    def sync(self, state: SensorState, k: int) -> tuple[SensorState, Frame]:
        """SYNC of tick k; answers to it will carry its counter."""
        counter = self.counters[k % len(self.counters)]
        return state._replace(asked=counter & 0xF, syncs=state.syncs + 1), Frame(
            self.sync_id, bytes((counter,)), bus=self.bus
        )

    def receive(self, state: SensorState, frame: Frame) -> SensorState:
        """Take in a frame; what is not the node's leaves the state as it is. Never raises on wire data."""
        can_id, data, _, bus, t_ns = frame
        if bus != self.bus or can_id not in self.ids:
            return state
        index = self.ids.index(can_id)
        if len(data) != self.lengths[index]:
            return state._replace(misread=state.misread + 1)
        bits = int.from_bytes(data, "little")
        if bits & 0xF != state.asked:
            return state._replace(stale=state.stale + 1)
        groups, asked, *counts = state
        raw = tuple([bits >> shift & FULL for shift in SHIFTS[: len(self.channels[index])]])
        new = Group(asked, t_ns, groups[index].frames + 1, raw)
        return SensorState((*groups[:index], new, *groups[index + 1 :]), asked, *counts)

    def new_tensions(self, before: SensorState, now: SensorState) -> list[tuple[int, float]]:
        """(tendon index, tension [N]) of every channel that was read since ``before``."""
        fresh = self._fresh(before, now, slice(self.tension_frames))
        return [(i, TENSION_ZERO_N + raw * TENSION_STEP_N) for i, raw in fresh]

    def new_joints(self, before: SensorState, now: SensorState) -> list[tuple[int, float]]:
        """(joint index, angle [rad]) of every channel that was read since ``before``."""
        fresh = self._fresh(before, now, slice(self.tension_frames, None))
        return [(i, (raw - JOINT_ZERO) * JOINT_STEP_RAD) for i, raw in fresh]

    def lost(self, state: SensorState) -> int:
        """Return how many tension frames never came, those of the last SYNC aside, which may be on their way."""
        came = sum(group.frames for group in state.groups[: self.tension_frames])
        return max(0, (state.syncs - 1) * self.tension_frames - came - state.stale)

    def latest_joints(self, state: SensorState) -> list[tuple[int, float, int]]:
        """Return joint index, angle [rad] and time of reception [ns] of the latest reading of each joint."""
        frames = zip(self.channels[self.tension_frames :], state.groups[self.tension_frames :], strict=True)
        return [
            (index, (raw - JOINT_ZERO) * JOINT_STEP_RAD, group.t_ns)
            for channels, group in frames
            for index, raw in zip(channels, group.raw, strict=False)
        ]

    def all_read(self, state: SensorState) -> bool:
        """Whether the load cell of every tendon was read at least once."""
        return all(frame >= 0 and state.groups[frame].frames > 0 for frame in self.frame_of)

    def tension_times(self, state: SensorState) -> tuple[int, ...]:
        """Reception of each tendon's latest reading [ns], -1 before the first; (N,) in the hand's order.

        A tendon without a load cell has the node's latest one, so that it is never missed alone.
        """
        times = [group.t_ns for group in state.groups[: self.tension_frames]]
        times.append(max(times, default=-1))
        return tuple([times[frame] for frame in self.frame_of])

    def joint_times(self, state: SensorState) -> list[tuple[int, int]]:
        """Of each joint frame its first joint, and the reception of its latest reading [ns], -1 before the first."""
        frames = slice(self.tension_frames, None)
        rows = zip(self.channels[frames], state.groups[frames], strict=True)
        return [(channels[0], group.t_ns) for channels, group in rows]

    def _fresh(self, before: SensorState, now: SensorState, which: slice) -> list[tuple[int, int]]:
        """Tendon or joint, and raw value, of each channel of the frames that came since."""
        rows = zip(before.groups[which], now.groups[which], self.channels[which], strict=True)
        return [
            pair
            for old, new, channels in rows
            if new.frames != old.frames
            for pair in zip(channels, new.raw, strict=True)
        ]


@functools.lru_cache(maxsize=16)
def counters(decimation: int) -> bytes:
    """Return the counter byte of each SYNC of a period of about ``COUNTER_PERIOD`` ticks.

    Four bits that count up cannot tell a frame that is 16 or 32 ticks old from a fresh one. These do not count up: of
    two ticks less than ``DISTINCT`` apart the low four bits differ, and at any other distance they agree by chance. The
    remainder by ``decimation`` is that of the tick, since the node sends joint frames by it. From a decimation of 8 on
    the four bits have fewer than three values for a remainder, and the bits of near ticks may agree.
    """
    rows = [range(remainder, 256, decimation) for remainder in range(decimation)]
    by_nibble = [{byte & 0xF: byte for byte in row} for row in rows]
    chance, recent, made = 1, list[int](), bytearray()
    for k in range(COUNTER_PERIOD - COUNTER_PERIOD % decimation):
        chance = chance * 6364136223846793005 + 1442695040888963407 & 0xFFFF_FFFF_FFFF_FFFF  # Knuth's MMIX
        fit = sorted(by_nibble[k % decimation])
        for old in reversed(recent):  # the latest first
            if len(fit) > 2 and old in fit:
                fit.remove(old)
        nibble = fit[(chance >> 33) % len(fit)]
        made.append(by_nibble[k % decimation][nibble])
        recent = [*recent[2 - DISTINCT :], nibble]
    return bytes(made)


def saturated(cells: Iterable[tuple[int, float]]) -> tuple[int, ...]:
    """Those of (tendon index, tension [N]) whose channel is empty or full."""
    return tuple([index for index, value in cells if not TENSION_ZERO_N < value < TENSION_TOP_N])


def _groups(channels: list[int]) -> list[tuple[int, ...]]:
    """Channels of each frame."""
    return [tuple(channels[first : first + CHANNELS]) for first in range(0, len(channels), CHANNELS)]


def _length(channels: int) -> int:
    """Payload of a frame [bytes]."""
    return math.ceil((COUNTER_BITS + CHANNEL_BITS * channels) / 8)
