"""Discovery of ODrives by their heartbeats, and by the message Address.

A remote frame requests the message Address from all drives.

Remote frames have no payload, and no drive obeys them. Firmware 0.5.x sends heartbeats too, but
with error codes that differ from firmware 0.6.x. A drive with firmware 0.5.x reports neither its
version nor its serial number. Source: ODrive documentation, "CAN Protocol", and the vendor's DBC
0.5.6 and 0.6.10.
"""

import dataclasses
import struct

from handctl.drives.discovery import (
    DUPLICATE_NODE_WARNING,
    DiscoveredNode,
    ProtocolDiscovery,
    ReceivedFrames,
    is_number_used_by_two_drives,
)
from handctl.drives.frame import ERROR_FLAG, EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from handctl.drives.odrive import codec
from handctl.drives.odrive import firmware_05 as odrive_05

# Command number and node number of the scan request to all drives.
ADDRESS = 0x06
BROADCAST = 0x3F
MIN_HEARTBEATS = 3
"""Number of frames with the layout of a heartbeat after which the sender of the frames counts as an ODrive.

A single frame with the layout of a heartbeat can be the message of another device.
"""
IQ_CURRENT, BUS_VOLTAGE = 0x14, 0x17
"""Numbers of messages that firmware 0.5 with factory settings sends only on request."""
_REQUEST_ONLY_MESSAGES = (IQ_CURRENT, BUS_VOLTAGE)
_MESSAGES_SENT_ONCE = (ADDRESS, codec.GET_VERSION, *_REQUEST_ONLY_MESSAGES)
"""Numbers of messages that a drive sends once for each request of a scan."""
CONFLICT_FREE_NODE_NUMBERS = (range(0x01, 0x04), range(0x09, 0x0C), range(0x34, 0x38))
"""Node numbers whose identifiers belong neither to the predefined connection set of CANopen nor to the sensor node.

Source: CiA 301, predefined connection set.
"""
OLD_FIRMWARE_NOTE = "does not report its version: treated as firmware 0.5.x, whose watchdog and limits are set over USB"
"""Warning for a drive that has not answered Get_Version."""
_AXIS_STATE_TEXTS = {codec.IDLE: "idle", codec.CLOSED_LOOP: "closed loop control"}
"""Names of the axis states of an ODrive."""
_CYCLIC_MESSAGES = {0x00, 0x01, 0x03, 0x09, 0x14, 0x15, 0x17, 0x1C, 0x1D}
"""Numbers of messages that a drive can send without a request."""


def probe_frames(scan_round: int, received_frames: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the requests that the scan sends in a round.

    In round 1, the scan requests the message Address from all nodes. In round 2, the scan requests
    the version of the discovered drives. In round 3, the scan sends requests to each drive that has
    not reported a version: the version again, and two messages of firmware 0.5.
    """
    if scan_round == 1:
        return (Frame(codec.message_id(BROADCAST, ADDRESS) | REMOTE_FLAG, b""),)
    if scan_round == 2:
        return tuple(
            _remote_request(drive, codec.GET_VERSION)
            for drive in discovered_drives(received_frames)
        )
    if scan_round == 3:
        silent_discovered_drives = [
            drive for drive in discovered_drives(received_frames) if not drive.firmware
        ]
        return tuple(
            _remote_request(drive, command)
            for drive in silent_discovered_drives
            for command in (codec.GET_VERSION, *_REQUEST_ONLY_MESSAGES)
        )
    return ()


def _remote_request(drive: DiscoveredNode, command: int) -> Frame:
    """Return a remote frame that requests a message from a drive."""
    return Frame(codec.message_id(drive.node_id, command) | REMOTE_FLAG, b"")


def discovered_drives(received_frames: ReceivedFrames) -> tuple[DiscoveredNode, ...]:
    """Return the descriptions of the discovered drives.

    A node counts as a drive if it has sent heartbeats of an ODrive, or the message Address.
    """
    messages = {
        command: _payloads_by_node(received_frames, command)
        for command in (codec.HEARTBEAT, *_MESSAGES_SENT_ONCE)
    }
    present_nodes = {
        node
        for node, data in messages[codec.HEARTBEAT].items()
        if len(data) >= MIN_HEARTBEATS and all(map(_is_heartbeat, data))
    }
    present_nodes |= {node for node, data in messages[ADDRESS].items() if data[-1][0] == node}
    return tuple(
        _describe_drive(
            node,
            {
                command: message_by_node[node]
                for command, message_by_node in messages.items()
                if node in message_by_node
            },
        )
        for node in sorted(present_nodes)
    )


def _describe_drive(node: int, messages: dict[int, list[bytes]]) -> DiscoveredNode:
    """Return the description of a discovered drive, with all data that the drive has reported.

    The argument ``messages`` contains the payloads from the drive, by command number.
    """
    last_payloads = {command: payloads[-1] for command, payloads in messages.items()}
    heartbeat = (
        codec.decode_heartbeat(last_payloads[codec.HEARTBEAT])
        if codec.HEARTBEAT in last_payloads
        else None
    )
    serial = (
        f"{int.from_bytes(last_payloads[ADDRESS][1:7], 'little'):012X}"
        if ADDRESS in last_payloads
        else ""
    )
    version = last_payloads.get(codec.GET_VERSION, b"")
    is_number_used_twice = is_number_used_by_two_drives(
        {command: messages.get(command, []) for command in _MESSAGES_SENT_ONCE}, ADDRESS
    )
    notes = [DUPLICATE_NODE_WARNING] if is_number_used_twice else []
    options: dict[str, bool | int | float | str] = {}
    origins: dict[str, str] = {}
    if version or serial:
        notes += _firmware_06_warnings(serial, version)
    else:
        options["firmware"] = "0.5"
        origins["firmware"] = "concluded: no answer to Get_Version"
        notes.append(OLD_FIRMWARE_NOTE)
    if node == BROADCAST:
        notes.append("has no node number yet: give it one")
    elif node == 0:
        first_number, last_number = (
            CONFLICT_FREE_NODE_NUMBERS[0][0],
            CONFLICT_FREE_NODE_NUMBERS[0][-1],
        )
        notes.append(
            f"node 0 shares its identifiers with CANopen's NMT: give it {first_number} to {last_number}"
        )
    firmware = ".".join(map(str, version[4:7])) if version else ""
    state = (
        _AXIS_STATE_TEXTS.get(heartbeat.state, f"axis state {heartbeat.state}")
        if heartbeat
        else "no heartbeat"
    )
    error = (
        (codec.error_text if version or serial else odrive_05.error_text)(heartbeat.errors)
        if heartbeat
        else ""
    )
    return DiscoveredNode(
        "odrive",
        node,
        firmware,
        serial,
        state,
        error,
        {},
        options,
        tuple(notes),
        origins,
        is_number_used_twice,
    )


def _firmware_06_warnings(serial: str, version: bytes) -> list[str]:
    """Return the warnings for the operator about a drive with firmware 0.6."""
    notes = [
        "watchdog and torque limit: give endpoint_... keys in the hand file, or set them over USB and trust that"
    ]
    if not version:
        notes.append("does not report its version")
    elif version[0] != codec.PROTOCOL_VERSION:
        notes.append(
            f"has CANSimple version {version[0]}, handctl supports {codec.PROTOCOL_VERSION}"
        )
    if not serial:
        notes.append("does not report its serial number")
    return notes


def mark_firmware_unknown(drive: DiscoveredNode) -> DiscoveredNode:
    """Return the description of a discovered drive, with the firmware set to unknown.

    A scan that sends no requests cannot determine the firmware.
    """
    if "firmware" not in drive.origins:
        return drive
    notes = tuple(
        "firmware unknown, because nothing was asked" if note == OLD_FIRMWARE_NOTE else note
        for note in drive.notes
    )
    return dataclasses.replace(drive, options={}, origins={}, error="", notes=notes)


def _payloads_by_node(received_frames: ReceivedFrames, command: int) -> dict[int, list[bytes]]:
    """Return the received payloads of one message, by node number.

    Older firmware sends Address with 7 bytes.
    """
    by_node: dict[int, list[bytes]] = {}
    for frame in received_frames:
        is_standard = (
            not frame.can_id & (EXTENDED_FLAG | REMOTE_FLAG | ERROR_FLAG) and not frame.flags & FDF
        )
        if (
            is_standard
            and frame.can_id & 0x1F == command
            and len(frame.data) in ((7, 8) if command == ADDRESS else (8,))
        ):
            by_node.setdefault(frame.can_id >> 5, []).append(frame.data)
    return by_node


def _is_heartbeat(data: bytes) -> bool:
    """Return True if 8 bytes have the layout of a heartbeat.

    In a heartbeat, state and result have documented values. In byte 7 of a heartbeat, all bits are
    0 except the two flags of firmware 0.5.
    """
    _, state, result = struct.unpack_from("<IBB", data)
    return 1 <= state <= 14 and result <= 15 and not data[7] & 0x7E


def command_ids(drive: DiscoveredNode) -> frozenset[int]:
    """Return all identifiers of the node, and all identifiers of messages to all nodes.

    The returned set includes the identifier 0x7ff of Enter_DFU_Mode, a message to all nodes.
    """
    return frozenset(
        codec.message_id(node, command)
        for node in (drive.node_id, BROADCAST)
        for command in range(32)
    )


def other_host_frames(received_frames: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the received frames that only another host can have sent to the discovered drives."""
    numbers = {drive.node_id for drive in discovered_drives(received_frames)}
    return tuple(
        frame
        for frame in received_frames
        if (frame.can_id & ~REMOTE_FLAG) >> 5 in numbers
        and (
            frame.can_id & REMOTE_FLAG
            or frame.can_id & 0x1F not in _CYCLIC_MESSAGES | {codec.TX_SDO, ADDRESS}
        )
    )


def ping_request(drive: DiscoveredNode) -> Frame:
    """Return a remote frame that requests a message from a drive, to check that the drive answers.

    The drive rarely sends the requested message without a request.
    """
    return _remote_request(drive, _ping_command(drive))


def is_ping_reply(drive: DiscoveredNode, frame: Frame) -> bool:
    """Return True if the frame is the message that ``ping_request`` requests from this drive."""
    return (
        frame.can_id == codec.message_id(drive.node_id, _ping_command(drive))
        and len(frame.data) == 8
    )


def _ping_command(drive: DiscoveredNode) -> int:
    """Return the number of the message that ``ping_request`` requests from a drive.

    An ODrive with firmware 0.6 answers a request for its version. An ODrive with firmware 0.5 has
    no message with its version, so the scan requests the bus voltage and current instead.
    """
    return BUS_VOLTAGE if drive.options.get("firmware") == "0.5" else codec.GET_VERSION


DISCOVERY = ProtocolDiscovery(
    probe_frames,
    discovered_drives,
    command_ids,
    other_host_frames,
    ping_request,
    is_ping_reply,
    mark_firmware_unknown,
)
