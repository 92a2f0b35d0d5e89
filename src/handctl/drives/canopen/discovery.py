"""Discovery of CANopen drives by heartbeats, and by answers to an SDO read of the device type.

An SDO request that reads an object changes nothing in the drive, and moves no motor. A scan reads
only the device type, the serial number and the number of measuring channels of a node. While no
controller runs, the ``canopen`` library reads all other data of a drive
(``runtime.diagnostics.canopen_identity``). Source: CiA 301 4.2.
"""

from handctl.drives.canopen import codec
from handctl.drives.canopen.setup import HOST_NODE, SERIAL_NUMBER
from handctl.drives.discovery import (
    DUPLICATE_NODE_WARNING,
    DiscoveredNode,
    ProtocolDiscovery,
    ReceivedFrames,
    is_number_used_by_two_drives,
)
from handctl.drives.frame import REMOTE_FLAG, Frame
from handctl.hand.file.section_models import CIA404_PROTOCOL

NODE_NUMBERS = range(1, HOST_NODE)
"""Node numbers to which a scan sends requests."""
# DEVICE_TYPE is the object with the device type. CIA402_PROFILE is the profile number of CiA 402
# drives, in the lower 16 bits of the device type.
DEVICE_TYPE = 0x1000
CIA402_PROFILE = 402
CIA404_PROFILE = 404
"""CANopen profile number of measuring amplifiers."""
CHANNEL_COUNT_OBJECT = (0x6131, 0)
"""Object with the number of channels of a measuring amplifier.

The number of channels is the number of entries in the array of units. Source: CiA 404.
"""
NMT_STATES = {0x00: "boot-up", 0x04: "stopped", 0x05: "operational", 0x7F: "pre-operational"}
"""Names of the NMT states of a node."""
_RPDO_BASE_IDS = (0x200, 0x300, 0x400, 0x500)
"""Base identifiers of the four RPDOs. The sum of base identifier and node number is the identifier of an RPDO."""


def probe_frames(scan_round: int, received_frames: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the SDO requests that the scan sends in a round.

    In round 2, the scan requests the device type from every node number. In round 3, the scan
    requests the serial number of each discovered node, and the number of channels of each measuring
    amplifier.
    """
    if scan_round == 2:
        return tuple(
            Frame(codec.SDO_REQUEST + number, codec.upload_request(DEVICE_TYPE, 0))
            for number in NODE_NUMBERS
        )
    if scan_round == 3:
        nodes = discovered_nodes(received_frames)
        requested_objects = [(node, SERIAL_NUMBER) for node in nodes]
        requested_objects += [
            (node, CHANNEL_COUNT_OBJECT) for node in nodes if node.protocol == CIA404_PROTOCOL
        ]
        return tuple(
            Frame(codec.SDO_REQUEST + node.node_id, codec.upload_request(*entry))
            for node, entry in requested_objects
        )
    return ()


def discovered_nodes(received_frames: ReceivedFrames) -> tuple[DiscoveredNode, ...]:
    """Return all nodes that have reported their device type or have sent a heartbeat."""
    types: dict[int, int] = {}
    channels: dict[int, int] = {}
    states: dict[int, int] = {}
    answers_by_node: dict[int, dict[int, list[bytes]]] = {}
    for frame in received_frames:
        if frame.can_id - codec.SDO_REPLY in NODE_NUMBERS and len(frame.data) == 8:
            reply = codec.decode_sdo_reply(frame.data)
            if reply and reply[:2] in ((DEVICE_TYPE, 0), SERIAL_NUMBER):
                answers_by_object = answers_by_node.setdefault(frame.can_id - codec.SDO_REPLY, {})
                answers_by_object.setdefault(reply.number, []).append(frame.data)
            if reply and reply[:2] == (DEVICE_TYPE, 0) and len(reply.raw) == 4:
                types[frame.can_id - codec.SDO_REPLY] = int.from_bytes(reply.raw, "little")
            elif reply and reply[:2] == CHANNEL_COUNT_OBJECT and reply.raw:
                channels[frame.can_id - codec.SDO_REPLY] = reply.raw[0]
        elif frame.can_id - codec.HEARTBEAT in NODE_NUMBERS and len(frame.data) == 1:
            states[frame.can_id - codec.HEARTBEAT] = frame.data[0]
    return tuple(
        _describe_node(
            number,
            types.get(number),
            states.get(number),
            is_number_used_by_two_drives(answers_by_node.get(number, {}), SERIAL_NUMBER[0]),
            channels.get(number, 0),
        )
        for number in sorted(types | states)
    )


def _describe_node(
    node_number: int,
    device_type: int | None,
    nmt_state: int | None,
    is_number_used_twice: bool,
    channel_count: int,
) -> DiscoveredNode:
    """Return the description of a discovered node, with the data that the node has reported."""
    state = NMT_STATES.get(nmt_state, f"NMT state {nmt_state:#x}") if nmt_state is not None else ""
    if device_type is None:
        return DiscoveredNode(
            "canopen",
            node_number,
            state=state,
            notes=("sends heartbeats, but does not answer an SDO",),
        )
    profile = device_type & 0xFFFF
    notes = (DUPLICATE_NODE_WARNING,) * is_number_used_twice
    if profile == CIA404_PROFILE:
        channels = f" with {channel_count} channels" if channel_count else ""
        text = f"a measuring amplifier of CiA 404{channels}: not a drive"
        options: dict[str, bool | int | float | str] = (
            {"channels_per_node": channel_count} if channel_count else {}
        )
        return DiscoveredNode(
            CIA404_PROTOCOL,
            node_number,
            state=state,
            options=options,
            notes=(*notes, text),
            twins=is_number_used_twice,
        )
    if profile != CIA402_PROFILE:
        notes = (*notes, f"a CANopen device of profile {profile}, not a drive of CiA 402")
    protocol = "cia402" if profile == CIA402_PROFILE else "canopen"
    return DiscoveredNode(
        protocol, node_number, state=state, notes=notes, twins=is_number_used_twice
    )


def command_ids(node: DiscoveredNode) -> frozenset[int]:
    """Return the identifiers of frames that a node obeys.

    A node obeys NMT, SYNC, RPDOs, and SDO requests.
    """
    node_ids = {base + node.node_id for base in (codec.SDO_REQUEST, *_RPDO_BASE_IDS)}
    return frozenset(node_ids | {codec.NMT, codec.SYNC})


def other_host_frames(received_frames: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the received frames that come from another host.

    Only a host sends SYNC, NMT, and the heartbeat with the node number of a host.
    """
    identifiers = (codec.NMT, codec.SYNC, codec.HEARTBEAT + HOST_NODE)
    return tuple(frame for frame in received_frames if frame.can_id & ~REMOTE_FLAG in identifiers)


def ping_request(node: DiscoveredNode) -> Frame:
    """Return the SDO request to read the device type of a node."""
    return Frame(codec.SDO_REQUEST + node.node_id, codec.upload_request(DEVICE_TYPE, 0))


def is_ping_reply(node: DiscoveredNode, frame: Frame) -> bool:
    """Return True if the frame is an SDO reply of the node."""
    return frame.can_id == codec.SDO_REPLY + node.node_id and len(frame.data) == 8


DISCOVERY = ProtocolDiscovery(
    probe_frames, discovered_nodes, command_ids, other_host_frames, ping_request, is_ping_reply
)
