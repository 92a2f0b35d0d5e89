"""Conversion of batches of frames between records and ``struct canfd_frame``.

No loop over the frames is needed.

    can_id 32 | length 8 | flags 8 | reserved 16 | data 64 x 8

The local bus sends this struct for every frame. For a classical frame, a CAN socket fills only the
first 16 bytes of the struct. The head of a struct is its first 8 bytes. The head of a record is its
8 bytes from identifier to length. In every tick, the same identifiers, flags and lengths are
exchanged. Therefore the converted heads of a batch are cached, and a tick has to copy only the
payloads.
Source: Linux ``can.h``.
"""

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.drives.frame import ERROR_FLAG, FDF, Frame
from handctl.drives.frame_records import FRAME_RECORD_DTYPE, Frames, RecordArray
from handctl.runtime.buses.contract import check_payload_size

CANFD_FRAME_DTYPE = np.dtype(
    [
        ("can_id", "<u4"),
        ("length", "u1"),
        ("flags", "u1"),
        ("reserved", "<u2"),
        ("data", "<u8", (8,)),
    ]
)
CANFD_FRAME_BYTES = CANFD_FRAME_DTYPE.itemsize
"""Size of ``struct canfd_frame``, and MTU of an interface that carries CAN FD [bytes]."""
CLASSICAL_FRAME_BYTES = 16
"""Size of ``struct can_frame`` [bytes]."""
MAX_PAYLOAD_BYTES = 64
"""Payload of the longest frame [bytes]."""
CACHED_BATCHES = 256
"""Largest number of batches whose converted heads are cached."""
MAX_CACHED_FRAMES = 128
"""Largest number of frames in a cached batch.

Larger batches are not cached, so that a flood of frames does not fill the memory.
"""
WORD_DTYPE = np.dtype("<u8")
PAYLOAD_DTYPE = np.dtype(("<u8", (8,)))
_HEADER_DTYPE = np.dtype(CANFD_FRAME_DTYPE.descr[:-1])
TIME_OFFSET, HEAD_OFFSET, DATA_OFFSET = (
    FRAME_RECORD_DTYPE.fields[name][1]  # type: ignore[index]
    for name in ("t_ns", "can_id", "data")
)
"""Offsets in a record [bytes]: time, head (from identifier to length), payload."""

WordArray = NDArray[np.uint64]


def _payload_masks() -> WordArray:
    """Return bit masks for the 64-byte data field, as an array (MAX_PAYLOAD_BYTES + 1, 8).

    Row n of the array selects the first n bytes of the field.
    """
    masks = np.zeros((MAX_PAYLOAD_BYTES + 1, MAX_PAYLOAD_BYTES), np.uint8)
    for length in range(MAX_PAYLOAD_BYTES + 1):
        masks[length, :length] = 0xFF
    return masks.view(np.uint64)


PAYLOAD_MASKS = _payload_masks()
_PAYLOAD_LENGTHS = bytes(min(length, MAX_PAYLOAD_BYTES) for length in range(256))
"""Table for ``bytes.translate``.

This table limits the length byte of a struct to MAX_PAYLOAD_BYTES.
"""
_ERROR_FRAME_MARKS = bytes((highest << 24 & ERROR_FLAG) != 0 for highest in range(256))
"""Table for ``bytes.translate``.

The highest byte of an identifier becomes 1 for an error frame, and 0 for any other frame.
"""


class ReceivedHeads(NamedTuple):
    """Heads of received structs, converted to records.

    Attributes:
        heads: (n,) identifier, flags, bus and length of each record.
        payload_words: number of 8-byte words that the longest payload of the batch needs, at least
            1.
        payload_masks: bits that belong to each payload. The shape is (n,) for one word, and (n,
            words) for more words. It is None if every payload fills all of its words.
        has_error_frames: True if there is an error frame among the structs.
    """

    heads: WordArray
    payload_words: int
    payload_masks: WordArray | None
    has_error_frames: bool


@functools.lru_cache
def _flag_table(mask: int, added: int) -> bytes:
    """Return a table for ``bytes.translate`` which converts the flags of a struct to the flags of a record."""
    return bytes(flags & mask | added for flags in range(256))


@functools.lru_cache(maxsize=CACHED_BATCHES)
def _convert_received(raw: bytes, bus: int, flag_mask: int, added_flags: int) -> ReceivedHeads:
    """Convert heads of structs to heads of records.

    The function slices columns of bytes. For a batch that is not in the cache, this is faster than
    numpy.
    """
    # Bytes of a head in a struct:  can_id 0..3 | length 4 | flags 5 | reserved 6..7
    # Bytes of a head in a record:  can_id 0..3 | flags  4 | zero  5 | bus 6 | length 7
    lengths = raw[4::8].translate(_PAYLOAD_LENGTHS)
    count = len(raw) // 8
    heads = bytearray(len(raw))
    for i in range(4):
        heads[i::8] = raw[i::8]
    heads[4::8] = raw[5::8].translate(_flag_table(flag_mask, added_flags))
    heads[6::8] = bytes((bus,)) * count
    heads[7::8] = lengths
    words = max(1, -(-max(lengths, default=0) // 8))  # division of two integers, rounded up
    masks = None  # usually every payload fills its words, so that no byte has to be set to zero
    if lengths.count(8 * words) < count:
        masks = PAYLOAD_MASKS[:, 0] if words == 1 else PAYLOAD_MASKS[:, :words]
        masks = masks.take(np.frombuffer(lengths, np.uint8), axis=0)
    return ReceivedHeads(
        np.frombuffer(heads, WORD_DTYPE), words, masks, 1 in raw[3::8].translate(_ERROR_FRAME_MARKS)
    )


class SentHeads(NamedTuple):
    """Heads of the records to send, converted to structs.

    Attributes:
        heads: (n,) identifier, length and flags of each struct.
        payload_words: number of 8-byte words that the longest payload of the batch needs, at least
            1.
        frame_sizes: (n,) number of bytes of each struct that are sent: the size of ``can_frame`` or
            ``canfd_frame``.
    """

    heads: WordArray
    payload_words: int
    frame_sizes: WordArray


@functools.lru_cache(maxsize=CACHED_BATCHES)
def _convert_sent(raw: bytes) -> SentHeads:
    """Convert heads of records to heads of structs.

    Raises:
        ValueError: a payload is longer than a frame of its kind can carry.
    """
    words = np.frombuffer(raw, WORD_DTYPE)
    records = np.zeros(len(words), FRAME_RECORD_DTYPE)
    records.setfield(words, WORD_DTYPE, HEAD_OFFSET)
    fd = (records["flags"] & FDF) != 0
    lengths = records["length"]
    for i in np.flatnonzero(lengths > np.where(fd, MAX_PAYLOAD_BYTES, 8))[:1]:
        check_payload_size(
            Frame(int(records["can_id"][i]), bytes(int(lengths[i])), int(records["flags"][i]))
        )
    heads = np.zeros(len(records), _HEADER_DTYPE)
    heads["can_id"] = records["can_id"]
    heads["length"] = lengths
    heads["flags"] = np.where(fd, records["flags"], 0)
    longest = max(1, -(-int(lengths.max(initial=0)) // 8))
    return SentHeads(
        heads.view(WORD_DTYPE),
        longest,
        np.where(fd, CANFD_FRAME_BYTES, CLASSICAL_FRAME_BYTES).astype(np.uint64),
    )


class FrameStructs:
    """An array of ``struct canfd_frame`` in memory, whose columns can be read and written.

    Attributes:
        count: number of structs.
    """

    def __init__(self, memory: Any) -> None:
        """Create views of ``memory``, a writable buffer whose size is a whole number of structs."""
        rows = np.frombuffer(memory, WORD_DTYPE).reshape(-1, CANFD_FRAME_BYTES // 8)
        self.count = len(rows)
        self._heads = rows[:, 0]
        self._data = rows[:, 1:]
        self._first = rows[:, 1]
        self._written = 8

    def converted_heads(
        self, count: int, bus: int, flag_mask: int = 0xFF, added_flags: int = 0
    ) -> ReceivedHeads:
        """Return the heads of the first ``count`` structs, converted to heads of records.

        Args:
            count: number of structs to convert.
            bus: index of the bus, which is written into every head.
            flag_mask: mask that selects the flags to copy from the structs.
            added_flags: flags that are set in every converted head.
        """
        convert = _convert_received if count <= MAX_CACHED_FRAMES else _convert_received.__wrapped__
        return convert(self._heads[:count].tobytes(), bus, flag_mask, added_flags)

    def reserved_bits(self, at: int) -> int:
        """Return the value in the 16 reserved bits of the struct with index ``at``."""
        return int(self._heads[at]) >> 48

    def read(
        self, count: int, heads: ReceivedHeads, t_ns: "int | NDArray[np.int64]"
    ) -> RecordArray:
        """Return the first ``count`` structs as records.

        Args:
            count: number of structs to read.
            heads: converted heads of these structs.
            t_ns: time of reception [ns], which is one time for all frames or one time for each
                frame.
        """
        records: RecordArray = np.zeros(count, FRAME_RECORD_DTYPE)
        records.setfield(t_ns, np.dtype("<i8"), TIME_OFFSET)
        records.setfield(heads.heads, WORD_DTYPE, HEAD_OFFSET)
        if heads.payload_words == 1:
            first = self._first[:count]
            records.setfield(
                first if heads.payload_masks is None else first & heads.payload_masks,
                WORD_DTYPE,
                DATA_OFFSET,
            )
        else:
            data = self._data[:count, : heads.payload_words]
            payload = records.getfield(PAYLOAD_DTYPE, DATA_OFFSET)[:, : heads.payload_words]
            payload[...] = data if heads.payload_masks is None else data & heads.payload_masks
        return records

    def write(self, frames: Frames) -> SentHeads:
        """Write frames into the first structs. Bytes after the end of a payload are set to zero.

        Raises:
            ValueError: a payload is longer than a frame of its kind can carry. In this case,
                nothing is written.
        """
        records = frames.records
        count = len(records)
        convert = _convert_sent if count <= MAX_CACHED_FRAMES else _convert_sent.__wrapped__
        sent = convert(records.getfield(WORD_DTYPE, HEAD_OFFSET).tobytes())
        self._heads[:count] = sent.heads
        if (
            sent.payload_words < self._written
        ):  # set the bytes to zero that remain from longer payloads of the previous batch
            self._data[:, sent.payload_words :] = 0
        self._written = sent.payload_words
        if sent.payload_words == 1:
            self._first[:count] = records.getfield(WORD_DTYPE, DATA_OFFSET)
        else:
            self._data[:count, : sent.payload_words] = records.getfield(PAYLOAD_DTYPE, DATA_OFFSET)[
                :, : sent.payload_words
            ]
        return sent


def without_errors(records: RecordArray) -> tuple[Frames, list[Frame]]:
    """Split records into data frames and error frames."""
    errors = (records["can_id"] & ERROR_FLAG) != 0
    return Frames(records[~errors]), list(Frames(records[errors]))
