"""Compare frames of the MIT protocol with strings of bits that were written by hand from the fact sheet."""

import os
import subprocess
import sys
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim.compiled import compile_module_kernels
from firmware_sim.nodes.mit import codec as mit_codec
from firmware_sim.nodes.mit.codec import (
    MitRanges,
    code_to_value,
    decode_command,
    encode_feedback,
    value_to_code,
)

MIT_RANGES = MitRanges(12.5, 50.0, 0.8)


def packed_bits(*values_and_widths: tuple[int, int]) -> bytes:
    """Pack fields (value, width) into bytes, using a string of binary digits.

    The first field is in the highest bits of the returned bytes.
    """
    text = "".join(format(value, f"0{width}b") for value, width in values_and_widths)
    return bytes(int(text[i : i + 8], 2) for i in range(0, len(text), 8))


def test_the_command_of_zeros_that_every_client_sends() -> None:
    command = decode_command(bytes.fromhex("7fff7ff0000007ff"), MIT_RANGES)
    assert command.kp == 0.0
    assert command.kd == 0.0
    # No torque code of the MIT protocol stands for exactly 0 N m. The nearest torque code stands
    # for half a resolution step below 0 N m.
    assert command.position == pytest.approx(-12.5 / 65535)
    assert command.velocity == pytest.approx(-50.0 / 4095)
    assert command.torque == pytest.approx(-0.8 / 4095)


def test_each_field_lies_where_the_fact_sheet_says() -> None:
    data = packed_bits((0xFFFF, 16), (0, 12), (0xFFF, 12), (0, 12), (0xFFF, 12))
    command = decode_command(data, MIT_RANGES)
    assert command == pytest.approx((12.5, -50.0, 500.0, 0.0, 0.8))
    data = packed_bits((0, 16), (0xFFF, 12), (0, 12), (0xFFF, 12), (0, 12))
    assert decode_command(data, MIT_RANGES) == pytest.approx((-12.5, 50.0, 0.0, 5.0, -0.8))


@given(st.tuples(*[st.integers(0, 4095)] * 4), st.integers(0, 65535))
def test_a_command_is_read_exactly(command_codes: tuple[int, int, int, int], position: int) -> None:
    v, kp, kd, torque = command_codes
    command = decode_command(
        packed_bits((position, 16), (v, 12), (kp, 12), (kd, 12), (torque, 12)), MIT_RANGES
    )
    exact_value = (
        Fraction(position) * 25 / 65535 - Fraction(25, 2),
        Fraction(v) * 100 / 4095 - 50,
        Fraction(kp) * 500 / 4095,
        Fraction(kd) * 5 / 4095,
        Fraction(torque) * Fraction(8, 5) / 4095 - Fraction(4, 5),
    )
    assert command == pytest.approx([float(value) for value in exact_value], abs=1e-12)


def test_feedback_byte_by_byte() -> None:
    data = encode_feedback(0xD, 0x13, (12.5, -50.0, 0.8), MIT_RANGES, (25.9, 300.0))
    assert data == bytes([0xD3, 0xFF, 0xFF, 0x00, 0x0F, 0xFF, 25, 255])
    assert encode_feedback(1, 4, (0.0, 0.0, 0.0), MIT_RANGES, (-3.0, 0.0)) == bytes.fromhex(
        "147fff7ff7ff0000"
    )


@given(st.floats(-15.0, 15.0))
def test_codes_are_truncated_and_saturate(value: float) -> None:
    code = value_to_code(value, 12.5, 16)
    assert 0 <= code <= 65535
    code_value = code_to_value(code, 12.5, 16)
    assert code_value <= max(value, -12.5) + 1e-9
    assert value >= 12.5 or code_value > min(value, 12.5) - 25.0 / 65535 - 1e-9


@given(st.integers(0, 65535))
def test_the_middle_of_a_code_comes_back(code: int) -> None:
    assert value_to_code(code_to_value(code, 12.5, 16) + 0.5 * 25.0 / 65535, 12.5, 16) == code


MOTION_VALUES = st.tuples(*[st.floats(-60.0, 60.0)] * 3)


@given(st.integers(0, 255), MOTION_VALUES, st.floats(-50.0, 300.0), st.integers(0, 2**64 - 1))
def test_compiled_kernels_equal_python(
    first_byte: int, motion_values: tuple[float, ...], temperature_degC: float, state_word: int
) -> None:
    """The compiled kernels and the functions of the codec module give the same values.

    In this test, the functions of the codec module run as Python code, unless another test has
    compiled them.
    """
    kernels, signed = compile_module_kernels(mit_codec), state_word - (state_word >> 63 << 64)
    feedback = (first_byte, *motion_values, *MIT_RANGES, temperature_degC, temperature_degC)
    python_word = mit_codec.write_feedback(*feedback)
    assert (
        kernels.write_feedback(*feedback)
        == kernels.write_feedback.py_func(*feedback)
        == python_word
    )
    assert kernels.read_command(signed, *MIT_RANGES) == kernels.read_command.py_func(
        signed, *MIT_RANGES
    )


def test_kernels_compile_without_a_cache_folder() -> None:
    code = (
        "from firmware_sim.compiled import use_compiled_kernels; "
        "from firmware_sim.nodes.mit import codec; use_compiled_kernels(codec)"
    )
    environment_without_cache = os.environ | {"NUMBA_CACHE_LOCATOR_CLASSES": "ZipCacheLocator"}
    subprocess.run([sys.executable, "-c", code], env=environment_without_cache, check=True)
