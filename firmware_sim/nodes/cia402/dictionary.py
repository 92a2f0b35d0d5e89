"""The object dictionary of the simulated CiA 402 drive, as its EDS file lists it."""

import configparser
from pathlib import Path
from typing import Any

from firmware_sim.nodes.cia402.laws import HOT, ROOM

EDS = Path(__file__).with_name("cia402.eds")
_SIZES = {0x02: 1, 0x03: 2, 0x04: 4, 0x05: 1, 0x06: 2, 0x07: 4}
"""Bytes of each data type. Source: CiA 301, data types INTEGER8 to UNSIGNED32."""
_SIGNED = {0x02, 0x03, 0x04}
NO_OBJECT, NO_SUB, READ_ONLY, LENGTH, RANGE = 0x06020000, 0x06090011, 0x06010002, 0x06070010, 0x06090030
"""SDO aborts."""

Key = tuple[int, int]
"""Index and sub-index."""


class Abort(Exception):  # noqa: N818 - the standard's word
    """A request that is refused; ``code`` goes back to the client."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:#010x}")
        self.code = code


class Dictionary:
    """Values of all objects of one node.

    Attributes:
        values: of the objects, those of ``laws.HOT`` first.
    """

    def __init__(self, node_id: int, memory: Any = None) -> None:
        """Args: node_id, on which default identifiers depend; memory for ``laws.ROOM`` values, if not its own."""
        parser = configparser.ConfigParser(interpolation=None)
        parser.read(EDS, encoding="ascii")
        self._sizes: dict[Key, int] = {}
        self._signed: set[Key] = set()
        self._writable: set[Key] = set()
        self._mappable: set[Key] = set()
        self._places: dict[Key, int] = {key: place for place, key in enumerate(HOT)}
        self.values: Any = [0] * ROOM if memory is None else memory
        for name in parser.sections():
            if parser.has_option(name, "DataType"):
                self._add(name, parser[name], node_id)
        self._indices = {index for index, _ in self._sizes}

    def _add(self, name: str, section: configparser.SectionProxy, node_id: int) -> None:
        index, _, sub = name.partition("sub")
        key, kind = (int(index, 16), int(sub or "0", 16)), int(section["DataType"], 16)
        self._sizes[key] = _SIZES[kind]
        self._places.setdefault(key, len(self._places))
        self.values[self._places[key]] = sum(
            node_id if term == "$NODEID" else int(term, 0) for term in section["DefaultValue"].split("+")
        )
        if kind in _SIGNED:
            self._signed.add(key)
        if section["AccessType"] != "ro":
            self._writable.add(key)
        if section["PDOMapping"] == "1":
            self._mappable.add(key)

    def __getitem__(self, key: Key) -> int:
        value: int = self.values[self._places[key]]
        return value

    def __setitem__(self, key: Key, value: int) -> None:
        """Set from the inside; saturates at what the type can hold."""
        bits = 8 * self._sizes[key]
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if key in self._signed else (0, (1 << bits) - 1)
        self.values[self._places[key]] = min(high, max(low, value))

    def size(self, key: Key) -> int:
        """Return the bytes of an object.

        Raises:
            Abort: there is none.
        """
        if key not in self._sizes:
            raise Abort(NO_SUB if key[0] in self._indices else NO_OBJECT)
        return self._sizes[key]

    def mappable(self, key: Key) -> bool:
        """Return whether an object may be mapped into a PDO."""
        return key in self._mappable

    def read(self, key: Key) -> bytes:
        """Return an object's bytes.

        Raises:
            Abort: there is none.
        """
        size = self.size(key)
        return self[key].to_bytes(size, "little", signed=key in self._signed)

    def write(self, key: Key, raw: bytes) -> None:
        """Take bytes from the wire.

        Raises:
            Abort: no such object, read-only, or another length.
        """
        if len(raw) != self.size(key):
            raise Abort(LENGTH)
        if key not in self._writable:
            raise Abort(READ_ONLY)
        self.values[self._places[key]] = int.from_bytes(raw, "little", signed=key in self._signed)
