"""Division of a log into small logs by time. The first can be shown before the last is read."""

from collections.abc import Iterator
from pathlib import Path

from handctl.log.read.logfile import ChunkPlace, LogFile
from handctl.log.read.scan import Scan

SPAN_NS = 20_000_000_000
"""Length of the run per part [ns]. Parts of this length have few chunks, and memory stays bounded."""


def windows(path: Path, found: Scan, folder: Path, first_ns: int) -> Iterator[tuple[Path, int]]:
    """Yield parts of a complete log in the order of time.

    Each part is a log that exists until the next is requested.

    Args:
        path: a log with an end.
        found: outer records of the log.
        folder: folder for the parts.
        first_ns: length of the run in the first part [ns].

    Yields:
        The part, and its first new log time [ns]. The definitions of topics at the start of every part are older.

    Raises:
        LogError: the log is damaged.
    """
    file = LogFile(path)
    try:
        head = found.chunks[0]
        rest = found.chunks[1:]
        begins = [place.offset for place in rest] + [found.end]
        part = folder / "part.mcap"
        for group in _groups(head.first, rest, first_ns) or [[]]:
            first = rest.index(group[0]) if group else 0
            for place in group:
                file.content(place)  # its checksum: Rerun would show what is damaged
            # Every part begins with the head of the file and the first chunk: the definitions of all
            # topics.
            with part.open("wb") as out:
                out.write(file.read(0, begins[0]))
                if group:
                    out.write(file.read(begins[first], begins[first + len(group)] - begins[first]))
            yield part, min((place.first for place in group), default=head.first) if first else head.first
    finally:
        file.close()


def _groups(start_ns: int, chunks: list[ChunkPlace], first_ns: int) -> list[list[ChunkPlace]]:
    """Group chunks by the part in which they begin."""
    groups: dict[int, list[ChunkPlace]] = {}
    for place in chunks:
        groups.setdefault(max(-1, (place.first - start_ns - first_ns) // SPAN_NS), []).append(place)
    return list(groups.values())
