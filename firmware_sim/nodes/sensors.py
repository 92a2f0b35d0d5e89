"""The sensor node: load cells and joint encoders, sampled and sent when it sees SYNC.

Frame layout: DBC of the hand, sensor_node; Intel packing, counter in bits 0..3, channel i in bits 4+12i..15+12i.
"""

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from firmware_sim.bus.frame import Frame
from firmware_sim.compiled import compiled, inner
from firmware_sim.description import SensorSpec
from firmware_sim.nodes.noise import Noise

CHANNELS = 5
"""12-bit channels in a frame of 8 bytes, beside the counter."""
TENSION_STEP_N, TENSION_MIN_N = 0.0625, -6.0
JOINT_STEP_RAD, JOINT_ZERO = 2.0 * math.pi / 4096, 2048
JOINT_OFFSET = 0x10
"""Identifier of the first joint frame, from the base."""
_TOP = 4095
_NEVER_NS = 1 << 62
TENSION = (TENSION_MIN_N, TENSION_STEP_N, 0)
JOINT = (0.0, JOINT_STEP_RAD, JOINT_ZERO)
"""Value of the lowest code but for an offset, size of a code, offset of the code."""


class SensorRow(ctypes.Structure):
    """What compiled laws know of ``SensorNode``."""

    _fields_ = [
        *((name, ctypes.c_double) for name in ("tension_noise", "bias_drift", "joint_noise")),
        *((name, ctypes.c_int64) for name in ("base_id", "joint_decimation", "sampled_ns")),
    ]


@compiled("real", "real", "real", "count")
def _code(value: float, low: float, step: float, offset: int) -> int:
    """Return the 12-bit code of a value; 0 and 4095 mean saturated."""
    return min(_TOP, max(0, round((value - low) / step) + offset))


@inner
def payload_size(channels: int) -> int:
    """Return the bytes of a payload, given how many channels are left for it and those after it."""
    return (4 + 12 * min(CHANNELS, channels) + 7) // 8


@compiled("count", "counts", "counts")
def _pack(counter: int, codes: Any, words: Any) -> None:
    """Fill words, of which each is a payload, with the counter (low four bits) and up to five codes."""
    for g in range(len(words)):
        word = counter & 0xF
        for i in range(min(CHANNELS, len(codes) - g * CHANNELS)):
            word |= codes[g * CHANNELS + i] << (4 + 12 * i)
        words[g] = word


@compiled("vector", "real", "real", "count", "count", "counts", "counts")
def encode(values: Any, low: float, step: float, offset: int, counter: int, codes: Any, words: Any) -> None:
    """Pack values by their codes; see ``_code`` and ``_pack``."""
    for i in range(len(values)):
        codes[i] = _code(values[i], low, step, offset)
    _pack(counter, codes, words)


@compiled("vector", "vector", "vector", "real", "real", "vector")
def read_cells(true: Any, bias: Any, chance: Any, drift: float, noise: float, read: Any) -> None:
    """Let each bias walk, and add it and noise to what is true; ``chance``: of each walk, then of the noise."""
    channels = len(true)
    for i in range(channels):
        bias[i] += chance[i] * drift
    for i in range(channels):
        read[i] = true[i] + bias[i] + chance[channels + i] * noise


@inner
def drift_since(node: Any, t_ns: int) -> float:
    """Return the standard deviation of what each bias walks [N] since the last sample; its time is now t_ns.

    After 100 s it is ``bias_drift``.
    """
    elapsed_s = (t_ns - node.sampled_ns) * 1e-9 if node.sampled_ns >= 0 else 0.0
    node.sampled_ns = t_ns
    return float(node.bias_drift * math.sqrt(elapsed_s / 100.0))


@inner
def has_joints(node: Any, joints: int, counter: int) -> bool:
    """Return whether the joint encoders are sent after a SYNC with this counter."""
    return joints > 0 and counter % node.joint_decimation == 0


def tension_code(tension: float) -> int:
    """Return the 12-bit code of a tension [N]; 0 and 4095 mean saturated."""
    return _code(tension, *TENSION)


def joint_code(angle: float) -> int:
    """Return the 12-bit code of a joint angle [rad]."""
    return _code(angle, *JOINT)


class Payloads:
    """The payloads of so many channels."""

    def __init__(self, channels: int) -> None:
        """Args: how many channels."""
        starts = range(0, channels, CHANNELS)
        self._codes, self._words = np.zeros(channels, np.int64), np.zeros(len(starts), np.int64)
        self._sizes = [payload_size(channels - start) for start in starts]

    def of_codes(self, counter: int, codes: Sequence[int]) -> list[bytes]:
        """Return counter (low four bits) and codes, five to a payload, in as few bytes as they need."""
        self._codes[:] = codes
        _pack(counter, self._codes, self._words)
        return self._cut()

    def of_values(self, counter: int, values: Any, low: float, step: float, offset: int) -> list[bytes]:
        """Return the same of the codes of values, shape (channels,)."""
        encode(values, low, step, offset, counter, self._codes, self._words)
        return self._cut()

    def _cut(self) -> list[bytes]:
        raw = self._words.astype("<i8", copy=False).tobytes()
        return [raw[8 * g : 8 * g + size] for g, size in enumerate(self._sizes)]


def pack(counter: int, codes: Sequence[int]) -> bytes:
    """Return counter (low four bits) and up to five codes in as few bytes as they need."""
    (payload,) = Payloads(len(codes)).of_codes(counter, codes)
    return payload


class SensorNode:
    """The node.

    Attributes:
        bias: slow error of each load cell [N]. misread, misread_joints: faults by channel.
        mute: what is called in place of sending a frame, by its identifier.
        ids: of SYNC. malformed: SYNC frames of a wrong length. wake_ns: never.
    """

    def __init__(self, spec: SensorSpec, tensions: Callable[[], Any], angles: Callable[[], Any], seed: int) -> None:
        """Args: description; true tensions [N] and joint angles [rad], arrays in the node's own order; noise's seed."""
        self._spec, self._tensions, self._angles = spec, tensions, angles
        self.tension_noise, self.bias_drift, self.joint_noise = spec.tension_noise, spec.bias_drift, spec.joint_noise
        self.base_id, self.joint_decimation = spec.base_id, spec.joint_decimation
        self.noise = Noise(f"sensors {seed}")
        self.bias: Any = np.full(len(spec.tendons), spec.tension_bias)
        self._values: Any = np.zeros(len(spec.tendons))
        self._payloads = Payloads(len(spec.tendons)), Payloads(len(spec.joints))
        self.misread: dict[int, Callable[[float], float]] = {}
        self.misread_joints: dict[int, Callable[[float], float]] = {}
        self.mute: dict[int, Callable[[], None]] = {}
        self.sampled_ns = -1
        self.ids = frozenset((spec.sync_id,))
        self.malformed = 0
        self.wake_ns = _NEVER_NS

    @property
    def cyclic(self) -> tuple[int, ...]:
        """Identifiers of the frames that come in every tick."""
        return (self._spec.sync_id,)

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Return tension frames, and joint frames when it is their turn; None if the frame is not SYNC."""
        if frame.can_id != self._spec.sync_id:
            return None
        if len(frame.data) != 1:
            self.malformed += 1
            return []
        spec, counter, (cells, encoders) = self._spec, frame.data[0], self._payloads
        payloads = [*enumerate(cells.of_values(counter, self._sample(t_ns), *TENSION), spec.base_id)]
        if has_joints(self, len(spec.joints), counter):
            read = _wrong(self._angles() + self.noise.take(len(spec.joints)) * spec.joint_noise, self.misread_joints)
            payloads += enumerate(encoders.of_values(counter, read, *JOINT), spec.base_id + JOINT_OFFSET)
        sent = [Frame(can_id, data, frame.flags, frame.bus, t_ns) for can_id, data in payloads]
        return self._spoken(sent) if self.mute else sent

    def _spoken(self, frames: list[Frame]) -> list[Frame]:
        """Return frames that are not mute."""
        for frame in frames:
            if frame.can_id in self.mute:
                self.mute[frame.can_id]()
        return [frame for frame in frames if frame.can_id not in self.mute]

    def _sample(self, t_ns: int) -> Any:
        """Return what the load cells read [N]."""
        drift, chance = drift_since(self, t_ns), self.noise.take(2 * len(self.bias))
        read_cells(self._tensions(), self.bias, chance, drift, self.tension_noise, self._values)
        return _wrong(self._values, self.misread)

    def wake(self, t_ns: int) -> None:
        """Do nothing: this node acts on SYNC only."""


class SensorNodeRow(SensorRow, SensorNode):
    """A node of which compiled laws know."""

    def prepare(self, spec: SensorSpec, tensions: Callable[[], Any], angles: Callable[[], Any], seed: int) -> None:
        """Fill the row; see ``SensorNode``."""
        SensorNode.__init__(self, spec, tensions, angles, seed)


def _wrong(read: Any, faults: dict[int, Callable[[float], float]]) -> Any:
    """Readings with the faults of some channels."""
    for i, fault in sorted(faults.items()):
        read[i] = fault(float(read[i]))
    return read
