"""Test the simulated sensor node.

The bits of the simulated frames must equal bits that a developer wrote by hand. The simulated noise
must have the right statistics.
"""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim.bus.frame import Frame
from firmware_sim.description.hand_description import SensorSpec, load_hand
from firmware_sim.nodes.noise import NOISE_BLOCK_SIZE, NormalNoise
from firmware_sim.nodes.sensor_node import SensorNode, joint_code, pack, tension_code

JAMIA11_SENSORS = load_hand("jamia11").sensors
assert JAMIA11_SENSORS is not None
ELEVEN_CELLS: SensorSpec = JAMIA11_SENSORS
SYNC_ID = ELEVEN_CELLS.sync_id


def make_node(
    sensor_spec: SensorSpec = ELEVEN_CELLS, tension: float = 20.0, angle: float = 0.5, seed: int = 0
) -> SensorNode:
    tendons, joints = len(sensor_spec.tendons), len(sensor_spec.joints)
    return SensorNode(
        sensor_spec, lambda: np.full(tendons, tension), lambda: np.full(joints, angle), seed
    )


def channel_counts(data: bytes) -> tuple[int, list[int]]:
    """Return the counter and the 12-bit load-cell channels of a payload.

    The function reads counter and channels from a string of binary digits, which begins with the
    lowest bit of the payload.
    """
    text = "".join(format(byte, "08b")[::-1] for byte in data)
    count = (len(text) - 4) // 12
    return int(text[:4][::-1], 2), [
        int(text[4 + 12 * i : 16 + 12 * i][::-1], 2) for i in range(count)
    ]


@given(st.integers(0, 255), st.lists(st.integers(0, 4095), min_size=1, max_size=5))
def test_payloads_are_packed_as_on_the_wire(sync_counter: int, channel_codes: list[int]) -> None:
    data = pack(sync_counter, channel_codes)
    assert len(data) == math.ceil((4 + 12 * len(channel_codes)) / 8)
    received_counter, values = channel_counts(data)
    assert received_counter == sync_counter % 16
    assert values[: len(channel_codes)] == channel_codes


def test_a_frame_is_packed_byte_by_byte() -> None:
    # The counter of the payload is 5. The tension code of 0 N is 96, that of 110 N is 1856, and
    # that of a saturated load cell is 4095. From the lowest digit on, the payload has the
    # hexadecimal digits 5, 060, 740, fff.
    assert pack(0x35, [96, 1856, 4095]) == bytes.fromhex("050640f7ff")


@pytest.mark.parametrize(
    ("tension_N", "expected_code"),
    [(0.0, 96), (110.0, 1856), (-6.0, 0), (-50.0, 0), (249.9, 4094), (500.0, 4095)],
)
def test_tension_codes(tension_N: float, expected_code: int) -> None:
    assert tension_code(tension_N) == expected_code


@pytest.mark.parametrize(
    ("angle_deg", "expected_code"),
    [(0.0, 2048), (90.0, 3072), (-90.0, 1024), (-400.0, 0), (400.0, 4095)],
)
def test_joint_codes(angle_deg: float, expected_code: int) -> None:
    assert joint_code(math.radians(angle_deg)) == expected_code


def test_the_node_answers_sync_alone() -> None:
    sensors = make_node()
    assert sensors.receive(Frame(SYNC_ID + 1, b"\0"), 0) is None
    assert sensors.receive(Frame(SYNC_ID, b""), 0) == []
    assert sensors.malformed_frame_count == 1


def test_frames_and_counters_after_sync() -> None:
    sensors = make_node()
    for counter in range(32):
        frames = sensors.receive(Frame(SYNC_ID, bytes([counter]), bus=0), counter) or []
        ids = [frame.can_id for frame in frames]
        tension = [ELEVEN_CELLS.base_id + g for g in range(3)]
        joints = [ELEVEN_CELLS.base_id + 0x10 + g for g in range(3)] if counter % 4 == 0 else []
        assert ids == tension + joints
        assert all(channel_counts(frame.data)[0] == counter % 16 for frame in frames)
    assert [len(frame.data) for frame in frames[:3]] == [8, 8, 2]


def test_noise_has_the_size_of_the_hand_file_and_is_white() -> None:
    sensors = make_node(replace(ELEVEN_CELLS, bias_drift=0.0))
    values = []
    for k in range(2000):
        frames = sensors.receive(Frame(SYNC_ID, bytes([k & 255])), k * 1_000_000) or []
        values.append(
            [code * 0.0625 - 6.0 for frame in frames[:3] for code in channel_counts(frame.data)[1]]
        )
    noise = np.array(values) - 20.0
    assert noise.std() == pytest.approx(ELEVEN_CELLS.tension_noise, rel=0.03)
    assert abs(noise.mean()) < 0.02
    assert abs(np.mean(noise[1:] * noise[:-1])) < 0.01
    assert abs(np.mean(noise[:, 0] * noise[:, 1])) < 0.03, "the noise of two channels is correlated"


def test_drift_is_a_random_walk_of_the_given_size() -> None:
    ends = []
    for seed in range(30):
        sensors = make_node(seed=seed)
        for k in range(101):
            sensors.receive(Frame(SYNC_ID, b"\1"), k * 1_000_000_000)
        ends += sensors.bias.tolist()
    assert np.std(ends) == pytest.approx(ELEVEN_CELLS.bias_drift, rel=0.15)


def test_drift_does_not_depend_on_the_sample_rate() -> None:
    spread = {}
    for step_ms in (10, 1000):
        ends = []
        for seed in range(20):
            sensors = make_node(seed=seed)
            for k in range(10_000 // step_ms + 1):
                sensors.receive(Frame(SYNC_ID, b"\1"), k * step_ms * 1_000_000)
            ends += sensors.bias.tolist()
        spread[step_ms] = float(np.std(ends))
    assert spread[10] == pytest.approx(spread[1000], rel=0.2)


def test_noise_equals_pythons_generator() -> None:
    noise, rng = NormalNoise("a seed"), random.Random("a seed")
    noise_samples = [float(number) for k in range(200) for number in noise.take(k % 12)]
    assert len(noise_samples) > 2 * NOISE_BLOCK_SIZE
    assert noise_samples == pytest.approx([rng.gauss(0.0, 1.0) for _ in noise_samples], rel=1e-14)


def test_equal_seeds_give_equal_readings() -> None:
    answers = [
        [make_node(seed=seed).receive(Frame(SYNC_ID, bytes([k])), k) for k in range(3)]
        for seed in (1, 1, 2)
    ]
    assert answers[0] == answers[1]
    assert answers[0] != answers[2]
