"""Fuzzing targets for logs.

An input is either arbitrary bytes, or a log in which some records are changed. In the changed log,
all checksums are zero, so the records count as records without a checksum.
"""

import contextlib
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

from mcap.opcode import Opcode

from fuzz import file_targets
from fuzz.document_mutation import ByteSource
from handctl.core.tick_types import TELEMETRY_FIELDS
from handctl.errors import LogError
from handctl.log.read.chunk_reader import schemas_and_channels
from handctl.log.read.logfile import LogFile
from handctl.log.read.reader import RunLog
from handctl.log.read.record_scan import RecordScan, scan_records
from handctl.log.read.recover import recover_log
from handctl.log.topics.clock_pair_topic import CLOCK_PAIRS_TOPIC as CLOCK_TOPIC
from handctl.log.topics.hash_chain import HASH_CHAIN_TOPIC as HASH_CHAIN_TOPIC
from handctl.log.topics.topic_set import TICK_TOPIC, VALUES_TOPIC
from tests.log import synthetic_run

FuzzTarget = Callable[[bytes], bool]
MAX_EDITS = 4
FUZZED_TOPICS = (TICK_TOPIC, VALUES_TOPIC, HASH_CHAIN_TOPIC, CLOCK_TOPIC, "/rosout")
"""Topics that stay in the fuzzed log. The log reader skips the topic /rosout and decodes the other topics."""
PER_TOPIC_RECORDS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE_INDEX)
"""Kinds of records that a log has after its chunks, one record for each topic."""
MCAP_MAGIC = b"\x89MCAP0\r\n"
NUMERIC_FIELD_BYTES = 48
"""Length of the numeric fields at the start of a record [bytes].

Half of the changes of records are made in their numeric fields.
"""
UNUSUAL_BYTES = (
    b"\0",
    b"\xff",
    b"\xff\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\0" * 8,
    b"\x7f",
    b"\x80",
    b"[",
    b"\0\0\0\x01",
)


def read_whole_log(log_path: Path) -> None:
    """Read every part of a log that any command of handctl reads."""
    with RunLog(log_path) as log:
        log.field(TELEMETRY_FIELDS[0]), log.field(TELEMETRY_FIELDS[-1])
        len(log), list(log.ticks()), log.events, log.phases, log.gaps, log.clock_pairs
        list(log.tick_digests()), list(log.tick_messages()), list(log.packed_telemetry())


def write_small_log(log_folder: Path, duration_s: float = 0.3) -> Path:
    """Write a small but complete log with a few ticks."""
    path = log_folder / "small.mcap"
    synthetic_run.write_synthetic_run(
        path, synthetic_run.synthetic_header(rate_hz=10, attachments={}), duration_s
    )
    return path


def _is_readable(path: Path) -> bool:
    try:
        read_whole_log(path)
    except LogError as error:
        file_targets.check_single_line_message(error)
        return False
    return True


def log_fuzz_target(folder: Path) -> FuzzTarget:
    """Return the fuzzing target that reads a log. The fuzzer changes records inside and outside of chunks.

    Most of the changed records have a valid length.
    """
    log_parts = _split_log(write_small_log(folder))
    joined_parts = [
        _join_records(i, records_of_part) for i, records_of_part in enumerate(log_parts)
    ]
    path = folder / "log.mcap"

    def target(data: bytes) -> bool:
        source = ByteSource(data)
        changed_records = dict[int, list[bytes]]()
        for _ in range(MAX_EDITS):
            if source.is_empty:
                break
            i = source.take_number(len(log_parts))
            records = changed_records.setdefault(i, log_parts[i].copy())
            record_index = source.take_number(len(records))
            records[record_index] = _mutated_record(records[record_index], source)
        path.write_bytes(
            b"".join(
                [
                    _join_records(i, changed_records[i])
                    if i in changed_records
                    else joined_parts[i]
                    for i in range(len(log_parts))
                ]
            )
        )
        return _is_readable(path)

    return target


def _split_log(path: Path) -> list[list[bytes]]:
    """Split a log into lists of records: those before the chunks, those in each chunk, and those after the chunks.

    Set the checksums in the records to zero.
    """
    file = LogFile(path)
    result = RecordScan()
    scan_records(file, result)
    raw_bytes = path.read_bytes()
    chunk_contents = [bytes(file.chunk_content(chunk_location)) for chunk_location in result.chunks]
    file.close()
    channels = schemas_and_channels(chunk_contents[0]).channels
    schemas = {number: schema for number, schema, topic, _, _ in channels if topic in FUZZED_TOPICS}
    chunks = [
        [record for record in _split_records(content) if _is_of_kept_channel(record, schemas)]
        for content in chunk_contents
    ]
    first_records = list(_split_records(raw_bytes[8 : result.chunks[0].offset]))
    tail_records = list(_split_records(raw_bytes[result.chunks[-1].end : -8]))
    kept_tail_records = [
        record
        for record in tail_records
        if record[0] not in PER_TOPIC_RECORDS or _is_of_kept_channel(record, schemas)
    ]
    return [
        [_without_checksum(record) for record in first_records],
        *chunks,
        [_without_checksum(record) for record in kept_tail_records],
    ]


def _split_records(data: bytes) -> Iterator[bytes]:
    offset = 0
    while offset < len(data):
        end = offset + 9 + struct.unpack_from("<Q", data, offset + 1)[0]
        yield data[offset:end]
        offset = end


def _is_of_kept_channel(record: bytes, kept_channels: dict[int, int]) -> bool:
    """Return True if a record belongs to a channel in ``kept_channels``, or is the schema of such a channel."""
    (number,) = struct.unpack_from("<H", record, 9)
    return number in (kept_channels.values() if record[0] == Opcode.SCHEMA else kept_channels)


CHECKED_OPCODES = (Opcode.ATTACHMENT, Opcode.DATA_END, Opcode.FOOTER)
"""Kinds of records that end with a checksum.

A record with the checksum zero counts as a record without a checksum.
"""


def _without_checksum(record: bytes) -> bytes:
    return record[:-4] + bytes(4) if record[0] in CHECKED_OPCODES else record


def _join_records(part_index: int, records: list[bytes]) -> bytes:
    """Join the records of one part of a log.

    A part of a log is the head with its magic bytes, an uncompressed chunk, or the records after
    the last chunk.
    """
    content = b"".join(records)
    if part_index == 0:
        return MCAP_MAGIC + content
    return (
        content + MCAP_MAGIC
        if records[-1][:1] == bytes([Opcode.FOOTER])
        else _chunk_record(content)
    )


def _mutated_record(record: bytes, source: ByteSource) -> bytes:
    """Return a record with changed content. One in eight of the changed records gets a wrong length."""
    body = bytearray(record[9:])
    kind = source.take_number(8)
    if kind == 0:
        body = bytearray(record)
    start = source.take_number(1 << 16) % max(
        1, len(body) if source.take_number(2) else min(len(body), NUMERIC_FIELD_BYTES)
    )
    new_record = (
        UNUSUAL_BYTES[source.take_number(len(UNUSUAL_BYTES))]
        if source.take_number(2)
        else source.take_bytes(1 + source.take_number(8))
    )
    end = (
        start
        if kind == 1
        else start + source.take_number(64)
        if kind == 2
        else start + len(new_record)
    )
    body[start:end] = b"" if kind == 2 else new_record
    return bytes(body) if kind == 0 else struct.pack("<BQ", record[0], len(body)) + body


def _chunk_record(content: bytes) -> bytes:
    body = (
        struct.pack("<QQQII", 0, 1 << 40, len(content), 0, 0)
        + struct.pack("<Q", len(content))
        + content
    )
    return struct.pack("<BQ", Opcode.CHUNK, len(body)) + body


def log_bytes_fuzz_target(folder: Path) -> FuzzTarget:
    """Return the fuzzing target that reads arbitrary bytes as a log.

    The fuzzing target passes its input to the log reader, and to the recovery of incomplete logs.
    """
    path = folder / "bytes.mcap"
    output_path = folder / "out.mcap"

    def target(data: bytes) -> bool:
        path.write_bytes(data)
        output_path.unlink(missing_ok=True)
        with contextlib.suppress(LogError):
            recover_log(path, output_path)
        return _is_readable(path)

    return target
