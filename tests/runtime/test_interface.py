"""Test the messages about a CAN interface whose bit rates differ from those in the hand file."""

import json

import pytest

from handctl.runtime.buses.interface_setup import bit_rate_mismatch_text, wrong_bit_rate_text
from handctl.runtime.buses.link_state import parse_link


def ip_output(nominal_bit_rate: int | None, data_bit_rate: int | None) -> str:
    """Return the output of iproute2 6.1 (shortened) about a CAN interface with given bit rates."""
    info = (
        {}
        if nominal_bit_rate is None
        else {"state": "ERROR-ACTIVE", "bittiming": {"bitrate": nominal_bit_rate}}
    )
    info |= {} if data_bit_rate is None else {"data_bittiming": {"bitrate": data_bit_rate}}
    return json.dumps(
        [{"ifname": "can0", "mtu": 72, "linkinfo": {"info_kind": "can", "info_data": info}}]
    )


@pytest.mark.parametrize(
    ("nominal_bit_rate", "data_bit_rate", "required_bit_rate", "expected_message"),
    [
        (None, None, None, ""),
        (1_000_000, None, None, ""),
        (1_000_000, 5_000_000, 5_000_000, ""),
        (1_000_000, 5_000_000, None, ""),
        (
            500_000,
            None,
            None,
            "can0 has a bit rate of 500000 bit/s, the hand file asks for 1000000 bit/s",
        ),
        (1_000_000, None, 5_000_000, "without CAN FD"),
        (1_000_000, 2_000_000, 5_000_000, "a data bit rate of 2000000 bit/s"),
    ],
)
def test_a_bit_rate_other_than_the_hand_files_is_reported(
    nominal_bit_rate: int | None,
    data_bit_rate: int | None,
    required_bit_rate: int | None,
    expected_message: str,
) -> None:
    link = parse_link(ip_output(nominal_bit_rate, data_bit_rate))
    assert link
    line = bit_rate_mismatch_text("can0", link, 1_000_000, required_bit_rate)
    assert expected_message in line
    assert bool(line) == bool(expected_message)


def test_a_missing_interface_has_no_wrong_rate() -> None:
    assert wrong_bit_rate_text("no-such-if", 1_000_000, None) == ""
