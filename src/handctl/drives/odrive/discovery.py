"""Discovery of ODrives: heartbeats, and answers to Address, which one remote frame requests from all.

Remote frames have no payload, and no drive obeys them. Firmware 0.5.x also sends heartbeats, with
other errors, and does not report version or serial number. Source: ODrive documentation, "CAN
Protocol", and the vendor's DBC 0.5.6 and 0.6.10.
"""

import struct

from handctl.drives.discovery import DiscoveredNode, Discovery, ReceivedFrames
from handctl.drives.frame import ERROR, EXTENDED, FDF, REMOTE, Frame
from handctl.drives.odrive import codec
from handctl.drives.odrive import firmware_05 as odrive_05

# Command and node number of the broadcast request.
ADDRESS = 0x06
BROADCAST = 0x3F
BEATS = 3
"""Frames with the layout of a heartbeat before a node counts. A single frame may be anything."""
_STATES = {codec.IDLE: "idle", codec.CLOSED_LOOP: "closed loop control"}
"""Axis states in words."""
_CYCLIC = {0x00, 0x01, 0x03, 0x09, 0x14, 0x15, 0x17, 0x1C, 0x1D}
"""Commands that a drive sends on its own."""


def probe_frames(turn: int, received: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the request frames of a round: Address of all nodes (1), version of discovered nodes (3)."""
    if turn == 1:
        return (Frame(codec.can_id(BROADCAST, ADDRESS) | REMOTE, b""),)
    if turn == 3:
        return tuple(Frame(codec.can_id(drive.node_id, codec.GET_VERSION) | REMOTE, b"") for drive in nodes(received))
    return ()


def nodes(received: ReceivedFrames) -> tuple[DiscoveredNode, ...]:
    """Return the nodes with ODrive heartbeats, or with an answer to Address."""
    beats = _sorted(received, codec.HEARTBEAT)
    serials = _sorted(received, ADDRESS)
    versions = _sorted(received, codec.GET_VERSION)
    present = {node for node, data in beats.items() if len(data) >= BEATS and all(map(_beat, data))}
    present |= {node for node, data in serials.items() if data[-1][0] == node}
    nodes = []
    for node in sorted(present):
        beat = codec.heartbeat(beats[node][-1]) if node in beats else None
        serial = f"{int.from_bytes(serials[node][-1][1:7], 'little'):012X}" if node in serials else ""
        nodes.append(_drive(node, beat, serial, versions[node][-1] if node in versions else b""))
    return tuple(nodes)


def _drive(node: int, beat: codec.Heartbeat | None, serial: str, version: bytes) -> DiscoveredNode:
    """Return the data of one drive."""
    notes = ["watchdog and torque limit: give endpoint_... keys in the hand file, or set them over USB and trust that"]
    options: dict[str, bool | int | float | str] = {}
    if version and version[0] != codec.PROTOCOL:
        notes.append(f"has CANSimple version {version[0]}, handctl supports {codec.PROTOCOL}")
    if not version:
        options["firmware"] = "0.5"
        notes = ["does not report its version: treated as firmware 0.5.x, whose watchdog and limits are set over USB"]
    if not serial and version:
        notes.append("does not report its serial number")
    if node == BROADCAST:
        notes.append("has no node number yet: give it one")
    elif node == 0:
        notes.append("node 0 shares its identifiers with CANopen's NMT; give it 0x10 to 0x1f")
    firmware = ".".join(map(str, version[4:7])) if version else ""
    state = _STATES.get(beat.state, f"axis state {beat.state}") if beat else "no heartbeat"
    error = (codec.error_text if version else odrive_05.error_text)(beat.errors) if beat else ""
    return DiscoveredNode("odrive", node, firmware, serial, state, error, {}, options, tuple(notes))


def _sorted(received: ReceivedFrames, command: int) -> dict[int, list[bytes]]:
    """Return the payloads of a message by node. Address of older firmware has 7 bytes."""
    by_node: dict[int, list[bytes]] = {}
    for frame in received:
        is_standard = not frame.can_id & (EXTENDED | REMOTE | ERROR) and not frame.flags & FDF
        if (
            is_standard
            and frame.can_id & 0x1F == command
            and len(frame.data) in ((7, 8) if command == ADDRESS else (8,))
        ):
            by_node.setdefault(frame.can_id >> 5, []).append(frame.data)
    return by_node


def _beat(data: bytes) -> bool:
    """Return True if 8 bytes can be a heartbeat.

    State and result are documented values. Byte 7 has no bits but the two flags of firmware 0.5.
    """
    _, state, result = struct.unpack_from("<IBB", data)
    return 1 <= state <= 14 and result <= 15 and not data[7] & 0x7E


def command_ids(drive: DiscoveredNode) -> frozenset[int]:
    """Return every identifier of the node and of the broadcast. 0x7ff is Enter_DFU_Mode."""
    return frozenset(codec.can_id(node, command) for node in (drive.node_id, BROADCAST) for command in range(32))


def other_host_frames(received: ReceivedFrames) -> tuple[Frame, ...]:
    """Return the commands to discovered nodes."""
    numbers = {drive.node_id for drive in nodes(received)}
    return tuple(
        frame
        for frame in received
        if (frame.can_id & ~REMOTE) >> 5 in numbers
        and (frame.can_id & REMOTE or frame.can_id & 0x1F not in _CYCLIC | {codec.TX_SDO, ADDRESS})
    )


def ping(drive: DiscoveredNode) -> Frame:
    """Return the request for the version. A drive sends its version rarely on its own."""
    return Frame(codec.can_id(drive.node_id, codec.GET_VERSION) | REMOTE, b"")


def is_pong(drive: DiscoveredNode, frame: Frame) -> bool:
    """Return True for a version message."""
    return frame.can_id == codec.can_id(drive.node_id, codec.GET_VERSION) and len(frame.data) == 8


DISCOVERY = Discovery(probe_frames, nodes, command_ids, other_host_frames, ping, is_pong)
