"""Log files that an attacker could make.

Examples are decompression bombs, wrong record lengths, and a million records of one kind.
"""

import struct
import zlib
from pathlib import Path

import lz4.frame
import zstandard

from handctl.log.mcap_container import MCAP_MAGIC
from handctl.log.read.logfile import MAX_CHUNK_BYTES, LogFile
from handctl.log.read.record_scan import RecordScan, scan_records


def _chunk_record(
    compression: str, packed_bytes: bytes, uncompressed_size: int, crc: int = 0
) -> bytes:
    name = compression.encode()
    body = (
        struct.pack("<QQQII", 0, 0, uncompressed_size, crc, len(name))
        + name
        + struct.pack("<Q", len(packed_bytes))
        + packed_bytes
    )
    return struct.pack("<BQ", 6, len(body)) + body


def _log_with_chunks(small_log: Path, chunks: bytes) -> bytes:
    """Return the bytes of a log that begins like a real log, and continues with the given MCAP chunks."""
    file, scan = LogFile(small_log), RecordScan()
    scan_records(file, scan)
    file.close()
    return small_log.read_bytes()[: scan.chunks[1].end] + chunks


def _zstd_compressed_zero_bytes(size: int) -> bytes:
    compressor = zstandard.ZstdCompressor(level=1).compressobj()
    zero_bytes = bytes(1 << 20)
    return b"".join(compressor.compress(zero_bytes) for _ in range(size >> 20)) + compressor.flush()


def hostile_files(small_log: Path) -> dict[str, bytes]:
    """Return the name and the bytes of each hostile file.

    Most hostile files begin like a real log.
    """
    message = struct.pack("<BQHIQQ", 5, 22, 3, 0, 0, 0)
    message_of_other_channel = struct.pack("<BQHIQQ", 5, 22, 4, 0, 0, 0)
    many_messages = (message + message_of_other_channel) * (MAX_CHUNK_BYTES // 62)
    zero_bytes = bytes(MAX_CHUNK_BYTES)
    channels = b"".join(
        struct.pack("<BQHHIIIB", 4, 17, n & 0xFFFF, 0, 0, 0, 1, 0) for n in range(1_000_000)
    )
    tick = (
        struct.pack("<BQHIQQ", 5, 22 + 44, 3, 0, 0, 0)
        + b"\0\1\0\0"
        + bytes(36)
        + b"\xff\xff\xff\x7f"
    )
    decompression_bomb = _chunk_record(
        "zstd", zstandard.compress(zero_bytes), len(zero_bytes), zlib.crc32(zero_bytes)
    )
    text = struct.pack("<I", 2**32 - 1)
    return {
        "zstd of a gigabyte": _log_with_chunks(
            small_log, _chunk_record("zstd", _zstd_compressed_zero_bytes(1 << 30), 1 << 20)
        ),
        "zstd that says how large it is": _log_with_chunks(
            small_log, _chunk_record("zstd", _zstd_compressed_zero_bytes(1 << 30), 1 << 30)
        ),
        "lz4 of more than it says": _log_with_chunks(
            small_log, _chunk_record("lz4", lz4.frame.compress(zero_bytes), 1000)
        ),
        "lz4 of less than it says": _log_with_chunks(
            small_log, _chunk_record("lz4", lz4.frame.compress(b"x"), 1000)
        ),
        "many bombs": _log_with_chunks(small_log, decompression_bomb * 300),
        "zeros as records": _log_with_chunks(
            small_log, _chunk_record("lz4", lz4.frame.compress(zero_bytes), len(zero_bytes))
        ),
        "a million messages": _log_with_chunks(
            small_log, _chunk_record("lz4", lz4.frame.compress(many_messages), len(many_messages))
        ),
        "a million channels": _log_with_chunks(
            small_log, _chunk_record("lz4", lz4.frame.compress(channels), len(channels))
        ),
        "a tick that lies": _log_with_chunks(small_log, _chunk_record("", tick, len(tick))),
        "a chunk larger than the file": _log_with_chunks(small_log, struct.pack("<BQ", 6, 2**63))
        + bytes(100)
        + MCAP_MAGIC,
        "a huge attachment": _log_with_chunks(
            small_log, struct.pack("<BQ", 9, 17 << 20) + bytes(17 << 20)
        ),
        "metadata that lies": _log_with_chunks(small_log, struct.pack("<BQ", 12, 20) + text * 5),
        "a million empty records": _log_with_chunks(
            small_log, struct.pack("<BQ", 0x90, 0) * 1_000_000
        ),
        "an unknown compression": _log_with_chunks(small_log, _chunk_record("lzma", b"x", 1)),
        "not a log": b"PK\x03\x04" * 100,
        "nothing": b"",
    }
