"""Test that python-can receives the CAN frames of a running hand.

If python-can receives a frame, programs such as candump and BUSMASTER can receive the frame as
well.
"""

import can
import pytest


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b"\x01\x02"),
        can.Message(arbitration_id=0x1FFFFFFF, is_extended_id=True, data=bytes(8)),
        can.Message(
            arbitration_id=0x42,
            is_extended_id=False,
            is_fd=True,
            bitrate_switch=True,
            data=bytes(range(64)),
        ),
    ],
    ids=["classical", "extended", "fd"],
)
def test_a_message_crosses_vcan(message: can.Message) -> None:
    with (
        can.Bus("vcan0", interface="socketcan", fd=True) as sender,
        can.Bus("vcan0", interface="socketcan", fd=True) as receiver,
    ):
        sender.send(message)
        received_message = receiver.recv(timeout=20.0)
    assert received_message is not None
    assert received_message.equals(
        message, timestamp_delta=None, check_channel=False, check_direction=False
    )
