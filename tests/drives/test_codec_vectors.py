"""Compare payloads byte by byte with the payloads that documents define.

The documents are CiA 301, CiA 402, and the description of ODrive's CANSimple protocol.
"""

import math
import struct

import pytest

from handctl.drives.canopen import codec as canopen
from handctl.drives.cia402 import codec as cia402
from handctl.drives.mit import codec as mit
from handctl.drives.odrive import codec as odrive
from handctl.drives.signals import SignalTable

STATE_BY_STATUS_WORD = {
    0x0000: cia402.NOT_READY, 0x0040: cia402.SWITCH_ON_DISABLED, 0x0021: cia402.READY_TO_SWITCH_ON,
    0x0023: cia402.SWITCHED_ON,
    0x0027: cia402.OPERATION_ENABLED, 0x0007: cia402.QUICK_STOP, 0x000F: cia402.FAULT_REACTION, 0x0008: cia402.FAULT,
}  # fmt: skip


def test_a_tpdo_is_a_status_word_a_position_and_a_torque() -> None:
    """In a TPDO of a CiA 402 drive, the position is in counts, and the torque is in thousandths of the rated torque."""
    message = cia402.feedback_message(5, 1, 1.0, 1.0, 0.0)
    table = SignalTable(
        message._replace(signals=tuple(signal._replace(scale=1.0) for signal in message.signals))
    )
    assert table.unpack(bytes.fromhex("3706 feffffff 18fc")) == [0x7, 0x1, -2, -1000]
    assert table.unpack(bytes.fromhex("3786 00000080 0080")) == [0x7, 0x1, -(2**31), -(2**15)]
    assert cia402.power_state(0x0637) == cia402.OPERATION_ENABLED
    assert cia402.ENABLED_STATUS == 0x7 << 2 | 0x1


@pytest.mark.parametrize("status_word", STATE_BY_STATUS_WORD)
def test_states_are_distinguished_for_any_other_bits(status_word: int) -> None:
    assert (
        cia402.power_state(status_word)
        == cia402.power_state(status_word | 0x8600)
        == STATE_BY_STATUS_WORD[status_word]
    )


def test_a_word_that_the_standard_does_not_know_is_no_state() -> None:
    assert cia402.power_state(0x0001) == ""
    assert cia402.power_state(0x006F | 0xFF90) == ""


def test_a_command_is_a_control_word_and_a_torque() -> None:
    top = cia402.MAX_TORQUE_COUNT
    command = SignalTable(cia402.command_message(5, 1.0, 1000.0, top))
    assert command.pack(-1000.4).hex(" ") == "0f 00 18 fc"
    assert command.pack(1.0).hex(" ") == "0f 00 01 00"
    assert command.pack(top).hex(" ") == "0f 00 ff 7f"
    for invalid_torque in (math.nan, math.inf, top + 1, -top - 1):
        with pytest.raises(ValueError, match=f"torque .* expected at most {top}"):
            command.pack(invalid_torque)


def test_sdo_requests_have_the_bytes_of_cia_301() -> None:
    assert canopen.upload_request(0x6041, 2).hex(" ") == "40 41 60 02 00 00 00 00"
    assert canopen.upload_request(0x9041, 0xFE).hex(" ") == "40 41 90 fe 00 00 00 00"
    assert canopen.download_request(0x9041, 0xFE, b"\1").hex(" ") == "2f 41 90 fe 01 00 00 00"
    assert canopen.download_request(0x1017, 0, b"\x64\x00").hex(" ") == "2b 17 10 00 64 00 00 00"
    assert canopen.download_request(0x6060, 0, b"\x04").hex(" ") == "2f 60 60 00 04 00 00 00"
    assert canopen.download_request(0x1016, 1, b"\1\2\3\4").hex(" ") == "23 16 10 01 01 02 03 04"


SDO_REPLIES = {
    "80 41 60 02 00 00 02 06": (0x6041, 2, b"", 0x06020000),
    "60 17 10 00 aa bb cc dd": (0x1017, 0, b"", 0),
    "43 18 10 01 01 02 03 04": (0x1018, 1, b"\1\2\3\4", 0),
    "47 18 10 01 01 02 03 04": (0x1018, 1, b"\1\2\3", 0),
    "4b 41 60 00 37 06 ff ff": (0x6041, 0, b"\x37\x06", 0),
    "4f 60 60 00 04 ff ff ff": (0x6060, 0, b"\x04", 0),
}


@pytest.mark.parametrize("reply_hex", SDO_REPLIES)
def test_sdo_replies_are_decoded(reply_hex: str) -> None:
    assert canopen.decode_sdo_reply(bytes.fromhex(reply_hex)) == SDO_REPLIES[reply_hex]


@pytest.mark.parametrize(
    "command_specifier", sorted(set(range(256)) - {0x80, 0x60, 0x43, 0x47, 0x4B, 0x4F})
)
def test_no_other_specifier_is_a_reply(command_specifier: int) -> None:
    assert (
        canopen.decode_sdo_reply(bytes([command_specifier]) + bytes.fromhex("41 60 02 00 00 00 00"))
        is None
    )


def test_error_codes_have_texts() -> None:
    assert cia402.error_text(0x8130).startswith("heartbeat of the master lost")
    assert cia402.error_text(0x12) == "error 0x0012"
    assert canopen.abort_text(0x06010002) == "read-only"
    assert canopen.abort_text(0x12) == "abort 0x00000012"
    assert odrive.error_text(1 << 24 | 1 << 5) == "gate driver fault, watchdog expired"
    assert odrive.error_text(1 | 1 << 31) == "initializing, unknown error bit 31"
    assert odrive.error_text(0) == ""
    assert odrive.error_text(1 << 32) == "", "32 bits"
    assert odrive.result_text(11) == "timeout"
    assert odrive.result_text(99) == "unknown result 99"


def test_odrive_payloads_match_the_vendors_layout() -> None:
    assert odrive.decode_heartbeat(bytes.fromhex("00000001 08 02 01 00")) == (1 << 24, 8, 2)
    assert odrive.decode_heartbeat(bytes.fromhex("00000080 fe ff 01 00")) == (1 << 31, 0xFE, 0xFF)
    assert odrive.message_id(3, 0x0E) == 0x6E
    assert odrive.encode_integers(8, 2**32 - 1).hex(" ") == "08 00 00 00 ff ff ff ff"
    assert odrive.sdo_request(1, 0x0102, b"\x05").hex(" ") == "01 02 01 00 05"
    assert odrive.sdo_request(0, 0x0102).hex(" ") == "00 02 01 00"
    assert odrive.sdo_request(0, 0xFEDC).hex(" ") == "00 dc fe 00"
    assert odrive.decode_sdo_reply(bytes.fromhex("00 02 01 ff 05 06 07 08")) == (
        0x0102,
        b"\5\6\7\x08",
    )


def test_floats_are_finite_both_ways() -> None:
    assert odrive.encode_floats(1.5, -0.25) == struct.pack("<ff", 1.5, -0.25)
    assert odrive.decode_float_pair(struct.pack("<ff", 1.5, -0.25)) == (1.5, -0.25)
    for invalid_number in (math.nan, math.inf, -math.inf):
        assert odrive.decode_float_pair(struct.pack("<ff", invalid_number, 1.0)) is None
        assert odrive.decode_float_pair(struct.pack("<ff", 1.0, invalid_number)) is None
        with pytest.raises(ValueError, match="cannot be sent, expected a finite number"):
            odrive.encode_floats(1.0, invalid_number)
    assert odrive.encode_floats(odrive.MAX_FLOAT32, -odrive.MAX_FLOAT32)
    with pytest.raises(ValueError, match="cannot be sent"):
        odrive.encode_floats(math.nextafter(odrive.MAX_FLOAT32, math.inf))


def test_registers_of_a_damiao_drive() -> None:
    assert mit.register_bytes(mit.TIMEOUT, 1000.9).hex(" ") == "e8 03 00 00", "whole units"
    assert mit.register_bytes(mit.CTRL_MODE, 1).hex(" ") == "01 00 00 00"
    assert mit.register_bytes(mit.PMAX, 12.5) == struct.pack("<f", 12.5)
    reply = mit.decode_register_reply(bytes((3, 0, mit.READ, mit.TIMEOUT)) + b"\xe8\x03\0\0", 3)
    assert reply is not None
    assert (reply.operation, reply.register, reply.value) == (mit.READ, mit.TIMEOUT, 1000.0)
    assert mit.decode_register_reply(bytes((3, 1, mit.READ, mit.TIMEOUT)) + bytes(4), 3) is None, (
        "of node 0x103"
    )
    assert mit.decode_register_reply(bytes((3, 0, 0x77, mit.TIMEOUT)) + bytes(4), 3) is None
    assert mit.decode_register_reply(bytes((4, 0, mit.READ, mit.TIMEOUT)) + bytes(4), 3) is None


def test_register_requests_have_the_bytes_of_the_manual() -> None:
    assert mit.register_request(3, mit.READ, mit.TIMEOUT, 9.0) == bytes(
        (3, 0, mit.READ, mit.TIMEOUT)
    ) + bytes(4)
    assert mit.register_request(0x103, mit.REFRESH) == bytes((3, 1, mit.REFRESH, 0)) + bytes(4)
    write_request = mit.register_request(3, mit.WRITE, mit.PMAX, 12.5)
    assert write_request == bytes((3, 0, mit.WRITE, mit.PMAX)) + struct.pack("<f", 12.5)
    assert mit.register_request(3, mit.WRITE)[3:] == bytes(5), "register 0, value 0"


def test_the_hotter_of_an_odrive_s_two_temperatures_and_one_of_them_if_the_other_has_no_sensor() -> (
    None
):
    assert odrive.decode_highest_temperature(struct.pack("<ff", 31.0, 42.0)) == 42.0
    assert odrive.decode_highest_temperature(struct.pack("<ff", 31.0, math.nan)) == 31.0
    assert odrive.decode_highest_temperature(struct.pack("<ff", math.inf, 42.0)) == 42.0
    assert odrive.decode_highest_temperature(struct.pack("<ff", math.nan, math.nan)) is None
