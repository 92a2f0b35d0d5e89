"""Conversion of frame batches between records and ``struct canfd_frame``, without a loop over frames.

    can_id 32 | length 8 | flags 8 | reserved 16 | data 64 x 8

The local bus sends this struct. For a classical frame, a CAN socket fills only the first 16 bytes
of the struct. Ticks exchange the same identifiers, flags and lengths again and again. The converted
heads of each batch are therefore cached, and a tick copies only the payloads. The head of a struct
is its first 8 bytes. The head of a record is its 8 bytes from identifier to length. Source: Linux
``can.h``.
"""

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.drives.frame import ERROR, FDF, Frame
from handctl.drives.records import RECORD, Frames, Records
from handctl.runtime.buses.contract import check_size

STRUCT = np.dtype([("can_id", "<u4"), ("length", "u1"), ("flags", "u1"), ("reserved", "<u2"), ("data", "<u8", (8,))])
SIZE = STRUCT.itemsize
"""Size of ``struct canfd_frame`` [bytes]."""
CLASSICAL_SIZE = 16
"""Size of ``struct can_frame`` [bytes]."""
MAX_PAYLOAD = 64
"""Payload of the longest frame [bytes]."""
CACHED_BATCHES = 256
"""Number of batches whose heads are cached."""
MAX_CACHED_FRAMES = 128
"""Largest number of frames in a cached batch.

Larger batches are not cached, so that a flood of frames does not fill the memory.
"""
WORD = np.dtype("<u8")
PAYLOAD = np.dtype(("<u8", (8,)))
_HEADER_DTYPE = np.dtype(STRUCT.descr[:-1])
T_NS_AT, HEAD_AT, DATA_AT = (RECORD.fields[name][1] for name in ("t_ns", "can_id", "data"))  # type: ignore[index]
"""Offsets in a record [bytes]: time, head (from identifier to length), payload."""

Words = NDArray[np.uint64]


def _payload_masks() -> Words:
    """Return an array (MAX_PAYLOAD + 1, 8).

    Row n masks the n payload bytes in the 64-byte data field.
    """
    masks = np.zeros((MAX_PAYLOAD + 1, MAX_PAYLOAD), np.uint8)
    for length in range(MAX_PAYLOAD + 1):
        masks[length, :length] = 0xFF
    return masks.view(np.uint64)


MASKS = _payload_masks()
_LENGTHS = bytes(min(length, MAX_PAYLOAD) for length in range(256))
"""Table for ``bytes.translate``: from the length byte of a struct to the payload length, at most MAX_PAYLOAD."""
_ERRORS = bytes((highest << 24 & ERROR) != 0 for highest in range(256))
"""Table for ``bytes.translate``: from the highest byte of an identifier to 1 for an error frame and 0 for others."""


class Received(NamedTuple):
    """Heads of received structs, converted to records.

    Attributes:
        heads: (n,) identifier, flags, bus and length of each record.
        words: number of 8-byte words that hold the longest payload of the batch, at least 1.
        masks: bits that belong to each payload, (n,) for one word and (n, words) for more. It is
            None if every payload fills all its words.
        errors: True if there is an error frame among the structs.
    """

    heads: Words
    words: int
    masks: Words | None
    errors: bool


@functools.lru_cache
def _flag_table(mask: int, added: int) -> bytes:
    """Return a table for ``bytes.translate`` from the flags of a struct to the flags of a record."""
    return bytes(flags & mask | added for flags in range(256))


@functools.lru_cache(maxsize=CACHED_BATCHES)
def _convert_received(raw: bytes, bus: int, flag_mask: int, added_flags: int) -> Received:
    """Convert heads of structs to heads of records.

    The conversion slices columns of bytes. For a batch that is not cached, this is faster than
    numpy.
    """
    # Bytes of a head in a struct:  can_id 0..3 | length 4 | flags 5 | reserved 6..7
    # Bytes of a head in a record:  can_id 0..3 | flags  4 | zero  5 | bus 6 | length 7
    lengths = raw[4::8].translate(_LENGTHS)
    count = len(raw) // 8
    heads = bytearray(len(raw))
    for i in range(4):
        heads[i::8] = raw[i::8]
    heads[4::8] = raw[5::8].translate(_flag_table(flag_mask, added_flags))
    heads[6::8] = bytes((bus,)) * count
    heads[7::8] = lengths
    words = max(1, -(-max(lengths, default=0) // 8))  # rounded up
    masks = None  # usual case: every payload fills its words, so no byte has to be cleared
    if lengths.count(8 * words) < count:
        masks = MASKS[:, 0] if words == 1 else MASKS[:, :words]
        masks = masks.take(np.frombuffer(lengths, np.uint8), axis=0)
    return Received(np.frombuffer(heads, WORD), words, masks, 1 in raw[3::8].translate(_ERRORS))


class Sent(NamedTuple):
    """Heads of records to be sent, converted to structs.

    Attributes:
        heads: (n,) identifier, length and flags of each struct.
        words: number of 8-byte words that hold the longest payload of the batch, at least 1.
        sizes: (n,) bytes to send of each struct: the size of ``can_frame`` or of ``canfd_frame``.
    """

    heads: Words
    words: int
    sizes: Words


@functools.lru_cache(maxsize=CACHED_BATCHES)
def _convert_sent(raw: bytes) -> Sent:
    """Convert heads of records to heads of structs.

    Raises:
        ValueError: a payload is longer than its kind of frame can carry.
    """
    words = np.frombuffer(raw, WORD)
    records = np.zeros(len(words), RECORD)
    records.setfield(words, WORD, HEAD_AT)
    fd = (records["flags"] & FDF) != 0
    lengths = records["length"]
    for i in np.flatnonzero(lengths > np.where(fd, MAX_PAYLOAD, 8))[:1]:
        check_size(Frame(int(records["can_id"][i]), bytes(int(lengths[i])), int(records["flags"][i])))
    heads = np.zeros(len(records), _HEADER_DTYPE)
    heads["can_id"] = records["can_id"]
    heads["length"] = lengths
    heads["flags"] = np.where(fd, records["flags"], 0)
    longest = max(1, -(-int(lengths.max(initial=0)) // 8))
    return Sent(heads.view(WORD), longest, np.where(fd, SIZE, CLASSICAL_SIZE).astype(np.uint64))


class Structs:
    """An array of ``struct canfd_frame`` in memory, read and written by columns.

    Attributes:
        count: number of structs.
    """

    def __init__(self, memory: Any) -> None:
        """Make views into ``memory``, a writable buffer with a whole number of structs."""
        rows = np.frombuffer(memory, WORD).reshape(-1, SIZE // 8)
        self.count = len(rows)
        self._heads = rows[:, 0]
        self._data = rows[:, 1:]
        self._first = rows[:, 1]
        self._written = 8

    def converted_heads(self, count: int, bus: int, flag_mask: int = 0xFF, added_flags: int = 0) -> Received:
        """Return the heads of the first ``count`` structs, converted to heads of records.

        Args:
            count: number of structs to convert.
            bus: index of the bus, written into every head.
            flag_mask: mask of the flags to copy from the structs.
            added_flags: flags to set in every converted head.
        """
        convert = _convert_received if count <= MAX_CACHED_FRAMES else _convert_received.__wrapped__
        return convert(self._heads[:count].tobytes(), bus, flag_mask, added_flags)

    def reserved(self, at: int) -> int:
        """Return the value in the 16 reserved bits of the struct with index ``at``."""
        return int(self._heads[at]) >> 48

    def read(self, count: int, heads: Received, t_ns: "int | NDArray[np.int64]") -> Records:
        """Return the first ``count`` structs as records.

        Args:
            count: number of structs to read.
            heads: converted heads of these structs.
            t_ns: time of reception [ns]: one time for all frames, or one for each.
        """
        records: Records = np.zeros(count, RECORD)
        records.setfield(t_ns, np.dtype("<i8"), T_NS_AT)
        records.setfield(heads.heads, WORD, HEAD_AT)
        if heads.words == 1:
            first = self._first[:count]
            records.setfield(first if heads.masks is None else first & heads.masks, WORD, DATA_AT)
        else:
            data = self._data[:count, : heads.words]
            payload = records.getfield(PAYLOAD, DATA_AT)[:, : heads.words]
            payload[...] = data if heads.masks is None else data & heads.masks
        return records

    def write(self, frames: Frames) -> Sent:
        """Write frames into the first structs. Payload bytes behind the end of a frame are set to zero.

        Raises:
            ValueError: a payload is longer than its kind of frame can carry. Nothing is written.
        """
        records = frames.records
        count = len(records)
        convert = _convert_sent if count <= MAX_CACHED_FRAMES else _convert_sent.__wrapped__
        sent = convert(records.getfield(WORD, HEAD_AT).tobytes())
        self._heads[:count] = sent.heads
        if sent.words < self._written:  # otherwise bytes of longer payloads of the previous batch would remain
            self._data[:, sent.words :] = 0
        self._written = sent.words
        if sent.words == 1:
            self._first[:count] = records.getfield(WORD, DATA_AT)
        else:
            self._data[:count, : sent.words] = records.getfield(PAYLOAD, DATA_AT)[:, : sent.words]
        return sent


def without_errors(records: Records) -> tuple[Frames, list[Frame]]:
    """Split records into data frames and error frames."""
    errors = (records["can_id"] & ERROR) != 0
    return Frames(records[~errors]), list(Frames(records[errors]))
