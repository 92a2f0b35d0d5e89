"""Encoding of ticks and snapshots as records for the pipe to the recorder, see `tick_record`."""

import struct
from typing import Any

import numpy as np

from handctl.compiled import kernel, kernel_helper
from handctl.core.tick_types import (
    TickEvent,
    TickIn,
    TickOut,
)
from handctl.drives.frame_records import (
    CLASSICAL_RECORD_BYTES,
    ID_AND_FLAGS_WORD,
    LENGTH_SHIFT,
    Frames,
    RecordArray,
    WordRows,
    frames_as_records,
)
from handctl.log.cdr import ENCAPSULATION_HEADER, CdrWriter
from handctl.log.tick_record import (
    COUNT_STRUCT,
    NO_LONG_DATA,
    RECORD_FRAMING_STRUCT,
    SHORT_DATA_BYTES,
    SNAPSHOT_HEAD_STRUCT,
    SNAPSHOT_RECORD_KIND,
    TICK_HEAD_STRUCT,
    TICK_RECORD_KIND,
    TICK_SIZES_STRUCT,
    eventless_message_tail,
    long_data_mask,
)
from handctl.programs.requests import request_text

FRAME_WORDS = CLASSICAL_RECORD_BYTES // 8
"""Number of words of eight bytes of a frame in a Tick message."""
_RECORD_HEAD_STRUCT = struct.Struct(
    RECORD_FRAMING_STRUCT.format
    + TICK_SIZES_STRUCT.format.lstrip("<")
    + f"{len(ENCAPSULATION_HEADER)}s"
    + TICK_HEAD_STRUCT.format.lstrip("<")
)
"""Layout of everything before the received frames in the record of a tick."""
_SIZE_BEFORE_FRAMES = len(ENCAPSULATION_HEADER) + TICK_HEAD_STRUCT.size
"""Size of a Tick message before the received frames [bytes]."""


@kernel("words", "words", "words")
def gather_frame_words(received_rows: WordRows, sent_rows: WordRows, words: WordRows) -> int:
    """Copy the words of all frames of a tick, in the order of a Tick message.

    Args:
        received_rows: (n, WORDS_PER_RECORD) records of the received frames.
        sent_rows: (m, WORDS_PER_RECORD) records of the sent frames.
        words: (1, 3 n + 1 + 3 m) result: the words of the received frames, the number of sent
            frames, and the words of the sent frames.

    Returns:
        Length of the longest payload [bytes].
    """
    received_end = FRAME_WORDS * len(received_rows)
    words[0, received_end] = len(sent_rows)
    return max(
        _copy_frame_words(received_rows, words, 0),
        _copy_frame_words(sent_rows, words, received_end + 1),
    )


@kernel_helper
def _copy_frame_words(rows: WordRows, words: WordRows, first_word: int) -> int:
    """Copy the words of frames to a position in ``words``, and return the length of the longest payload [bytes]."""
    longest: Any = 0
    for r in range(len(rows)):
        for word in range(FRAME_WORDS):
            words[0, first_word + FRAME_WORDS * r + word] = rows[r, word]
        longest = max(longest, np.int64(rows[r, ID_AND_FLAGS_WORD]) >> LENGTH_SHIFT)
    return int(longest)


def pack_tick_record(tick_input: TickIn, tick_output: TickOut) -> bytes:
    """Encode a tick as a record for the pipe, with the telemetry after the Tick message.

    Raises:
        ValueError: state_hash is not 8 bytes long.
        struct.error: a number does not fit into its field.
    """
    received_rows = frames_as_records(tick_input.frames).rows
    sent_rows = frames_as_records(tick_output.frames).rows
    state_hash = tick_output.state_hash
    if len(state_hash) != 8:
        raise ValueError(f"state hash of {len(state_hash)} bytes; expected 8")
    received_count, sent_count = len(received_rows), len(sent_rows)
    frame_words = np.empty((1, FRAME_WORDS * (received_count + sent_count) + 1), np.uint64)
    longest_payload = gather_frame_words(received_rows, sent_rows, frame_words)
    # The first field of a frame is an int64. Therefore CDR aligns the frames to 8 bytes, and the
    # number of sent frames takes a whole word. Without sent frames, the number takes 4 bytes.
    frames: Any = frame_words
    frame_bytes = frame_words.nbytes
    if not sent_count:
        frame_bytes -= 4
        frames = frame_words.data.cast("B")[:frame_bytes]
    long_data = NO_LONG_DATA
    if longest_payload > SHORT_DATA_BYTES:
        long_data = _long_payloads(received_rows, sent_rows)
    message_size = _SIZE_BEFORE_FRAMES + frame_bytes + len(long_data)
    if tick_input.io_events or tick_input.requests or tick_output.events:
        # The alignment of the texts does not count the encapsulation header.
        start_offset = message_size - len(ENCAPSULATION_HEADER)
        tail = _message_end(start_offset, tick_output.phase, tick_input, tick_output.events)
    else:
        tail = eventless_message_tail(tick_output.phase)
    message_size += len(tail)
    telemetry = tick_output.telemetry
    values = telemetry.buffer
    record_head = _RECORD_HEAD_STRUCT.pack(
        TICK_SIZES_STRUCT.size + message_size + values.nbytes,
        TICK_RECORD_KIND,
        message_size,
        *telemetry.axis_lengths,
        ENCAPSULATION_HEADER,
        tick_input.k,
        tick_input.t_ns,
        tick_input.late_ns,
        state_hash,
        tick_output.mode,
        tick_output.action,
        received_count,
    )
    return b"".join((record_head, frames, long_data, tail, values))


def pack_tick(tick_input: TickIn, tick_output: TickOut) -> bytes:
    """Encode a tick as a handctl_msgs/Tick message.

    This function raises the same errors as `pack_tick_record`.
    """
    record = pack_tick_record(tick_input, tick_output)
    message_size, *_ = TICK_SIZES_STRUCT.unpack_from(record, RECORD_FRAMING_STRUCT.size)
    start = RECORD_FRAMING_STRUCT.size + TICK_SIZES_STRUCT.size
    return record[start : start + message_size]


def _message_end(
    start_offset: int, phase: str, tick_input: TickIn, events: tuple[TickEvent, ...]
) -> bytes:
    """Return the end of a Tick message: phase, io events, requests and events.

    Args:
        start_offset: offset at which the end begins in the body of the message [bytes]. The
            alignment of the fields depends on this offset.
        phase: grasp phase in the tick.
        tick_input: inputs of the tick.
        events: events of the tick.
    """
    writer = CdrWriter(start_offset)
    writer.put_string(phase)
    writer.put_length(len(tick_input.io_events))
    for kind, location, number in tick_input.io_events:
        writer.put_string(kind)
        writer.put_string(location)
        writer.put_number("q", number)
    writer.put_strings(tuple(map(request_text, tick_input.requests)))
    writer.put_length(len(events))
    for event in events:
        for text in event:
            writer.put_string(text)
    return bytes(writer.data)


def _long_payloads(received_rows: WordRows, sent_rows: WordRows) -> bytes:
    """Encode the payload bytes after the eighth byte of all frames: number of bytes, bytes, padding to 4 bytes."""
    long_data = b"".join([_long_data(Frames(rows).records) for rows in (received_rows, sent_rows)])
    return COUNT_STRUCT.pack(len(long_data)) + long_data + bytes(-len(long_data) % 4)


def _long_data(records: RecordArray) -> bytes:
    """Return the payload bytes after the eighth byte of all frames, in order."""
    return bytes(records["data"][:, SHORT_DATA_BYTES:][long_data_mask(records)].tobytes())


def record_bytes(kind: int, body: bytes) -> bytes:
    """Return a record of the given kind."""
    return RECORD_FRAMING_STRUCT.pack(len(body), kind) + body


def pack_snapshot(tick_input: TickIn, numbers: bytes, decisions: bytes) -> bytes:
    """Encode the controller's state after a tick as a record for the pipe.

    Args:
        tick_input: input of the tick.
        numbers: beginning of the snapshot.
        decisions: serialized decisions of the controller. The recorder converts these bytes to the
            rest of the snapshot (see `controller.state_snapshot.snapshot_parts`).
    """
    head = SNAPSHOT_HEAD_STRUCT.pack(tick_input.k, tick_input.t_ns, len(numbers))
    return record_bytes(SNAPSHOT_RECORD_KIND, head + numbers + decisions)
