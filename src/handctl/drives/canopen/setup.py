"""Set-up of a CANopen node by SDO.

The host writes and reads the objects of the node until each object has its required value.
"""

import enum
from typing import NamedTuple

from handctl.drives import readback
from handctl.drives.canopen import codec
from handctl.drives.readback import ReadbackCursor

UNLIMITED_TRIES = 1 << 62
"""Number of SDO requests for an object that is requested without a limit, until the drive answers."""
PDO_DISABLED_BIT = 1 << 31
"""Bit that disables a PDO, in the COB-ID of the PDO (identifier with flags)."""
HOST_NODE = 0x7F
"""Node number of this host. The nodes supervise the heartbeat that contains the node number of the host."""
REPEAT_PERIOD_NS = 20_000_000
"""Time after which the host repeats an NMT command [ns]."""
SERIAL_NUMBER = 0x1018, 4
"""Index and sub-index of the object with the serial number."""


class ObjectCheck(enum.IntEnum):
    """Rule for the check of an object: when the host writes the object, and which values the host accepts."""

    EQUAL = 0
    """Read the object. The value of the object must equal the required value."""
    BITS_SET = 1
    """Read the object. The bits that are set in the required value must also be set in the drive."""
    WRITE = 2
    """Write the object, then read it. The value of the object must equal the required value."""
    WRITE_IF_PRESENT = 3
    """Write and read the object as with the rule WRITE. Accept a drive without the object."""
    READ_IF_PRESENT = 4
    """Read the object and accept any value. Accept a drive without the object."""
    EQUAL_IF_PRESENT = 5
    """Read the object.

    The value of the object must equal the required value. Accept a drive without the object.
    """
    LOW_WORD_EQUAL = 6
    """Read the object. The low 16 bits of the object's value must equal the required value."""
    WRITE_IF_DIFFERENT = 7
    """Read the object. If the value differs from the required value, write it and read it again."""


OPTIONAL_OBJECT_CHECKS = (
    ObjectCheck.WRITE_IF_PRESENT,
    ObjectCheck.READ_IF_PRESENT,
    ObjectCheck.EQUAL_IF_PRESENT,
)
"""Rules that accept a device without the object."""


class SetupStep(NamedTuple):
    """Object of a node, with the required value of the object and the rule for the check of the object."""

    check: ObjectCheck
    number: int
    sub_index: int
    value: int
    size: int

    @property
    def raw(self) -> bytes:
        """Return the required value of the object as little-endian bytes."""
        return self.value.to_bytes(self.size, "little")

    @property
    def is_written_before_read(self) -> bool:
        """Return True if the object is written before it is read."""
        return self.check in (ObjectCheck.WRITE, ObjectCheck.WRITE_IF_PRESENT)

    @property
    def name(self) -> str:
        """Return the name of the CANopen object in messages to the operator: its index and sub-index."""
        return f"object {self.number:#06x}:{self.sub_index}"


def pdo_steps(
    communication_index: int,
    mapping_index: int,
    cob_id: int,
    transmission_type: int,
    mapped_objects: tuple[int, ...],
) -> tuple[SetupStep, ...]:
    """Return the set-up steps (object and required value) of one PDO.

    The set-up steps disable the PDO, map the objects of the PDO, and enable the PDO again.
    """
    write = ObjectCheck.WRITE
    return (
        # By CiA 301, the mapping of a PDO can be changed only while the PDO is off and its entry
        # count is 0.
        SetupStep(write, communication_index, 1, PDO_DISABLED_BIT | cob_id, 4),
        SetupStep(write, mapping_index, 0, 0, 1),
        *(
            SetupStep(write, mapping_index, i + 1, entry, 4)
            for i, entry in enumerate(mapped_objects)
        ),
        SetupStep(write, mapping_index, 0, len(mapped_objects), 1),
        SetupStep(write, communication_index, 2, transmission_type, 1),
        SetupStep(write, communication_index, 1, cob_id, 4),
    )


def is_next_request_write(cursor: ReadbackCursor, step: SetupStep) -> bool:
    """Return True if the next SDO request must write the object of the set-up step.

    The host writes the object if the rule of the object requires a write, or if the object had a
    wrong value.
    """
    return cursor.must_write or (step.is_written_before_read and not cursor.write_count)


def _has_required_value(step: SetupStep, value: int) -> bool:
    """Return True if the rule of a set-up step accepts the value of the object."""
    if step.check == ObjectCheck.BITS_SET:
        return value & step.value == step.value
    return (value & 0xFFFF if step.check == ObjectCheck.LOW_WORD_EQUAL else value) == step.value


def on_reply(
    cursor: ReadbackCursor, required_steps: tuple[SetupStep, ...], reply: codec.SdoReply
) -> tuple[ReadbackCursor, int, str]:
    """Advance the read-back of a node's objects by an SDO reply.

    An SDO reply that answers another request has no effect.

    Returns:
        the new cursor, the value of an object with the rule READ_IF_PRESENT (0 for any other rule),
        and the problem in words (an empty text without a problem).
    """
    step = required_steps[cursor.step]
    if not cursor.is_waiting or reply[:2] != (step.number, step.sub_index):
        return cursor, 0, ""
    if reply.abort:
        if (
            reply.abort in (codec.OBJECT_MISSING_ABORT, 0x06090011)
            and step.check in OPTIONAL_OBJECT_CHECKS
        ):
            return cursor.next_setting(), 0, ""
        return cursor, 0, f"{step.name}: {codec.abort_text(reply.abort)}"
    if is_next_request_write(cursor, step):
        return cursor if reply.raw else cursor.cursor_after_write(), 0, ""
    if not reply.raw:
        return cursor, 0, ""
    value = int.from_bytes(reply.raw, "little")
    if step.check == ObjectCheck.READ_IF_PRESENT:
        return cursor.next_setting(), value, ""
    if _has_required_value(step, value):
        return cursor.next_setting(), 0, ""
    max_write_count = 1 if step.check == ObjectCheck.WRITE_IF_DIFFERENT else 0
    cursor, problem = readback.cursor_after_wrong_value(
        cursor, step.name, f"{value:#x}", f"{step.value:#x}", max_write_count
    )
    return cursor, 0, problem


def next_request(
    cursor: ReadbackCursor, required_steps: tuple[SetupStep, ...], t_ns: int
) -> tuple[ReadbackCursor, bytes, str]:
    """Return the new position in the read-back, the payload of the next SDO request, and the text of a problem.

    The payload is empty while the host waits for an answer of the drive. The text is empty if the
    read-back has no problem. The request for the first object is repeated without a limit until the
    drive answers.
    """
    step = required_steps[cursor.step]
    cursor, must_send, problem = readback.request_setting(
        cursor, step.name, t_ns, readback.REQUEST_TRIES if cursor.step else UNLIMITED_TRIES
    )
    if not must_send:
        return cursor, b"", problem
    download_payload = codec.download_request(step.number, step.sub_index, step.raw)
    return (
        cursor,
        download_payload
        if is_next_request_write(cursor, step)
        else codec.upload_request(step.number, step.sub_index),
        "",
    )
