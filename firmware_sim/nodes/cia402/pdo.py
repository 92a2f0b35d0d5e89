"""The process data objects (PDOs) of the simulated CiA 402 drive.

The drive has four RPDOs and four TPDOs. A host maps the PDOs over SDO. Source: fact sheet cia402.

Objects of PDO i:

    0x1400+i, 0x1800+i  communication: 1 identifier (bit 31: PDO is off), 2 transmission type
    0x1600+i, 0x1A00+i  mapping: 0 number of entries, 1.. entries

    entry: index in bits 31..16, sub-index in bits 15..8, length in bits 7..0 [bit]
"""

from collections.abc import Iterator

from firmware_sim.bus.frame import Frame
from firmware_sim.nodes.cia402.object_dictionary import (
    ABORT_VALUE_OUT_OF_RANGE,
    ObjectDictionary,
    ObjectKey,
    SdoAbort,
)

PDO_DISABLED_BIT = 1 << 31
"""Bit in the identifier object of a PDO: the PDO is off."""
ABORT_NOT_MAPPABLE = 0x06040041
"""SDO abort code: the object cannot be mapped. Source: CiA 301."""
ABORT_PDO_TOO_LONG = 0x06040042
"""SDO abort code: the mapped objects exceed the length of a PDO. Source: CiA 301."""
STANDARD_RPDO = [((0x6040, 0), 2), ((0x6071, 0), 2)]
"""Mapping of the only RPDO that compiled kernels can handle: mapped objects and their sizes [bytes]."""
STANDARD_TPDO = [((0x6041, 0), 2), ((0x6064, 0), 4), ((0x6077, 0), 2)]
"""Mapping of the only TPDO that compiled kernels can handle: mapped objects and their sizes [bytes]."""
MAX_SYNCHRONOUS_TYPE = 240
"""Highest transmission type with which a PDO depends on SYNC."""


class NodePdos:
    """The received and sent PDOs of one node."""

    def __init__(self, objects: ObjectDictionary) -> None:
        """Connect the PDOs to the communication and mapping objects of an object dictionary."""
        self._objects = objects
        self._waiting: dict[int, bytes] = {}

    def write(self, key: ObjectKey, value_bytes: bytes) -> None:
        """Write a communication or mapping object over SDO.

        Raises:
            SdoAbort: the mapping is not possible, or an active PDO uses the mapping.
        """
        index, sub = key
        if index & 0x200:
            if not self._objects[index - 0x200, 1] & PDO_DISABLED_BIT:
                raise SdoAbort(0x08000022)
            value = int.from_bytes(value_bytes, "little")
            if sub == 0:
                self._check_mapping(index, value)
            elif self._objects[index, 0]:
                raise SdoAbort(0x08000022)
            elif value and not self._objects.is_mappable((value >> 16, value >> 8 & 0xFF)):
                raise SdoAbort(ABORT_NOT_MAPPABLE)
        self._objects.write(key, value_bytes)

    def _check_mapping(self, mapping_index: int, entry_count: int) -> None:
        """Check that the mapping of a PDO has an allowed number of entries and an allowed total length."""
        if entry_count > 4:
            raise SdoAbort(ABORT_VALUE_OUT_OF_RANGE)
        if sum(self._objects[mapping_index, i + 1] & 0xFF for i in range(entry_count)) > 64:
            raise SdoAbort(ABORT_PDO_TOO_LONG)

    def _mapped_objects(self, mapping_index: int) -> Iterator[tuple[ObjectKey, int]]:
        """Yield each object in the mapping of a PDO, together with the size of the object [bytes]."""
        for i in range(self._objects[mapping_index, 0]):
            entry = self._objects[mapping_index, i + 1]
            yield (entry >> 16, entry >> 8 & 0xFF), (entry & 0xFF) // 8

    def _rpdo_index(self, can_id: int) -> int:
        """Return the index of the RPDO with a given identifier.

        If no RPDO has the given identifier, return -1.
        """
        return next((i for i in range(4) if self._objects[0x1400 + i, 1] == can_id), -1)

    def accepts_identifier(self, can_id: int) -> bool:
        """Return True if an RPDO of the node has the given identifier."""
        return self._rpdo_index(can_id) >= 0

    def unpack(self, can_id: int, payload: bytes) -> list[ObjectKey] | None:
        """Write the objects of an RPDO at once, or keep a synchronous RPDO until the next SYNC frame.

        Returns:
            The objects that were written at once, or None if the RPDO is too short.
        """
        number = self._rpdo_index(can_id)
        if len(payload) < sum(size for _, size in self._mapped_objects(0x1600 + number)):
            return None
        if self._objects[0x1400 + number, 2] <= MAX_SYNCHRONOUS_TYPE:
            self._waiting[number] = payload
            return []
        return self._store_rpdo(number, payload)

    def _store_rpdo(self, pdo_number: int, payload: bytes) -> list[ObjectKey]:
        """Write the objects of an RPDO, and return the keys of these objects."""
        keys = []
        offset = 0
        for key, size in self._mapped_objects(0x1600 + pdo_number):
            self._objects.write(key, payload[offset : offset + size])
            keys.append(key)
            offset += size
        return keys

    def synchronise(self) -> list[ObjectKey]:
        """Write the objects of the RPDOs that have waited for a SYNC frame.

        Returns:
            The objects that were written.
        """
        pending_pdos = self._waiting
        self._waiting = {}
        return [
            key for number, data in pending_pdos.items() for key in self._store_rpdo(number, data)
        ]

    def frames_on_sync(self, sync_count: int) -> list[Frame]:
        """Return the TPDOs that the node sends in reply to a SYNC frame.

        Args:
            sync_count: number of SYNC frames since the last reset.
        """
        transmissions = {i: self._objects[0x1800 + i, 2] for i in self._active_tpdos()}
        return [
            self._tpdo_frame(i)
            for i, transmission in transmissions.items()
            if 1 <= transmission <= MAX_SYNCHRONOUS_TYPE and sync_count % transmission == 0
        ]

    @property
    def identifiers(self) -> list[int]:
        """Return the identifiers of all RPDOs of the node."""
        return [self._objects[0x1400 + i, 1] for i in range(4)]

    def standard_rpdo(self) -> int:
        """Return the identifier of the RPDO that compiled kernels can handle.

        The RPDO contains the control word and the target torque, and the node applies it at once,
        without waiting for SYNC. If the node has no RPDO of this kind, return -1.
        """
        for i in range(4):
            can_id = self._objects[0x1400 + i, 1]
            transmission = self._objects[0x1400 + i, 2]
            if (
                can_id < 0x800
                and transmission > MAX_SYNCHRONOUS_TYPE
                and self._rpdo_index(can_id) == i
            ):
                return can_id if list(self._mapped_objects(0x1600 + i)) == STANDARD_RPDO else -1
        return -1

    def standard_tpdo(self) -> tuple[int, int]:
        """Return the identifier and the transmission type of the TPDO that compiled kernels can handle.

        Compiled kernels need a single active TPDO, which contains status word, position and torque,
        and is sent after SYNC. No RPDO is allowed to depend on SYNC. If a TPDO or RPDO is
        configured differently, the returned identifier is -1.
        """
        active = self._active_tpdos()
        waits_for_sync = any(
            self._objects[0x1400 + i, 2] <= MAX_SYNCHRONOUS_TYPE
            for i in range(4)
            if self.identifiers[i] < PDO_DISABLED_BIT
        )
        if len(active) != 1 or waits_for_sync or self._waiting:
            return -1, 0
        (i,) = active
        transmission = self._objects[0x1800 + i, 2]
        standard = (
            1 <= transmission <= MAX_SYNCHRONOUS_TYPE
            and list(self._mapped_objects(0x1A00 + i)) == STANDARD_TPDO
        )
        return (self._objects[0x1800 + i, 1] & 0x7FF if standard else -1), transmission

    def event_driven_frames(self) -> list[Frame]:
        """Return the frames of the TPDOs that the node sends when a value has changed."""
        return [
            self._tpdo_frame(i) for i in self._active_tpdos() if self._objects[0x1800 + i, 2] >= 254
        ]

    def _active_tpdos(self) -> list[int]:
        """List the indices of the TPDOs that are switched on."""
        return [i for i in range(4) if not self._objects[0x1800 + i, 1] & PDO_DISABLED_BIT]

    def _tpdo_frame(self, pdo_number: int) -> Frame:
        """Build the frame of a TPDO."""
        data = b"".join(
            self._objects.read(key) for key, _ in self._mapped_objects(0x1A00 + pdo_number)
        )
        return Frame(self._objects[0x1800 + pdo_number, 1] & 0x7FF, data)
