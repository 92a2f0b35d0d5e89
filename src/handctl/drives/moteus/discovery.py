"""Discovery of moteus controllers.

A scan first reads the mode register from every node number, and then other registers of the
discovered drives. A request to read registers causes no torque, and does not restart a drive's
watchdog. All requests and replies of a scan are classical frames of at most eight bytes, because a
bus need not support CAN FD. A drive answers a classical frame with a classical frame. Source:
docs/facts/moteus.md.
"""

import math

from handctl.drives.discovery import (
    DUPLICATE_NODE_WARNING,
    DiscoveredNode,
    ProtocolDiscovery,
    ReceivedFrames,
    is_number_used_by_two_drives,
)
from handctl.drives.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Frame
from handctl.drives.moteus import codec
from handctl.drives.moteus.progress import error_text

DRIVE_NUMBERS = range(1, codec.LAST_NODE_ID + 1)
"""Node numbers to which a scan sends requests."""
MODE_REQUEST = codec.read_subframe(codec.INT8, codec.MODE)
"""Payload of the scan request that reads the mode of a node. The reply of a moteus controller begins with 21 00."""
MODE_REPLY = bytes((codec.REPLY | 1, codec.MODE))
IDENTITY_REQUESTS = (
    codec.read_subframe(codec.INT8, codec.FAULT),
    *(
        codec.read_subframe(codec.INT32, register)
        for register in (
            codec.FIRMWARE_VERSION,
            *range(codec.SERIAL_NUMBER, codec.SERIAL_NUMBER + 3),
        )
    ),
)
"""Payloads that read fault code, firmware version, and serial number."""
_MODE_TEXTS = {
    codec.STOPPED: "stopped",
    codec.FAULT_MODE: "fault",
    codec.POSITION: "position",
    codec.TIMED_OUT: "timeout",
}


def probe_frames(scan_round: int, received_frames: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the register requests that the scan sends in a round.

    In round 2, the scan requests the mode from every node number. In round 3, the scan requests
    other registers of the discovered drives.
    """
    if scan_round == 2:
        return tuple(Frame(codec.request_id(number), MODE_REQUEST) for number in DRIVE_NUMBERS)
    if scan_round == 3:
        return tuple(
            Frame(codec.request_id(drive.node_id), data)
            for drive in discovered_drives(received_frames)
            for data in IDENTITY_REQUESTS
        )
    return ()


def discovered_drives(received_frames: ReceivedFrames) -> tuple[DiscoveredNode, ...]:
    """Return the drives that have reported their mode to this host."""
    answers_by_node: dict[int, dict[int, list[bytes]]] = {}
    number_by_reply_id = {codec.reply_id(number): number for number in DRIVE_NUMBERS}
    for frame in received_frames:
        number = number_by_reply_id.get(frame.can_id)
        reply = codec.decode_reply(frame.data) if number is not None else None
        # Each request of a scan reads one register. A reply with more than one register answers
        # another host.
        if number is not None and reply is not None and len(reply.values) == 1:
            answers_by_node.setdefault(number, {}).setdefault(next(iter(reply.values)), []).append(
                frame.data
            )
    return tuple(
        _describe_drive(number, answers_by_node[number])
        for number in sorted(answers_by_node)
        if codec.MODE in answers_by_node[number]
    )


def _describe_drive(
    node_number: int, payloads_by_command: dict[int, list[bytes]]
) -> DiscoveredNode:
    """Return the description of a discovered drive, with all data that the drive has reported.

    For each register number, the argument ``payloads_by_command`` contains the payloads that the
    drive has sent.
    """
    values: dict[int, int] = {}
    for register, payloads in payloads_by_command.items():
        reply = codec.decode_reply(payloads[-1])
        if reply is not None and math.isfinite(reply.values[register]):
            values[register] = int(reply.values[register])
    mode = values.get(codec.MODE, codec.STOPPED)
    fault = values.get(codec.FAULT, 0)
    has_error = mode in (codec.FAULT_MODE, codec.TIMED_OUT)
    error = error_text(fault if mode == codec.FAULT_MODE and fault else mode) if has_error else ""
    version = values.get(codec.FIRMWARE_VERSION, 0)
    firmware_version = (
        ".".join(str(version >> shift & 0xFF) for shift in (16, 8, 0)) if version else ""
    )
    words = [values.get(codec.SERIAL_NUMBER + i, 0) & 0xFFFFFFFF for i in range(3)]
    serial = "".join(f"{word:08x}" for word in reversed(words)) if any(words) else ""
    is_number_used_twice = is_number_used_by_two_drives(payloads_by_command, codec.SERIAL_NUMBER)
    notes = (DUPLICATE_NODE_WARNING,) * is_number_used_twice + (
        "needs a bus with CAN FD: data_bitrate = 5_000_000",
    )
    state = _MODE_TEXTS.get(mode, f"mode {mode}")
    return DiscoveredNode(
        "moteus",
        node_number,
        firmware_version,
        serial,
        state,
        error,
        notes=notes,
        twins=is_number_used_twice,
    )


def command_ids(drive: DiscoveredNode) -> frozenset[int]:
    """Return the identifiers of requests from any host that are addressed to this drive or to all drives."""
    return frozenset(
        codec.request_id(node, source)
        for node in (drive.node_id, codec.BROADCAST)
        for source in codec.SOURCE_NODES
    )


def other_host_frames(received_frames: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the received frames that are requests from another host to a drive.

    The identifier of a request has 29 bits, with the reply bit set and the prefix 0.
    """
    return tuple(
        frame
        for frame in received_frames
        if frame.can_id & EXTENDED_FLAG
        and not frame.can_id & (REMOTE_FLAG | ERROR_FLAG)
        and (frame.can_id & ~EXTENDED_FLAG) >> 15 == 1
        and 0 < frame.can_id & 0xFF <= codec.BROADCAST
        and frame.data
    )


def ping_request(drive: DiscoveredNode) -> Frame:
    """Return the frame to read the mode of the drive."""
    return Frame(codec.request_id(drive.node_id), MODE_REQUEST)


def is_ping_reply(drive: DiscoveredNode, frame: Frame) -> bool:
    """Return True if the frame is a reply in which the drive reports its mode."""
    return frame.can_id == codec.reply_id(drive.node_id) and frame.data[:2] == MODE_REPLY


DISCOVERY = ProtocolDiscovery(
    probe_frames, discovered_drives, command_ids, other_host_frames, ping_request, is_ping_reply
)
