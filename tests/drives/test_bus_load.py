"""Test the predicted bus load.

Some tests compare the predicted frame times with reference values. Other tests build frames bit by
bit, and count the stuff bits.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handctl.drives.frame_time import bus_time_s, frame_time_s, highest_rate

NOMINAL_BITRATE, DATA_BITRATE = 1_000_000, 5_000_000


@pytest.mark.parametrize(("payload_size", "expected_us"), [(0, 55), (4, 95), (8, 135)])
def test_classical_frame_times_match_reference_values(
    payload_size: int, expected_us: float
) -> None:
    assert frame_time_s(payload_size, False, NOMINAL_BITRATE) * 1e6 == pytest.approx(expected_us)


@pytest.mark.parametrize(
    ("payload_size", "expected_us"), [(4, 48.6), (8, 56.6), (16, 72.6), (32, 105.6), (64, 169.6)]
)
def test_fd_frame_times_match_reference_values(payload_size: int, expected_us: float) -> None:
    assert frame_time_s(payload_size, True, NOMINAL_BITRATE, DATA_BITRATE) * 1e6 == pytest.approx(
        expected_us, rel=0.001
    )


@pytest.mark.parametrize(
    ("can_fd", "motor_count", "cells_per_frame", "expected_us"),
    [
        (False, 4, [8], 1215),
        (False, 11, [8, 8, 8], 3375),
        (True, 4, [12], 517),
        (True, 11, [32], 1351),
    ],
)
def test_tick_time_of_mit_motors_and_load_cells_matches_reference_values(
    can_fd: bool, motor_count: int, cells_per_frame: list[int], expected_us: float
) -> None:
    frames = [(8, can_fd, 2.0 * motor_count), *((size, can_fd, 1.0) for size in cells_per_frame)]
    assert bus_time_s(frames, NOMINAL_BITRATE, DATA_BITRATE) * 1e6 == pytest.approx(
        expected_us, rel=0.001
    )


random_payloads = st.lists(
    st.one_of(st.integers(0, 255), st.sampled_from([0x00, 0x0F, 0xF0, 0xFF])), max_size=8
).map(bytes)
"""Random payloads. Bytes that need many stuff bits are frequent in the payloads."""


def stuff_bits(bit_text: str) -> str:
    """Return bits with stuff bits inserted.

    After five equal bits, a stuff bit with the opposite value follows. The stuff bit is the first
    of the next five bits that are compared.
    """
    out = ""
    for bit in bit_text:
        out += bit
        if len(out) >= 5 and len(set(out[-5:])) == 1:
            out += "10"[int(bit)]
    return out


def crc15(bit_text: str) -> str:
    """Return the CRC-15 of bits, with the polynomial 0x4599. Source: ISO 11898-1."""
    register = 0
    for bit in bit_text:
        top = register >> 14 & 1
        register = register << 1 & 0x7FFF
        if top ^ int(bit):
            register ^= 0x4599
    return format(register, "015b")


@given(st.integers(0, 0x7FF), random_payloads)
def test_no_classical_frame_takes_longer_than_its_worst_case(can_id: int, payload: bytes) -> None:
    header_bits = "0" + format(can_id, "011b") + "000" + format(len(payload), "04b")
    frame_bits = header_bits + "".join(format(byte, "08b") for byte in payload)
    bits = len(stuff_bits(frame_bits + crc15(frame_bits))) + 13
    assert bits / NOMINAL_BITRATE <= frame_time_s(len(payload), False, NOMINAL_BITRATE) + 1e-12


def test_the_worst_case_can_nearly_happen() -> None:
    """A classical CAN frame whose data bits are all 0 has more than 85 % of the bits of the longest possible frame."""
    body = "0" * 19 + "0" * 64
    bits = len(stuff_bits(body + crc15(body))) + 13
    assert bits > 0.85 * 135


@pytest.mark.parametrize("payload_size", range(65))
def test_fd_lengths_round_up(payload_size: int) -> None:
    time_with_brs_s = frame_time_s(payload_size, True, NOMINAL_BITRATE, DATA_BITRATE)
    assert time_with_brs_s <= frame_time_s(
        min(64, payload_size + 1), True, NOMINAL_BITRATE, DATA_BITRATE
    )
    assert time_with_brs_s < frame_time_s(payload_size, True, NOMINAL_BITRATE)


@pytest.mark.parametrize(
    ("bus_times_us", "expected_rate_hz"),
    [([1350.0], 500.0), ([1000.0, 1420.0], 400.0), ([600.0], 1000.0)],
)
def test_the_highest_rate_leaves_three_tenths_of_every_bus(
    bus_times_us: list[float], expected_rate_hz: float
) -> None:
    assert highest_rate(time * 1e-6 for time in bus_times_us) == expected_rate_hz
