"""CANopen frames that are equal in all device profiles, for example NMT and short SDO transfers.

All fields of the frames are little-endian. Most identifiers are the sum of a base identifier and
the node number n. The base identifier depends on the CANopen service, such as SDO. A hyphen in the
last column of the table means that the frame has no payload.

    frame      identifier  to    bytes and fields
    NMT        0x000       node  0 command | 1 node number
    SYNC       0x080       all   -
    EMCY       0x080 + n   host  0..1 error code | 2 error register | 3..7 of the maker
    SDO        0x600 + n   node  0 specifier | 1..2 index | 3 sub-index | 4..7 value
    SDO reply  0x580 + n   host  0 specifier | 1..2 index | 3 sub-index | 4..7 value or abort code
    heartbeat  0x700 + n   all   0 NMT state

Source: CiA 301 4.2.
"""

import struct
from typing import NamedTuple

# Identifiers of frames. ``NMT`` and ``SYNC`` are complete identifiers. The sum of the node number
# and any other constant is the identifier of a frame.
NMT = 0x000
SYNC = 0x080
EMERGENCY = 0x080
TPDO = 0x180
RPDO = 0x200
SDO_REPLY = 0x580
SDO_REQUEST = 0x600
HEARTBEAT = 0x700
# NMT commands.
START_NODE = 0x01
PRE_OPERATIONAL = 0x80
# NMT states in a heartbeat.
BOOT_UP = 0x00
STOPPED = 0x04
OPERATIONAL = 0x05
OBJECT_MISSING_ABORT = 0x06020000
"""SDO abort code for an object missing in the node."""
ABORT_TEXTS = {
    0x05030000: "toggle bit", 0x05040000: "time-out", 0x06010001: "write-only", 0x06010002: "read-only",
    OBJECT_MISSING_ABORT: "no such object", 0x06040041: "cannot be mapped", 0x06040042: "mapping too long",
    0x06070010: "wrong length", 0x06090011: "no such sub-index", 0x06090030: "out of range",
    0x08000022: "not in this state",
}  # fmt: skip
"""Meaning of each SDO abort code in words. Source: CiA 301."""


def abort_text(abort_code: int) -> str:
    """Return the meaning of an SDO abort code in words."""
    return ABORT_TEXTS.get(abort_code, f"abort {abort_code:#010x}")


def upload_request(index: int, sub_index: int) -> bytes:
    """Return the SDO payload to request the value of an object."""
    # 0x40 starts an upload from the node to the host.
    return struct.pack("<BHB4x", 0x40, index, sub_index)


def upload_reply(index: int, sub_index: int, value_bytes: bytes) -> bytes:
    """Return the payload of an SDO reply with the value of an object, one to four bytes."""
    # Specifier 0x43 marks an expedited value. Bits 2..3 of the specifier contain the number of
    # unused bytes.
    return struct.pack("<BHB4s", 0x43 | (4 - len(value_bytes)) << 2, index, sub_index, value_bytes)


def download_request(index: int, sub_index: int, value_bytes: bytes) -> bytes:
    """Return the payload of an SDO request that writes one to four bytes to an object."""
    # Specifier 0x23 starts an expedited download. Bits 2..3 of the specifier contain the number of
    # unused bytes.
    return struct.pack("<BHB4s", 0x23 | (4 - len(value_bytes)) << 2, index, sub_index, value_bytes)


class SdoReply(NamedTuple):
    """Content of an SDO reply: object, value, and abort code.

    In the reply to a write request, the field ``raw`` is empty. The abort code is 0 if the node did
    not abort the transfer.
    """

    number: int
    sub_index: int
    raw: bytes
    abort: int


def decode_sdo_reply(payload: bytes) -> SdoReply | None:
    """Decode the 8 bytes in the payload of an SDO reply.

    Return None if the bytes are not a reply to a read or a write.
    """
    specifier, index, sub = struct.unpack_from("<BHB", payload)
    # Specifier 0x80 reports an abort, and 0x60 confirms a write. Specifier 0x43 marks a value. Bits
    # 2..3 of the specifier contain the number of unused bytes.
    if specifier == 0x80:
        return SdoReply(index, sub, b"", int.from_bytes(payload[4:], "little"))
    if specifier == 0x60:
        return SdoReply(index, sub, b"", 0)
    if specifier & 0xF3 == 0x43:
        return SdoReply(index, sub, payload[4 : 8 - (specifier >> 2 & 3)], 0)
    return None
