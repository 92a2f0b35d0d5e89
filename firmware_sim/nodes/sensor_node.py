"""The simulated sensor node of a hand.

When a SYNC frame arrives, the sensor node reads the load cells and joint encoders, and sends the
readings.

Frame (up to 8 bytes, bits numbered from the lowest bit of byte 0, Intel order):

    bit  0..3        counter of the SYNC
    bit  4..15       code of channel 0
    bit  4+12i..15+12i   code of channel i, i up to 4

    tension code     (tension + 6 N) / 0.0625 N, 0 and 4095 mean saturated
    joint code       2048 + angle / (2 pi rad / 4096), or 2048 + position / 50 um

The first tension frame has the base identifier. The first joint frame has the base identifier +
0x10. Each further tension frame or joint frame has the next higher identifier. A frame with fewer
than five channels has only as many bytes as its channels need. Source: node ``sensor_node`` in the
DBC file of the hand.
"""

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from firmware_sim.bus.frame import Frame
from firmware_sim.compiled import compiled, kernel_helper
from firmware_sim.description.hand_description import SensorSpec
from firmware_sim.nodes.noise import NormalNoise

CHANNELS_PER_FRAME = 5
"""Number of 12-bit channels that fit beside the counter into a frame of 8 bytes."""
TENSION_STEP_N = 0.0625
"""Resolution of a tension code [N]."""
TENSION_MIN_N = -6.0
"""Tension that the code 0 stands for [N]."""
JOINT_STEP_RAD = 2.0 * math.pi / 4096
"""Resolution of a joint code [rad]."""
JOINT_STEP_M = 5e-5
"""Resolution of the code of a prismatic joint [m]."""
MAX_JOINT_CHANNELS = 80
"""Largest number of joint channels: five channels in each of the 16 joint frames."""
JOINT_ZERO_CODE = 2048
"""Joint code of the joint angle zero."""
JOINT_OFFSET = 0x10
"""Identifier of the first joint frame minus the base identifier."""
_MAX_CHANNEL_CODE = 4095
"""Largest 12-bit code."""
_NEVER_NS = 1 << 62
"""Time of an event that will not happen [ns]."""
TENSION_CODE = (TENSION_MIN_N, TENSION_STEP_N, 0)
"""Parameters of a tension code: tension at code 0, resolution and offset of the code."""
JOINT_CODE = (0.0, JOINT_STEP_RAD, JOINT_ZERO_CODE)
"""Parameters of a joint code: angle at code 0 before the offset is added, resolution, and offset of the code."""


class SensorStruct(ctypes.Structure):
    """Memory layout of the state of a ``SensorNode``, for compiled kernels."""

    _fields_ = [
        *((name, ctypes.c_double) for name in ("tension_noise", "bias_drift")),
        ("joint_noise", ctypes.c_double * MAX_JOINT_CHANNELS),
        ("joint_scale", ctypes.c_double * MAX_JOINT_CHANNELS),
        *((name, ctypes.c_int64) for name in ("base_id", "joint_decimation", "sampled_ns")),
    ]


@compiled("real", "real", "real", "count")
def _encode_value(value: float, low: float, step: float, offset: int) -> int:
    """Return the 12-bit code of a value.

    The codes 0 and 4095 mean that the encoded value is outside of the range of the codes.
    """
    # In Python and in compiled code, round() rounds a half to the nearest even number.
    return min(_MAX_CHANNEL_CODE, max(0, round((value - low) / step) + offset))


@kernel_helper
def payload_size(channels: int) -> int:
    """Return the size of a payload [bytes].

    The argument ``channels`` is the total number of channels in this payload and in all following
    payloads.
    """
    return (4 + 12 * min(CHANNELS_PER_FRAME, channels) + 7) // 8


@compiled("count", "counts", "counts")
def _pack_codes(counter: int, codes: Any, words: Any) -> None:
    """Pack the low four bits of a counter and up to five codes into each word.

    Args:
        counter: counter in the SYNC frame.
        codes: (channels,) code of each channel.
        words: payloads as integers, written by the kernel.
    """
    for g in range(len(words)):
        word = counter & 0xF
        for i in range(min(CHANNELS_PER_FRAME, len(codes) - g * CHANNELS_PER_FRAME)):
            word |= codes[g * CHANNELS_PER_FRAME + i] << (4 + 12 * i)
        words[g] = word


@compiled("vector", "real", "real", "count", "count", "counts", "counts")
def encode(
    values: Any, low: float, step: float, offset: int, counter: int, codes: Any, words: Any
) -> None:
    """Encode the values of channels, and pack the codes of the values into payloads.

    The kernels ``_encode_value`` and ``_pack_codes`` explain the format.

    Args:
        values: (channels,) value of each channel.
        low: value of code 0 before the offset is added.
        step: difference of the values of two neighbouring codes.
        offset: offset of the code.
        counter: counter in the SYNC frame.
        codes: array for the codes, filled by the kernel, shape (channels,).
        words: payloads as integers, written by the kernel.
    """
    for i in range(len(values)):
        codes[i] = _encode_value(values[i], low, step, offset)
    _pack_codes(counter, codes, words)


@compiled("vector", "vector", "vector", "real", "real", "vector")
def read_cells(
    true_tensions: Any, bias: Any, normal_numbers: Any, drift: float, noise: float, readings: Any
) -> None:
    """Compute the readings of the load cells.

    A reading is the sum of the true tension, the bias of the load cell, and noise. The bias is a
    random walk.

    Args:
        true_tensions: true tension of each cell [N].
        bias: bias of each load cell [N], which the kernel updates.
        normal_numbers: random numbers with a normal distribution: one for the bias drift of each
            load cell, then one for the noise of each load cell.
        drift: standard deviation of the change of the bias since the last sample [N].
        noise: standard deviation of the noise in a reading [N].
        readings: reading of each load cell [N], written by the kernel.
    """
    channels = len(true_tensions)
    for i in range(channels):
        bias[i] += normal_numbers[i] * drift
    for i in range(channels):
        readings[i] = true_tensions[i] + bias[i] + normal_numbers[channels + i] * noise


@kernel_helper
def bias_drift_deviation(node: Any, t_ns: int) -> float:
    """Return the standard deviation of the change of the load-cell bias since the last sample [N].

    The function also stores the time of the present sample in the node.

    The bias is a random walk. Its standard deviation 100 s after the start is ``node.bias_drift``
    [N].
    """
    elapsed_s = (t_ns - node.sampled_ns) * 1e-9 if node.sampled_ns >= 0 else 0.0
    node.sampled_ns = t_ns
    return float(node.bias_drift * math.sqrt(elapsed_s / 100.0))


@kernel_helper
def has_joint_reading(node: Any, joints: int, counter: int) -> bool:
    """Return True if the answer to a SYNC frame with the given counter contains joint frames."""
    return joints > 0 and counter % node.joint_decimation == 0


def tension_code(tension: float) -> int:
    """Return the 12-bit code of a tension [N].

    The codes 0 and 4095 mean that the tension is outside of the range of the codes.
    """
    return _encode_value(tension, *TENSION_CODE)


def joint_code(angle: float) -> int:
    """Return the 12-bit code of a joint angle [rad]."""
    return _encode_value(angle, *JOINT_CODE)


class PayloadEncoder:
    """Encoder that packs a fixed number of channels into payloads."""

    def __init__(self, channels: int) -> None:
        """Allocate memory for codes and payloads.

        Args:
            channels: number of channels.
        """
        start_indices = range(0, channels, CHANNELS_PER_FRAME)
        self._codes = np.zeros(channels, np.int64)
        self._words = np.zeros(len(start_indices), np.int64)
        self._sizes = [payload_size(channels - start) for start in start_indices]

    def encode_codes(self, counter: int, codes: Sequence[int]) -> list[bytes]:
        """Pack the low four bits of a counter and up to five codes into each payload.

        Each payload is as short as possible.
        """
        self._codes[:] = codes
        _pack_codes(counter, self._codes, self._words)
        return self._payload_bytes()

    def encode_values(
        self, counter: int, values: Any, low: float, step: float, offset: int
    ) -> list[bytes]:
        """Encode the values of channels, and pack the codes into payloads.

        The kernel ``encode`` explains the arguments.
        """
        encode(values, low, step, offset, counter, self._codes, self._words)
        return self._payload_bytes()

    def _payload_bytes(self) -> list[bytes]:
        """Convert the payloads from integers to bytes, without unused bytes."""
        raw_bytes = self._words.astype("<i8", copy=False).tobytes()
        return [raw_bytes[8 * g : 8 * g + size] for g, size in enumerate(self._sizes)]


def pack(counter: int, codes: Sequence[int]) -> bytes:
    """Pack the low four bits of a counter and up to five codes into the shortest payload."""
    (payload,) = PayloadEncoder(len(codes)).encode_codes(counter, codes)
    return payload


class SensorNode:
    """The simulated sensor node of a hand.

    Attributes:
        bias: present bias of each load cell [N].
        cell_faults: for each channel, the function by which a fault changes the reading of the load
            cell.
        joint_faults: for each channel, the function by which a fault changes the reading of the
            joint encoder.
        suppressed: functions by the identifier of a frame. The node calls the function instead of
            sending the frame.
        ids: set with the identifier of SYNC.
        malformed_frame_count: number of SYNC frames of a wrong length.
        wake_ns: a time that is never reached, because the node does not need to be woken.
    """

    def __init__(
        self, spec: SensorSpec, tensions: Callable[[], Any], angles: Callable[[], Any], seed: int
    ) -> None:
        """Set up the sensor node.

        Args:
            spec: description of the sensor node.
            tensions: function that returns the true tensions in the order of the channels [N].
            angles: function that returns the true joint angles in the order of the channels [rad].
            seed: seed of the noise of all readings.
        """
        self._spec = spec
        self._tensions = tensions
        self._angles = angles
        self.tension_noise = spec.tension_noise
        self.bias_drift = spec.bias_drift
        # The position of a prismatic joint is encoded as the angle that has the same code.
        is_prismatic = [joint in spec.prismatic for joint in spec.joints]
        rad_per_m = JOINT_STEP_RAD / JOINT_STEP_M
        noise = spec.travel_noise * rad_per_m
        self.joint_scale = tuple(rad_per_m if slide else 1.0 for slide in is_prismatic)
        self.joint_noise = tuple(noise if slide else spec.joint_noise for slide in is_prismatic)
        self.base_id = spec.base_id
        self.joint_decimation = spec.joint_decimation
        self.noise = NormalNoise(f"sensors {seed}")
        self.bias: Any = np.full(len(spec.tendons), spec.tension_bias)
        self._values: Any = np.zeros(len(spec.tendons))
        self._payloads = PayloadEncoder(len(spec.tendons)), PayloadEncoder(len(spec.joints))
        self.cell_faults: dict[int, Callable[[float], float]] = {}
        self.joint_faults: dict[int, Callable[[float], float]] = {}
        self.suppressed: dict[int, Callable[[], None]] = {}
        self.sampled_ns = -1
        self.ids = frozenset((spec.sync_id,))
        self.malformed_frame_count = 0
        self.wake_ns = _NEVER_NS

    @property
    def nodes(self) -> list["SensorNode"]:
        """Return a list with this node, which is the only node that reads the sensors."""
        return [self]

    def frame_id_of_cell(self, index: int) -> int:
        """Return the identifier of the frame with the reading of a load cell."""
        return self._spec.base_id + index // CHANNELS_PER_FRAME

    @property
    def cyclic_ids(self) -> tuple[int, ...]:
        """Return the identifiers of the frames that the node receives in every tick."""
        return (self._spec.sync_id,)

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Answer a SYNC frame with tension frames, and with joint frames if joint frames are due.

        Returns:
            The answers, or None if the frame is not a SYNC frame.
        """
        if frame.can_id != self._spec.sync_id:
            return None
        if len(frame.data) != 1:
            self.malformed_frame_count += 1
            return []
        spec, counter, (cells, encoders) = self._spec, frame.data[0], self._payloads
        payloads = [
            *enumerate(
                cells.encode_values(counter, self._sample_load_cells(t_ns), *TENSION_CODE),
                spec.base_id,
            )
        ]
        if has_joint_reading(self, len(spec.joints), counter):
            count = len(spec.joints)
            angles = self._angles() * np.array(self.joint_scale[:count])
            noise = self.noise.take(count) * np.array(self.joint_noise[:count])
            readings = _readings_with_faults(angles + noise, self.joint_faults)
            payloads += enumerate(
                encoders.encode_values(counter, readings, *JOINT_CODE), spec.base_id + JOINT_OFFSET
            )
        sent_frames = [
            Frame(can_id, data, frame.flags, frame.bus, t_ns) for can_id, data in payloads
        ]
        return self._without_suppressed_frames(sent_frames) if self.suppressed else sent_frames

    def _without_suppressed_frames(self, frames: list[Frame]) -> list[Frame]:
        """Return the frames that no fault suppresses."""
        for frame in frames:
            if frame.can_id in self.suppressed:
                self.suppressed[frame.can_id]()
        return [frame for frame in frames if frame.can_id not in self.suppressed]

    def _sample_load_cells(self, t_ns: int) -> Any:
        """Sample the load cells and return their readings [N]."""
        drift = bias_drift_deviation(self, t_ns)
        normal = self.noise.take(2 * len(self.bias))
        read_cells(self._tensions(), self.bias, normal, drift, self.tension_noise, self._values)
        return _readings_with_faults(self._values, self.cell_faults)

    def wake(self, t_ns: int) -> None:
        """Do nothing, because this node acts only on SYNC frames."""


class SensorNodeRow(SensorStruct, SensorNode):
    """A simulated sensor node whose state is in an array row, for compiled kernels."""

    def initialise(
        self, spec: SensorSpec, tensions: Callable[[], Any], angles: Callable[[], Any], seed: int
    ) -> None:
        """Set the row of the node to the state after power-up.

        The class ``SensorNode`` explains the arguments.
        """
        SensorNode.__init__(self, spec, tensions, angles, seed)


def _readings_with_faults(
    readings: Any, fault_functions: dict[int, Callable[[float], float]]
) -> Any:
    """Apply the faults of single channels to the readings of these channels, and return all readings."""
    for i, fault in sorted(fault_functions.items()):
        readings[i] = fault(float(readings[i]))
    return readings
