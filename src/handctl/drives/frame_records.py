"""CAN frames as rows of bytes.

Buses exchange CAN frames as rows of bytes, compiled code reads and writes the rows, and the log
stores the rows.

    word 0      t_ns int64
    word 1      bits 0..31 can_id | 32..47 flags | 48..55 bus | 56..63 length
    word 2..9   data, 64 bytes

Each row is a record of ten words of 8 bytes. All fields are little-endian. Code that handles single
frames uses ``Frame`` objects instead of rows. Examples of such code are python-can interfaces,
tests, tools, and the state machines of drives. ``Frames`` is a sequence over the rows that returns
``Frame`` objects.
"""

import struct
from collections.abc import Iterable, Iterator, Sequence
from typing import overload

import numpy as np
from numpy.typing import NDArray

from handctl.drives.frame import Frame, make_tuple

FRAME_RECORD_DTYPE = np.dtype(
    [
        ("t_ns", "<i8"),
        ("can_id", "<u4"),
        ("flags", "<u2"),
        ("bus", "u1"),
        ("length", "u1"),
        ("data", "u1", (64,)),
    ]
)
"""Type of the record of a frame: reception time [ns], identifier with flag bits, flags, bus, length, payload."""
_RECORD_STRUCT = struct.Struct("<qIHBB64s")
"""Layout of one record.

``struct`` reads or writes a single record several times as fast as an array does.
"""
FRAME_RECORD_BYTES = FRAME_RECORD_DTYPE.itemsize
"""Size of the record of a frame [bytes]."""
CLASSICAL_RECORD_BYTES = 24
"""Length of a record up to the eighth byte of the payload [bytes]."""
RecordArray = NDArray[np.void]
WordRows = NDArray[np.uint64]
_WORD_DTYPE = np.dtype(np.uint64)
WORDS_PER_RECORD = FRAME_RECORD_BYTES // 8
"""Size of the record of a frame, in words of eight bytes."""
# Indices of the words in the record of a frame. TIME_WORD is the reception time. ID_AND_FLAGS_WORD
# contains identifier, flags, bus and length, from the lowest bit on. FIRST_PAYLOAD_WORD is the
# first word of the payload.
TIME_WORD = 0
ID_AND_FLAGS_WORD = 1
FIRST_PAYLOAD_WORD = 2
# Lowest bits of the fields flags, bus and length in the word ID_AND_FLAGS_WORD.
FLAGS_SHIFT = 32
BUS_SHIFT = 48
LENGTH_SHIFT = 56
ID_MASK = 0xFFFFFFFF
"""Mask of the identifier with its flag bits in the word ID_AND_FLAGS_WORD."""
BYTE_MASK = 0xFF
"""Mask of the lowest byte of a shifted word, for example of the bus and of the length."""


class Frames(Sequence[Frame]):
    """Sequence of frames stored as records.

    A ``Frames`` sequence is equal to any other sequence that contains equal frames.

    Attributes:
        rows: (n, ``WORDS_PER_RECORD``) records as words of eight bytes, contiguous, for compiled
            code.
    """

    __slots__ = ("rows",)

    def __init__(self, rows: WordRows) -> None:
        """Store a reference to the words of the records, without copying them."""
        self.rows = rows

    @staticmethod
    def from_records(records: RecordArray) -> "Frames":
        """Return the frames stored in contiguous records (n,) of type ``FRAME_RECORD_DTYPE``."""
        return Frames(np.ndarray((len(records), WORDS_PER_RECORD), _WORD_DTYPE, records))

    @property
    def records(self) -> RecordArray:
        """Return the records as an array (n,) of type ``FRAME_RECORD_DTYPE``."""
        # The constructor ``np.ndarray`` takes a quarter of the time of ``view``, which checks the
        # fields of the record.
        return np.ndarray(len(self.rows), FRAME_RECORD_DTYPE, self.rows)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.rows)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> "Frames": ...
    def __getitem__(self, index: int | slice) -> "Frame | Frames":
        """Return one frame as ``Frame``, or the frames of a slice as ``Frames``."""
        if isinstance(index, slice):
            return Frames(np.ascontiguousarray(self.rows[index]))
        t_ns, can_id, flags, bus, length, data = _RECORD_STRUCT.unpack(self.rows[index])
        return make_tuple(Frame, (can_id, data[:length], flags, bus, t_ns))

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames as ``Frame`` objects."""
        for t_ns, can_id, flags, bus, length, data in _RECORD_STRUCT.iter_unpack(self.rows.data):
            yield make_tuple(Frame, (can_id, data[:length], flags, bus, t_ns))

    def __eq__(self, other: object) -> bool:
        """Return True if the other sequence has equal frames."""
        if isinstance(other, Frames):
            return bool(np.array_equal(self.rows, other.rows))
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        """Return the hash of the record bytes."""
        return hash(self.rows.tobytes())

    def __repr__(self) -> str:
        """Return the frames as text, for messages."""
        return f"Frames({list(self)!r})"


NO_FRAMES = Frames(np.empty((0, WORDS_PER_RECORD), np.uint64))
"""Sequence without frames."""


def frames_as_records(frames: Iterable[Frame]) -> Frames:
    """Convert any sequence of frames to ``Frames``, which stores the frames as records.

    Raises:
        ValueError: a payload has more than 64 bytes.
    """
    if isinstance(frames, Frames):
        return frames
    frame_list = list(frames)
    if not frame_list:
        return NO_FRAMES
    records = bytearray()
    for can_id, payload, flags, bus, t_ns in frame_list:
        if len(payload) > 64:
            raise ValueError(
                f"payload of {len(payload)} bytes in frame {can_id:#x}, expected at most 64"
            )
        records += _RECORD_STRUCT.pack(t_ns, can_id, flags, bus, len(payload), payload)
    return Frames(np.ndarray((len(frame_list), WORDS_PER_RECORD), _WORD_DTYPE, records))


def concatenate_frames(frame_batches: Sequence[Frames]) -> Frames:
    """Join several sequences of frames to one sequence."""
    if len(frame_batches) == 1:
        return frame_batches[0]
    nonempty_batches = [batch for batch in frame_batches if len(batch)]
    if len(nonempty_batches) < 2:
        return nonempty_batches[0] if nonempty_batches else NO_FRAMES
    # The rows are joined as 8-byte words, because numpy takes six times as long to join records.
    return Frames(np.concatenate([batch.rows for batch in nonempty_batches]))
