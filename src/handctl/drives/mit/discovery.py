"""Discovery of Damiao motors.

A scan reads register MST_ID from every node number, then the other registers of each discovered
motor. A request to read a register causes no torque. Because register replies have the same
identifiers as feedback, a scan sends no request while another host controls the motors
(``other_host_frames``). CubeMars motors have no registers, and a scan cannot discover them without
a command. Source: Damiao DM-J4310-2EC manual, register table.
"""

import struct

from handctl.drives.discovery import (
    DUPLICATE_NODE_WARNING,
    DiscoveredNode,
    ProtocolDiscovery,
    ReceivedFrames,
    is_number_used_by_two_drives,
)
from handctl.drives.frame import Frame
from handctl.drives.mit import codec

MOTOR_NUMBERS = range(1, 0x80)
"""Node numbers to which a scan sends requests."""
# Register numbers: identifier of the replies, hardware version, software version, serial number,
# bit rate.
MST_ID = 7
HARDWARE_VERSION = 13
SOFTWARE_VERSION = 14
SERIAL_NUMBER = 15
CAN_BIT_RATE_REGISTER = 35
_INTEGER_REGISTERS = {
    MST_ID,
    codec.TIMEOUT,
    codec.CTRL_MODE,
    HARDWARE_VERSION,
    SOFTWARE_VERSION,
    SERIAL_NUMBER,
    CAN_BIT_RATE_REGISTER,
}
_DETAIL_REGISTERS = (
    SOFTWARE_VERSION,
    SERIAL_NUMBER,
    CAN_BIT_RATE_REGISTER,
    codec.CTRL_MODE,
    codec.TIMEOUT,
    codec.PMAX,
    codec.VMAX,
    codec.TMAX,
)
FIRST_FD_BIT_RATE = 5
"""Smallest value of register CAN_BIT_RATE_REGISTER, the bit rate, at which the motor uses CAN FD."""
_RANGE_REGISTERS = (
    ("position_range_rad", codec.PMAX),
    ("velocity_range_rad_s", codec.VMAX),
    ("torque_max_N_m", codec.TMAX),
)
"""Keys of a ``[[motor]]`` section whose values are in registers of the motor, each with its register number."""
_STATE_TEXTS = {codec.DISABLED: "disabled", codec.ENABLED: "enabled"}


def probe_frames(scan_round: int, received_frames: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the register requests that the scan sends in a round.

    In round 2, the scan requests register MST_ID from every node number. In round 3, the scan
    requests the other registers and the state of the discovered motors.
    """
    if scan_round == 2:
        return tuple(_read_request(number, MST_ID) for number in MOTOR_NUMBERS)
    if scan_round != 3:
        return ()
    frames = []
    for motor in discovered_motors(received_frames):
        frames += [_read_request(motor.node_id, register) for register in _DETAIL_REGISTERS]
        frames.append(
            Frame(codec.BROADCAST_ID, codec.register_request(motor.node_id, codec.REFRESH))
        )
    return tuple(frames)


def discovered_motors(received_frames: ReceivedFrames) -> tuple[DiscoveredNode, ...]:
    """Return the motors that have reported their MST_ID in a frame whose identifier is the MST_ID."""
    replies: dict[int, dict[int, list[bytes]]] = {}
    for frame in received_frames:
        if (
            len(frame.data) == 8
            and frame.data[2] == codec.READ
            and int.from_bytes(frame.data[:2], "little") in MOTOR_NUMBERS
        ):
            answers_by_node = replies.setdefault(int.from_bytes(frame.data[:2], "little"), {})
            answers_by_node.setdefault(frame.data[3], []).append(frame.data[4:])
    reply_ids = {
        number: _decode_integer(payloads[MST_ID][-1])
        for number, payloads in replies.items()
        if MST_ID in payloads
    }
    identifiers = {frame.can_id for frame in received_frames}
    present_numbers = sorted(
        number for number, reply_id in reply_ids.items() if reply_id in identifiers
    )
    return tuple(
        _describe_motor(number, reply_ids, replies[number], received_frames)
        for number in present_numbers
    )


def _describe_motor(
    node_number: int,
    reply_ids: dict[int, int],
    payloads_by_command: dict[int, list[bytes]],
    received_frames: ReceivedFrames,
) -> DiscoveredNode:
    """Return the description of a discovered motor, with the data in its registers."""
    reply_id = reply_ids[node_number]
    payload_by_register = {
        register: payloads[-1] for register, payloads in payloads_by_command.items()
    }
    values = {
        register: _decode_integer(data)
        for register, data in payload_by_register.items()
        if register in _INTEGER_REGISTERS
    }
    settings = {
        key: struct.unpack("<f", payload_by_register[register])[0]
        for key, register in _RANGE_REGISTERS
        if register in payload_by_register
    }
    # If the hand file has no option reply_id, MST_ID is ESC_ID + 0x10.
    options: dict[str, bool | int | float | str] = (
        {} if reply_id == node_number + 0x10 else {"reply_id": reply_id}
    )
    if values.get(CAN_BIT_RATE_REGISTER, 0) >= FIRST_FD_BIT_RATE:
        options["fd"] = True
    is_number_used_twice = is_number_used_by_two_drives(payloads_by_command, SERIAL_NUMBER)
    notes = [DUPLICATE_NODE_WARNING] if is_number_used_twice else []
    if other_nodes := [
        other_node_number
        for other_node_number, other_reply_id in reply_ids.items()
        if other_reply_id == reply_id and other_node_number != node_number
    ]:
        notes.append(
            f"answers on {reply_id:#x} as motor {other_nodes[0]} does: give each an MST_ID of its own (register 7)"
        )
    if values.get(codec.TIMEOUT) == 0:
        notes.append("its watchdog is off; handctl sets it before arming")
    if values.get(codec.CTRL_MODE, codec.MIT_MODE) != codec.MIT_MODE:
        notes.append("not in MIT mode; handctl sets it before arming")
    state, error = _state_and_error(node_number, reply_id, received_frames)
    firmware = f"{values[SOFTWARE_VERSION]:#x}" if SOFTWARE_VERSION in values else ""
    serial = f"{values[SERIAL_NUMBER]:#x}" if SERIAL_NUMBER in values else ""
    return DiscoveredNode(
        "mit",
        node_number,
        firmware,
        serial,
        state,
        error,
        settings,
        options,
        tuple(notes),
        {},
        is_number_used_twice,
    )


def _state_and_error(
    node_number: int, reply_id: int, received_frames: ReceivedFrames
) -> tuple[str, str]:
    """Return the drive state and the error in the latest feedback of a motor, as texts.

    The state and the error are empty texts if there is no feedback.
    """
    for frame in reversed(received_frames):
        is_reply = (
            frame.can_id == reply_id
            and len(frame.data) == 8
            and frame.data[0] & 0xF == node_number & 0xF
        )
        if is_reply and codec.decode_register_reply(frame.data, node_number) is None:
            nibble = frame.data[0] >> 4
            values = _STATE_TEXTS.get(nibble)
            return (
                (values, "")
                if values
                else ("in error", codec.ERROR_TEXTS.get(nibble, f"unknown state {nibble:#x}"))
            )
    return "", ""


def command_ids(motor: DiscoveredNode) -> frozenset[int]:
    """Return the identifiers of commands to the motor, in all its control modes."""
    # The identifier offsets of the commands belong to MIT mode, position-velocity mode, velocity
    # mode, and force-position mode.
    return frozenset(mode + motor.node_id for mode in (0x000, 0x100, 0x200, 0x300))


def other_host_frames(received_frames: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the received frames that only a host sends.

    Only a host sends register requests, MIT commands and special commands.
    """
    return tuple(
        frame
        for frame in received_frames
        if frame.can_id == codec.BROADCAST_ID
        or (0 < frame.can_id < 0x20 and len(frame.data) == 8)
        or (len(frame.data) == 8 and frame.data[:7] == b"\xff" * 7)
    )


def _read_request(node_number: int, register: int) -> Frame:
    """Return the frame to read a register of a motor."""
    return Frame(codec.BROADCAST_ID, codec.register_request(node_number, codec.READ, register))


def _decode_integer(register_bytes: bytes) -> int:
    """Return the integer in little-endian bytes."""
    return int.from_bytes(register_bytes, "little")


def ping_request(motor: DiscoveredNode) -> Frame:
    """Return the frame to read register MST_ID of the motor."""
    return _read_request(motor.node_id, MST_ID)


def is_ping_reply(motor: DiscoveredNode, frame: Frame) -> bool:
    """Return True if the frame is a reply in which the motor sends register MST_ID."""
    answer = frame.can_id != codec.BROADCAST_ID and len(frame.data) == 8
    return (
        answer and frame.data[:4] == codec.register_request(motor.node_id, codec.READ, MST_ID)[:4]
    )


DISCOVERY = ProtocolDiscovery(
    probe_frames, discovered_motors, command_ids, other_host_frames, ping_request, is_ping_reply
)
