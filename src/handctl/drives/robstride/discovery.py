"""Discovery of RobStride motors by an identity request to each motor number.

The identity request (type 0) causes no torque and changes no setting. A scan reads no mode and no
faults. Only feedback contains mode and faults, and a scan would have to send the stop command to
request feedback. A scan reads no parameters either. Source: docs/facts/robstride.md.
"""

from handctl.drives.discovery import (
    DUPLICATE_NODE_WARNING,
    DiscoveredNode,
    ProtocolDiscovery,
    ReceivedFrames,
)
from handctl.drives.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Frame
from handctl.drives.robstride import codec

MOTOR_NUMBERS = range(1, codec.LAST_NODE_ID + 1)
"""Motor numbers to which a scan sends requests."""
ALL_HOSTS = range(0x100)
"""Possible numbers of a host."""
HOST_REQUEST_TYPES = frozenset(codec.REQUEST_TYPES) - {
    codec.GET_ID,
    codec.READ,
    codec.REPORTING,
} | {codec.MOTION_CONTROL}
"""Types of frames by which a scan detects another host."""


def probe_frames(scan_round: int, received_frames: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the identity requests that the scan sends in a round.

    In round 2, the scan sends an identity request to every motor number. In round 3, the scan
    repeats the request to the discovered motors.
    """
    if scan_round == 2:
        return tuple(_identity_request(number) for number in MOTOR_NUMBERS)
    if scan_round == 3:
        return tuple(
            _identity_request(motor.node_id) for motor in discovered_motors(received_frames)
        )
    return ()


def _identity_request(node_number: int) -> Frame:
    """Return the frame to request the identity of a motor."""
    return Frame(codec.request_id(codec.GET_ID, node_number, codec.HOST_ID), codec.EMPTY_DATA)


def discovered_motors(received_frames: ReceivedFrames) -> tuple[DiscoveredNode, ...]:
    """Return the motors that have answered with their identity."""
    number_by_reply_id = {
        codec.reply_id(codec.GET_ID, number, codec.BROADCAST): number for number in MOTOR_NUMBERS
    }
    serials: dict[int, set[bytes]] = {}
    for frame in received_frames:
        number = number_by_reply_id.get(frame.can_id)
        if number is not None and len(frame.data) == 8:
            serials.setdefault(number, set()).add(frame.data)
    return tuple(_describe_motor(number, serials[number]) for number in sorted(serials))


def _describe_motor(node_number: int, serials: set[bytes]) -> DiscoveredNode:
    """Return the description of a discovered motor.

    The argument ``serials`` contains all serial numbers that motors with this node number have
    sent.
    """
    is_number_used_twice = len(serials) > 1
    notes = (DUPLICATE_NODE_WARNING,) * is_number_used_twice + (
        "does not report its model: give motor_type in the hand file",
    )
    return DiscoveredNode(
        "robstride",
        node_number,
        serial=min(serials).hex(),
        notes=notes,
        twins=is_number_used_twice,
    )


def command_ids(motor: DiscoveredNode) -> frozenset[int]:
    """Return the identifiers of requests from any host to the motor."""
    return frozenset(
        codec.request_id(kind, motor.node_id, host)
        for kind in codec.REQUEST_TYPES
        for host in ALL_HOSTS
    )


def other_host_frames(received_frames: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the received frames that only another host can have sent to a motor."""
    return tuple(
        frame
        for frame in received_frames
        if frame.can_id & EXTENDED_FLAG
        and not frame.can_id & (REMOTE_FLAG | ERROR_FLAG)
        and (frame.can_id & ~EXTENDED_FLAG) >> 24 in HOST_REQUEST_TYPES
        and 0 < frame.can_id & 0xFF <= codec.LAST_NODE_ID
        and len(frame.data) == 8
    )


def ping_request(motor: DiscoveredNode) -> Frame:
    """Return the frame to request the identity of the motor."""
    return _identity_request(motor.node_id)


def is_ping_reply(motor: DiscoveredNode, frame: Frame) -> bool:
    """Return True if the frame reports the identity of the motor."""
    return frame.can_id == codec.reply_id(codec.GET_ID, motor.node_id, codec.BROADCAST)


DISCOVERY = ProtocolDiscovery(
    probe_frames, discovered_motors, command_ids, other_host_frames, ping_request, is_ping_reply
)
