"""A log cut into small logs by time, so that the first of it can be shown before the last has been read."""

from collections.abc import Iterator
from pathlib import Path

from handctl.log.read.logfile import ChunkPlace, LogFile
from handctl.log.read.scan import Scan

SPAN_NS = 20_000_000_000
"""So much of a run is joined before it is sent on: few chunks, and memory that does not grow."""


def windows(path: Path, found: Scan, folder: Path, first_ns: int) -> Iterator[tuple[Path, int]]:
    """Parts of a whole log in the order of time, each a log of its own that holds until the next is asked for.

    Args:
        path: a log with an end.
        found: what it holds.
        folder: where to write them.
        first_ns: so much of the run is in the first one [ns].

    Yields:
        the part, and the first log time that is new in it [ns]; before that is what every part begins with.

    Raises:
        LogError: the log is damaged.
    """
    file = LogFile(path)
    try:
        head, rest = found.chunks[0], found.chunks[1:]
        begins = [place.offset for place in rest] + [found.end]
        part = folder / "part.mcap"
        for group in _groups(head.first, rest, first_ns) or [[]]:
            first = rest.index(group[0]) if group else 0
            for place in group:
                file.content(place)  # its checksum: Rerun would show what is damaged
            with part.open("wb") as out:
                out.write(file.read(0, begins[0]))
                if group:
                    out.write(file.read(begins[first], begins[first + len(group)] - begins[first]))
            yield part, min((place.first for place in group), default=head.first) if first else head.first
    finally:
        file.close()


def _groups(start_ns: int, chunks: list[ChunkPlace], first_ns: int) -> list[list[ChunkPlace]]:
    """Chunks by the window in which they begin."""
    groups: dict[int, list[ChunkPlace]] = {}
    for place in chunks:
        groups.setdefault(max(-1, (place.first - start_ns - first_ns) // SPAN_NS), []).append(place)
    return list(groups.values())
