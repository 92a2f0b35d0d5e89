"""Write logs with a changed header. Metadata records are replaced, all other records are unchanged."""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

from mcap.opcode import Opcode

from handctl.log.container import MCAP_MAGIC

Record = dict[str, str]
_FRAME = struct.Struct("<BQ")


def with_metadata(raw: bytes, change: Callable[[str, Record], Record]) -> bytes:
    """Return the bytes of a log with changed metadata, without the checksums of the whole file.

    Args:
        raw: bytes of a complete log.
        change: function that takes the name and the entries of a metadata record and returns the new entries.
    """
    parts = [MCAP_MAGIC]
    for code, body in _records(raw):
        if code == Opcode.METADATA:
            name, entries = _parsed(body)
            body = _packed(name, change(name, entries))
        elif code in (Opcode.DATA_END, Opcode.FOOTER):
            body = body[:-4] + bytes(4)
        parts.append(_FRAME.pack(code, len(body)) + body)
    return b"".join([*parts, MCAP_MAGIC])


def with_run(path: Path, out: Path, **values: str) -> Path:
    """Write a copy of a log to `out` with other JSON texts in its record `handctl.run`, and return the path."""
    out.write_bytes(
        with_metadata(
            path.read_bytes(), lambda name, old: old | values if name == "handctl.run" else old
        )
    )
    return out


def _records(raw: bytes) -> Iterator[tuple[int, bytes]]:
    at = len(MCAP_MAGIC)
    while at < len(raw) - len(MCAP_MAGIC):
        code, size = _FRAME.unpack_from(raw, at)
        at += _FRAME.size
        yield code, raw[at : at + size]
        at += size


def _text(value: str) -> bytes:
    data = value.encode()
    return struct.pack("<I", len(data)) + data


def _taken(body: bytes, at: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", body, at)
    return body[at + 4 : at + 4 + size].decode(), at + 4 + size


def _parsed(body: bytes) -> tuple[str, Record]:
    name, at = _taken(body, 0)
    at, entries = at + 4, {}
    while at < len(body):
        key, at = _taken(body, at)
        entries[key], at = _taken(body, at)
    return name, entries


def _packed(name: str, entries: Record) -> bytes:
    inner = b"".join(_text(key) + _text(value) for key, value in entries.items())
    return _text(name) + struct.pack("<I", len(inner)) + inner
