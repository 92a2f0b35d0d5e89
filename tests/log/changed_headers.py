"""Write copies of logs with a changed header.

The functions replace metadata records of a log, and leave all other records unchanged.
"""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

from mcap.opcode import Opcode

from handctl.log.mcap_container import MCAP_MAGIC

MetadataEntries = dict[str, str]
_RECORD_HEAD_STRUCT = struct.Struct("<BQ")


def log_with_changed_metadata(
    log_bytes: bytes, change_metadata: Callable[[str, MetadataEntries], MetadataEntries]
) -> bytes:
    """Return the bytes of a log whose metadata were changed.

    The returned bytes contain no checksums over the whole file.

    Args:
        log_bytes: bytes of a complete log.
        change_metadata: function that takes the name and the entries of a metadata record, and returns the
            new entries.
    """
    file_parts = [MCAP_MAGIC]
    for code, body in _split_records(log_bytes):
        if code == Opcode.METADATA:
            name, entries = _parsed_metadata(body)
            body = _packed_metadata(name, change_metadata(name, entries))
        elif code in (Opcode.DATA_END, Opcode.FOOTER):
            body = body[:-4] + bytes(4)
        file_parts.append(_RECORD_HEAD_STRUCT.pack(code, len(body)) + body)
    return b"".join([*file_parts, MCAP_MAGIC])


def write_log_with_run_metadata(log_path: Path, out: Path, **json_by_key: str) -> Path:
    """Write a copy of a log to `out`, and replace JSON texts in the metadata record `handctl.run` of the copy.

    Return the path of the copied log.
    """
    out.write_bytes(
        log_with_changed_metadata(
            log_path.read_bytes(),
            lambda name, old_metadata: (
                old_metadata | json_by_key if name == "handctl.run" else old_metadata
            ),
        )
    )
    return out


def _split_records(log_bytes: bytes) -> Iterator[tuple[int, bytes]]:
    at = len(MCAP_MAGIC)
    while at < len(log_bytes) - len(MCAP_MAGIC):
        code, size = _RECORD_HEAD_STRUCT.unpack_from(log_bytes, at)
        at += _RECORD_HEAD_STRUCT.size
        yield code, log_bytes[at : at + size]
        at += size


def _packed_text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _read_text(record_body: bytes, offset: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", record_body, offset)
    return record_body[offset + 4 : offset + 4 + size].decode(), offset + 4 + size


def _parsed_metadata(body: bytes) -> tuple[str, MetadataEntries]:
    name, at = _read_text(body, 0)
    at, entries = at + 4, {}
    while at < len(body):
        key, at = _read_text(body, at)
        entries[key], at = _read_text(body, at)
    return name, entries


def _packed_metadata(metadata_name: str, entries: MetadataEntries) -> bytes:
    inner = b"".join(_packed_text(key) + _packed_text(value) for key, value in entries.items())
    return _packed_text(metadata_name) + struct.pack("<I", len(inner)) + inner
