"""Logs: any bytes, and records that are whole outside and wrong inside, with checksums that agree."""

import contextlib
import struct
from collections.abc import Callable
from pathlib import Path

from fuzz import files
from fuzz.mutate import Source
from handctl.controller.types import TELEMETRY_FIELDS
from handctl.errors import LogError
from handctl.log.logfile import LogFile
from handctl.log.reader import RunLog
from handctl.log.recover import recover
from handctl.log.scan import Scan, scan
from tests.log import synthetic

Target = Callable[[bytes], bool]
EDITS = 4
ODD = (b"\0", b"\xff", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0" * 8, b"\x7f", b"\x80", b"[", b"\0\0\0\x01")


def read_all(path: Path) -> None:
    """Everything that a verb may ask of a log."""
    with RunLog(path) as log:
        for name in TELEMETRY_FIELDS:
            log.field(name)
        len(log), list(log.ticks()), log.events, log.phases, log.gaps, log.clock_pairs
        list(log.digests()), list(log.messages()), list(log.packed())


def small(folder: Path) -> Path:
    """A whole log of a few ticks."""
    path = folder / "small.mcap"
    synthetic.write(path, synthetic.header(rate_hz=10), 1.0)
    return path


def _read(path: Path) -> bool:
    try:
        read_all(path)
    except LogError as error:
        files.one_line(error)
        return False
    return True


def log(folder: Path) -> Target:
    """Chunks and metadata changed inside; no checksum stands in the way."""
    original = small(folder)
    file, found = LogFile(original), Scan()
    scan(file, found)
    raw = original.read_bytes()
    chunks = [(place, bytes(file.content(place))) for place in found.chunks]
    file.close()
    head = raw[: chunks[0][0].offset]
    path = folder / "log.mcap"

    def target(data: bytes) -> bool:
        source, parts = Source(data), [bytearray(head), *(bytearray(content) for _, content in chunks)]
        for _ in range(EDITS):
            if not source.empty:
                _edit(parts[source.number(len(parts))], source)
        places = (place for place, _ in chunks)
        packed = (_chunk(place.first, place.last, bytes(part)) for place, part in zip(places, parts[1:], strict=True))
        path.write_bytes(parts[0] + b"".join(packed) + raw[chunks[-1][0].end :])
        return _read(path)

    return target


def _edit(part: bytearray, source: Source) -> None:
    at = source.number(1 << 16) % max(1, len(part))
    new = ODD[source.number(len(ODD))] if source.number(2) else source.take(1 + source.number(8))
    kind = source.number(8)
    end = at if kind == 0 else at + source.number(64) if kind == 1 else at + len(new)
    part[at:end] = b"" if kind == 1 else new


def _chunk(first: int, last: int, content: bytes) -> bytes:
    body = struct.pack("<QQQII", first, last, len(content), 0, 0) + struct.pack("<Q", len(content)) + content
    return struct.pack("<BQ", 6, len(body)) + body


def log_bytes(folder: Path) -> Target:
    """Any bytes as a log, to the reader and to the recovery."""
    path, out = folder / "bytes.mcap", folder / "out.mcap"

    def target(data: bytes) -> bool:
        path.write_bytes(data)
        out.unlink(missing_ok=True)
        with contextlib.suppress(LogError):
            recover(path, out)
        return _read(path)

    return target
