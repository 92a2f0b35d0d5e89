"""The object dictionary of the simulated CiA 402 drive, as described by its EDS file."""

import configparser
from collections.abc import Callable
from pathlib import Path
from typing import Any

from firmware_sim.nodes.cia402.kernels import CYCLIC_OBJECTS, MAX_OBJECT_COUNT

EDS_PATH = Path(__file__).with_name("cia402.eds")
"""Path of the EDS file of the simulated drive."""
_SIZE_BY_DATA_TYPE = {0x02: 1, 0x03: 2, 0x04: 4, 0x05: 1, 0x06: 2, 0x07: 4}
"""Size of each data type [bytes]. Source: CiA 301, data types INTEGER8 to UNSIGNED32."""
_SIGNED_DATA_TYPES = {0x02, 0x03, 0x04}
"""Numbers of the data types with a sign."""
ABORT_NO_OBJECT = 0x06020000
"""SDO abort code: the object does not exist. Source: CiA 301."""
ABORT_NO_SUBINDEX = 0x06090011
"""SDO abort code: the sub-index does not exist. Source: CiA 301."""
ABORT_READ_ONLY = 0x06010002
"""SDO abort code: the object is read-only. Source: CiA 301."""
ABORT_WRONG_TYPE = 0x06070010
"""SDO abort code: the data type does not match. Source: CiA 301."""
ABORT_VALUE_OUT_OF_RANGE = 0x06090030
"""SDO abort code: the value is out of range. Source: CiA 301."""
ABORT_WRONG_STATE = 0x08000022
"""SDO abort code: the request is not possible in the present state of the device.

Source: CiA 301.
"""
ABORT_UNKNOWN_COMMAND = 0x05040001
"""SDO abort code: the command specifier is unknown. Source: CiA 301."""
SDO_CLIENT_ABORT_COMMAND = 0x80
"""First byte of a request with which the client aborts a transfer.

The drive does not answer an abort of the client.
"""

COMMAND_OBJECTS = {
    (0x6040, 0), (0x6060, 0), (0x6071, 0), (0x607A, 0), (0x60B0, 0), (0x60B1, 0), (0x60B2, 0), (0x60FF, 0),
    (0x1010, 1),
}  # fmt: skip
"""Writable objects that are commands and not settings of the drive."""
VISIBLE_STRING_TYPE = 0x0009
"""Data type of a text in an EDS file (VISIBLE_STRING). Source: CiA 306."""

ObjectKey = tuple[int, int]
"""Index and sub-index of an object in the dictionary."""


class SdoAbort(Exception):  # noqa: N818 - the standard's word
    """An error with which a node refuses an SDO request.

    Attributes:
        code: SDO abort code that the node sends to the client.
    """

    def __init__(self, code: int) -> None:
        """Create the error with an SDO abort code."""
        super().__init__(f"{code:#010x}")
        self.code = code


def sdo_reply(request: bytes, access_object: Callable[[bytes, ObjectKey], bytes]) -> bytes:
    """Return the payload with which a node (SDO server) replies to an SDO request.

    Args:
        request: payload of the SDO request, 8 bytes.
        access_object: function that executes the request on an object of the node. The function returns
            the payload of the reply, or raises ``SdoAbort``.
    """
    try:
        return access_object(request, (int.from_bytes(request[1:3], "little"), request[3]))
    except SdoAbort as abort:
        return b"\x80" + request[1:4] + abort.code.to_bytes(4, "little")


class ObjectDictionary:
    """The object dictionary of one drive: the values of all objects.

    Attributes:
        texts: texts by object, such as the name of the device.
        values: values of all other objects. The objects in ``kernels.CYCLIC_OBJECTS`` come first.
    """

    def __init__(self, node_id: int, object_memory: Any = None) -> None:
        """Read the EDS file, and set all objects to the default values.

        Args:
            node_id: node number of the drive. The default identifiers depend on the node number.
            object_memory: memory for ``kernels.MAX_OBJECT_COUNT`` values. If None, a list is
                allocated.
        """
        parser = configparser.ConfigParser(interpolation=None)
        parser.read(EDS_PATH, encoding="ascii")
        self.texts: dict[ObjectKey, bytes] = {}
        self._sizes: dict[ObjectKey, int] = {}
        self._signed: set[ObjectKey] = set()
        self._writable: set[ObjectKey] = set()
        self._mappable: set[ObjectKey] = set()
        self._indices_of: dict[ObjectKey, int] = {
            key: position for position, key in enumerate(CYCLIC_OBJECTS)
        }
        self.values: Any = [0] * MAX_OBJECT_COUNT if object_memory is None else object_memory
        for name in parser.sections():
            if not parser.has_option(name, "DataType"):
                continue
            if int(parser[name]["DataType"], 16) == VISIBLE_STRING_TYPE:
                self.texts[int(name, 16), 0] = parser[name]["DefaultValue"].encode("ascii")
            else:
                self._add_object(name, parser[name], node_id)
        self._indices = {index for index, _ in self._sizes}

    def _add_object(self, name: str, section: configparser.SectionProxy, node_id: int) -> None:
        """Add the object that a section of the EDS file describes."""
        index, _, sub = name.partition("sub")
        key = (int(index, 16), int(sub or "0", 16))
        data_type = int(section["DataType"], 16)
        self._sizes[key] = _SIZE_BY_DATA_TYPE[data_type]
        self._indices_of.setdefault(key, len(self._indices_of))
        self.values[self._indices_of[key]] = sum(
            node_id if term == "$NODEID" else int(term, 0)
            for term in section["DefaultValue"].split("+")
        )
        if data_type in _SIGNED_DATA_TYPES:
            self._signed.add(key)
        if section["AccessType"] != "ro":
            self._writable.add(key)
        if section["PDOMapping"] == "1":
            self._mappable.add(key)

    def __getitem__(self, key: ObjectKey) -> int:
        """Return the value of an object of the dictionary."""
        value: int = self.values[self._indices_of[key]]
        return value

    def __setitem__(self, key: ObjectKey, value: int) -> None:
        """Set the value of an object from inside the drive.

        If the value is outside the range of the object's data type, the nearest value of the range
        is used.
        """
        bits = 8 * self._sizes[key]
        low, high = (
            (-(1 << bits - 1), (1 << bits - 1) - 1) if key in self._signed else (0, (1 << bits) - 1)
        )
        self.values[self._indices_of[key]] = min(high, max(low, value))

    def settings(self) -> dict[ObjectKey, int]:
        """Return the values of the objects that a drive can store.

        A drive can store all writable objects that are not commands.
        """
        return {key: self[key] for key in self._writable if key not in COMMAND_OBJECTS}

    def object_size(self, key: ObjectKey) -> int:
        """Return the size of an object [bytes].

        Raises:
            SdoAbort: the object does not exist.
        """
        if key not in self._sizes:
            raise SdoAbort(ABORT_NO_SUBINDEX if key[0] in self._indices else ABORT_NO_OBJECT)
        return self._sizes[key]

    def is_mappable(self, key: ObjectKey) -> bool:
        """Return True if an object can be mapped into a PDO."""
        return key in self._mappable

    def read(self, key: ObjectKey) -> bytes:
        """Return the value of an object as bytes.

        Raises:
            SdoAbort: the object does not exist.
        """
        size = self.object_size(key)
        return self[key].to_bytes(size, "little", signed=key in self._signed)

    def write(self, key: ObjectKey, value_bytes: bytes) -> None:
        """Write the bytes of a value, as received in a frame, to an object.

        Raises:
            SdoAbort: the object does not exist, is read-only, or has a different length.
        """
        if len(value_bytes) != self.object_size(key):
            raise SdoAbort(ABORT_WRONG_TYPE)
        if key not in self._writable:
            raise SdoAbort(ABORT_READ_ONLY)
        self.values[self._indices_of[key]] = int.from_bytes(
            value_bytes, "little", signed=key in self._signed
        )
