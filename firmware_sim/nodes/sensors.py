"""The sensor node: load cells and joint encoders, sampled and sent when it sees SYNC.

Frame layout: DBC of the hand, sensor_node; Intel packing, counter in bits 0..3, channel i in bits 4+12i..15+12i.
"""

import math
import random
from collections.abc import Callable, Sequence

from firmware_sim.description import SensorSpec
from firmware_sim.frame import Frame

CHANNELS = 5
"""12-bit channels in a frame of 8 bytes, beside the counter."""
TENSION_STEP_N, TENSION_MIN_N = 0.0625, -6.0
JOINT_STEP_RAD, JOINT_ZERO = 2.0 * math.pi / 4096, 2048
JOINT_OFFSET = 0x10
"""Identifier of the first joint frame, from the base."""
_TOP = 4095
_NEVER_NS = 1 << 62


def tension_code(tension: float) -> int:
    """Return the 12-bit code of a tension [N]; 0 and 4095 mean saturated."""
    return min(_TOP, max(0, round((tension - TENSION_MIN_N) / TENSION_STEP_N)))


def joint_code(angle: float) -> int:
    """Return the 12-bit code of a joint angle [rad]."""
    return min(_TOP, max(0, round(angle / JOINT_STEP_RAD) + JOINT_ZERO))


def pack(counter: int, codes: Sequence[int]) -> bytes:
    """Return counter (low four bits) and up to five codes in as few bytes as they need."""
    word = counter & 0xF
    for i, code in enumerate(codes):
        word |= code << (4 + 12 * i)
    return word.to_bytes((4 + 12 * len(codes) + 7) // 8, "little")


class SensorNode:
    """The node.

    Attributes:
        bias: slow error of each load cell [N]. misread, misread_joints: faults by channel.
        malformed: SYNC frames of a wrong length. wake_ns: never.
    """

    def __init__(
        self, spec: SensorSpec, tensions: Callable[[], list[float]], angles: Callable[[], list[float]], seed: int
    ) -> None:
        """Args: description; true tensions [N] and joint angles [rad] in the node's own order; seed of the noise."""
        self._spec, self._tensions, self._angles = spec, tensions, angles
        self._chance = random.Random(f"sensors {seed}")
        self.bias = [spec.tension_bias] * len(spec.tendons)
        self.misread: dict[int, Callable[[float], float]] = {}
        self.misread_joints: dict[int, Callable[[float], float]] = {}
        self._sampled_ns = -1
        self.malformed = 0
        self.wake_ns = _NEVER_NS

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Return tension frames, and joint frames when it is their turn; None if the frame is not SYNC."""
        if frame.can_id != self._spec.sync_id:
            return None
        if len(frame.data) != 1:
            self.malformed += 1
            return []
        counter, base = frame.data[0], self._spec.base_id
        payloads = self._group(base, counter, [tension_code(value) for value in self._sample(t_ns)])
        if self._spec.joints and counter % self._spec.joint_decimation == 0:
            noise = self._spec.joint_noise
            read = [angle + self._chance.gauss(0.0, noise) for angle in self._angles()]
            codes = [joint_code(angle) for angle in _wrong(read, self.misread_joints)]
            payloads += self._group(base + JOINT_OFFSET, counter, codes)
        return [Frame(can_id, data, frame.flags, frame.bus, t_ns) for can_id, data in payloads]

    def _sample(self, t_ns: int) -> list[float]:
        self._drift(t_ns)
        gauss, noise = self._chance.gauss, self._spec.tension_noise
        read = [f + bias + gauss(0.0, noise) for f, bias in zip(self._tensions(), self.bias, strict=True)]
        return _wrong(read, self.misread)

    def _drift(self, t_ns: int) -> None:
        """Let each bias walk at random: after 100 s its standard deviation is ``bias_drift``."""
        elapsed_s = (t_ns - self._sampled_ns) * 1e-9 if self._sampled_ns >= 0 else 0.0
        self._sampled_ns = t_ns
        step = self._spec.bias_drift * math.sqrt(elapsed_s / 100.0)
        self.bias = [bias + self._chance.gauss(0.0, step) for bias in self.bias]

    @staticmethod
    def _group(first_id: int, counter: int, codes: list[int]) -> list[tuple[int, bytes]]:
        starts = range(0, len(codes), CHANNELS)
        return [(first_id + g, pack(counter, codes[start : start + CHANNELS])) for g, start in enumerate(starts)]

    def wake(self, t_ns: int) -> None:
        """Do nothing: this node acts on SYNC only."""


def _wrong(read: list[float], faults: dict[int, Callable[[float], float]]) -> list[float]:
    """Readings with the faults of some channels."""
    return [faults[i](value) if i in faults else value for i, value in enumerate(read)] if faults else read
