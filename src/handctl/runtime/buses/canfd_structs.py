"""Compiled loops that convert batches of frames between records and ``struct canfd_frame``.

    can_id 32 | length 8 | flags 8 | reserved 16 | data 64 x 8

The local bus sends ``struct canfd_frame``. For a classical frame, a CAN socket fills only the first
16 bytes of the struct. Source: Linux ``can.h``. The module ``drives.frame_records`` describes the
record of a frame.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel, kernel_helper
from handctl.drives.frame import ERROR_FLAG, FDF, Frame
from handctl.drives.frame_records import (
    BUS_SHIFT,
    BYTE_MASK,
    FIRST_PAYLOAD_WORD,
    FLAGS_SHIFT,
    ID_AND_FLAGS_WORD,
    ID_MASK,
    LENGTH_SHIFT,
    TIME_WORD,
    WORDS_PER_RECORD,
    Frames,
    WordRows,
)
from handctl.runtime.buses.contract import check_payload_size

CANFD_FRAME_BYTES = 72
"""Size of ``struct canfd_frame``, and MTU of an interface that carries CAN FD [bytes]."""
CLASSICAL_FRAME_BYTES = 16
"""Size of ``struct can_frame`` [bytes]."""
MAX_PAYLOAD_BYTES = 64
"""Payload of the longest frame [bytes]."""
MAX_CLASSICAL_PAYLOAD_BYTES = 8
"""Payload of the longest classical frame [bytes]."""
WORDS_PER_PAYLOAD = MAX_PAYLOAD_BYTES // 8
"""Number of words of eight bytes in the payload of a struct, and of a record."""
# Positions of the lowest bits of the struct's fields in the first word of the struct.
STRUCT_LENGTH_SHIFT = 32
STRUCT_FLAGS_SHIFT = 40
STRUCT_RESERVED_BIT = 48
FLAGS_MASK = 0xFFFF
"""Mask of the flags of a record."""
ALL_FLAGS = 0xFF
"""Value of ``flag_mask`` that keeps all flags of a struct."""


@kernel_helper
def _copy_payload(
    source_words: WordRows,
    source_word: int,
    target_words: WordRows,
    target_word: int,
    row: int,
    payload_length: int,
) -> None:
    """Copy the payload of one frame word by word, and set the bytes after the payload to zero.

    Args:
        source_words: (n, words) records or structs that contain the payload.
        source_word: first word of the payload in the source.
        target_words: (n, words) structs or records that get the payload.
        target_word: first word of the payload in the target.
        row: index of the frame.
        payload_length: length of the payload [bytes].
    """
    for word in range(WORDS_PER_PAYLOAD):
        remaining_length = payload_length - 8 * word
        value = source_words[row, source_word + word] if remaining_length > 0 else np.uint64(0)
        if 0 < remaining_length < 8:
            value &= (np.uint64(1) << np.uint64(8 * remaining_length)) - np.uint64(1)
        target_words[row, target_word + word] = value


@kernel("table_words", "words", "count", "count", "count", "count")
def read_structs(
    structs: WordRows, records: WordRows, t_ns: int, bus: int, flag_mask: int, added_flags: int
) -> bool:
    """Convert structs to records. Return True if one of the structs contains an error frame.

    Args:
        structs: (at least n, 9) words of the structs.
        records: (n, WORDS_PER_RECORD) words of the records, which get the frames of the first n
            structs.
        t_ns: time of reception, written into every record [ns].
        bus: index of the bus, written into every record.
        flag_mask: mask of the flags to copy from the structs.
        added_flags: flags to set in every record.
    """
    bits_of_all_ids = np.uint64(0)
    bus_bits = np.uint64(bus) << np.uint64(BUS_SHIFT)
    for i in range(records.shape[0]):
        header_word = structs[i, 0]
        can_id = header_word & np.uint64(ID_MASK)
        bits_of_all_ids |= can_id
        length = int(
            np.int64((header_word >> np.uint64(STRUCT_LENGTH_SHIFT)) & np.uint64(BYTE_MASK))
        )
        length = min(length, MAX_PAYLOAD_BYTES)
        flags = (header_word >> np.uint64(STRUCT_FLAGS_SHIFT)) & np.uint64(flag_mask)
        flags |= np.uint64(added_flags)
        records[i, TIME_WORD] = np.int64(t_ns)
        records[i, ID_AND_FLAGS_WORD] = (
            can_id
            | flags << np.uint64(FLAGS_SHIFT)
            | bus_bits
            | np.uint64(length) << np.uint64(LENGTH_SHIFT)
        )
        _copy_payload(structs, 1, records, FIRST_PAYLOAD_WORD, i, length)
    return bool(bits_of_all_ids & np.uint64(ERROR_FLAG))


@kernel("table_words", "words", "words")
def write_structs(records: WordRows, structs: WordRows, struct_sizes: WordRows) -> int:
    """Convert records to structs. The flags of a classical frame become 0.

    Return the index of the first record with a payload that is too long for the kind of its frame.
    If no payload is too long, return the number of records.

    Args:
        records: (n, WORDS_PER_RECORD) words of the records.
        structs: (at least n, 9) words of the structs, of which the first n are written.
        struct_sizes: (at least n, 1) number of bytes of each struct, of which the first n are written: the size
            of ``can_frame`` or of ``canfd_frame``.
    """
    count = len(records)
    for i in range(count):
        id_and_flags_word = records[i, ID_AND_FLAGS_WORD]
        flags = (id_and_flags_word >> np.uint64(FLAGS_SHIFT)) & np.uint64(FLAGS_MASK)
        length = int(np.int64(id_and_flags_word >> np.uint64(LENGTH_SHIFT)))
        if not flags & np.uint64(FDF):
            flags = np.uint64(0)
        if length > (MAX_PAYLOAD_BYTES if flags else MAX_CLASSICAL_PAYLOAD_BYTES):
            return i
        structs[i, 0] = (
            id_and_flags_word & np.uint64(ID_MASK)
            | np.uint64(length) << np.uint64(STRUCT_LENGTH_SHIFT)
            | (flags & np.uint64(BYTE_MASK)) << np.uint64(STRUCT_FLAGS_SHIFT)
        )
        _copy_payload(records, FIRST_PAYLOAD_WORD, structs, 1, i, length)
        struct_sizes[i, 0] = CANFD_FRAME_BYTES if flags else CLASSICAL_FRAME_BYTES
    return count


class FrameStructs:
    """An array of ``struct canfd_frame`` in memory.

    Attributes:
        count: number of structs.
    """

    def __init__(self, struct_memory: Any) -> None:
        """Use the writable buffer ``struct_memory``, which contains a whole number of structs."""
        self._rows = np.frombuffer(struct_memory, np.uint64).reshape(-1, CANFD_FRAME_BYTES // 8)
        self.count = len(self._rows)
        self._sizes = np.zeros((self.count, 1), np.uint64)

    def reserved_bits(self, struct_index: int) -> int:
        """Return the value in the 16 reserved bits of the struct with index ``struct_index``."""
        return int(self._rows[struct_index, 0]) >> STRUCT_RESERVED_BIT

    def read(
        self, count: int, t_ns: int, bus: int, flag_mask: int = ALL_FLAGS, added_flags: int = 0
    ) -> tuple[Frames, bool]:
        """Return the first ``count`` structs as frames.

        The second returned value is True if one of the returned frames is an error frame.

        Args:
            count: number of structs to read.
            t_ns: time of reception of all these frames [ns].
            bus: index of the bus, written into every record.
            flag_mask: mask of the flags to copy from the structs.
            added_flags: flags to set in every record.
        """
        rows = np.empty((count, WORDS_PER_RECORD), np.uint64)
        has_errors = read_structs(self._rows, rows, t_ns, bus, flag_mask, added_flags)
        return Frames(rows), has_errors

    def write(self, frames: Frames) -> NDArray[np.uint64]:
        """Write frames into the first structs.

        The payload of a frame can be shorter than the data field of a struct. The unused bytes of
        the data field are set to zero.

        Returns:
            (n,) number of bytes to send of each struct. This number is the size of ``can_frame`` or
            of ``canfd_frame``.

        Raises:
            ValueError: a payload is longer than its kind of frame can carry.
        """
        rows = frames.rows
        written_count = write_structs(rows, self._rows, self._sizes)
        if written_count < len(rows):
            refused_records = frames.records[written_count]
            check_payload_size(
                Frame(
                    int(refused_records["can_id"]),
                    bytes(int(refused_records["length"])),
                    int(refused_records["flags"]),
                )
            )
        return self._sizes[:written_count, 0]


def data_and_error_frames(frames: Frames) -> tuple[Frames, list[Frame]]:
    """Divide frames into data frames and error frames."""
    is_error = (frames.records["can_id"] & ERROR_FLAG) != 0
    return Frames(frames.rows[~is_error]), list(Frames(frames.rows[is_error]))
