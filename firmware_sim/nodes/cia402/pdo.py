"""Process data of the simulated CiA 402 drive: four PDOs each way, mapped over SDO. Source: facts, cia402."""

from collections.abc import Iterator

from firmware_sim.bus.frame import Frame
from firmware_sim.nodes.cia402.dictionary import RANGE, Abort, Dictionary, Key

OFF = 1 << 31
NOT_MAPPABLE, TOO_LONG = 0x06040041, 0x06040042
USUAL_RPDO = [((0x6040, 0), 2), ((0x6071, 0), 2)]
USUAL_TPDO = [((0x6041, 0), 2), ((0x6064, 0), 4), ((0x6077, 0), 2)]
"""Mappings that compiled laws know: objects and their bytes."""
SYNCHRONOUS = 240
"""Transmission types up to here depend on SYNC."""


class Pdos:
    """The PDO engine of one node."""

    def __init__(self, objects: Dictionary) -> None:
        """Args: the node's dictionary, which holds communication and mapping."""
        self._objects = objects
        self._waiting: dict[int, bytes] = {}

    def write(self, key: Key, raw: bytes) -> None:
        """Write communication or mapping over SDO.

        Raises:
            Abort: a mapping that cannot be, or one that is changed while it is in use.
        """
        index, sub = key
        if index & 0x200:
            if not self._objects[index - 0x200, 1] & OFF:
                raise Abort(0x08000022)
            value = int.from_bytes(raw, "little")
            if sub == 0:
                self._check(index, value)
            elif self._objects[index, 0]:
                raise Abort(0x08000022)
            elif value and not self._objects.mappable((value >> 16, value >> 8 & 0xFF)):
                raise Abort(NOT_MAPPABLE)
        self._objects.write(key, raw)

    def _check(self, index: int, count: int) -> None:
        if count > 4:
            raise Abort(RANGE)
        if sum(self._objects[index, i + 1] & 0xFF for i in range(count)) > 64:
            raise Abort(TOO_LONG)

    def _entries(self, mapping: int) -> Iterator[tuple[Key, int]]:
        """Objects of a mapping and their bytes."""
        for i in range(self._objects[mapping, 0]):
            entry = self._objects[mapping, i + 1]
            yield (entry >> 16, entry >> 8 & 0xFF), (entry & 0xFF) // 8

    def _receiver(self, can_id: int) -> int:
        """Return which RPDO has an identifier; -1 if none."""
        return next((i for i in range(4) if self._objects[0x1400 + i, 1] == can_id), -1)

    def receives(self, can_id: int) -> bool:
        """Return whether an RPDO has this identifier."""
        return self._receiver(can_id) >= 0

    def unpack(self, can_id: int, data: bytes) -> list[Key] | None:
        """Take an RPDO; return the objects that were written now, None if it is too short."""
        number = self._receiver(can_id)
        if len(data) < sum(size for _, size in self._entries(0x1600 + number)):
            return None
        if self._objects[0x1400 + number, 2] <= SYNCHRONOUS:
            self._waiting[number] = data
            return []
        return self._store(number, data)

    def _store(self, number: int, data: bytes) -> list[Key]:
        keys, offset = [], 0
        for key, size in self._entries(0x1600 + number):
            self._objects.write(key, data[offset : offset + size])
            keys.append(key)
            offset += size
        return keys

    def synchronise(self) -> list[Key]:
        """Take over the RPDOs that waited for SYNC; return the objects that were written."""
        waiting, self._waiting = self._waiting, {}
        return [key for number, data in waiting.items() for key in self._store(number, data)]

    def on_sync(self, syncs: int) -> list[Frame]:
        """Return the TPDOs of a SYNC; ``syncs``: how many there were."""
        kinds = {i: self._objects[0x1800 + i, 2] for i in self._active()}
        return [self._frame(i) for i, kind in kinds.items() if 1 <= kind <= SYNCHRONOUS and syncs % kind == 0]

    @property
    def identifiers(self) -> list[int]:
        """Identifiers that RPDOs receive."""
        return [self._objects[0x1400 + i, 1] for i in range(4)]

    def usual_rpdo(self) -> int:
        """Return the identifier of the RPDO that writes control word and target torque at once; -1 if there is none."""
        for i in range(4):
            can_id, kind = self._objects[0x1400 + i, 1], self._objects[0x1400 + i, 2]
            if can_id < 0x800 and kind > SYNCHRONOUS and self._receiver(can_id) == i:
                return can_id if list(self._entries(0x1600 + i)) == USUAL_RPDO else -1
        return -1

    def usual_tpdo(self) -> tuple[int, int]:
        """Return identifier and type of the only TPDO: status word, position, torque after SYNC.

        The identifier is -1 if PDOs are arranged in any other way, or an RPDO waits for SYNC.
        """
        active = self._active()
        waits = any(self._objects[0x1400 + i, 2] <= SYNCHRONOUS for i in range(4) if self.identifiers[i] < OFF)
        if len(active) != 1 or waits or self._waiting:
            return -1, 0
        (i,) = active
        kind = self._objects[0x1800 + i, 2]
        usual = 1 <= kind <= SYNCHRONOUS and list(self._entries(0x1A00 + i)) == USUAL_TPDO
        return (self._objects[0x1800 + i, 1] & 0x7FF if usual else -1), kind

    def on_event(self) -> list[Frame]:
        """Return the TPDOs that are sent on a change."""
        return [self._frame(i) for i in self._active() if self._objects[0x1800 + i, 2] >= 254]

    def _active(self) -> list[int]:
        return [i for i in range(4) if not self._objects[0x1800 + i, 1] & OFF]

    def _frame(self, number: int) -> Frame:
        data = b"".join(self._objects.read(key) for key, _ in self._entries(0x1A00 + number))
        return Frame(self._objects[0x1800 + number, 1] & 0x7FF, data)
