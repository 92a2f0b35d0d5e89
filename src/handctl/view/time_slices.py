"""Division of a log into small log files by time.

A viewer can show the first part of the run before the last part of the log is read.
"""

from collections.abc import Iterator
from pathlib import Path

from handctl.log.read.logfile import ChunkLocation, LogFile
from handctl.log.read.record_scan import RecordScan

SLICE_DURATION_NS = 20_000_000_000
"""Duration of the part of the run in each small log after the first one [ns].

A part of this length has few chunks, which limits the use of memory.
"""


def time_slices(
    path: Path, record_scan: RecordScan, folder: Path, first_slice_duration_ns: int
) -> Iterator[tuple[Path, int]]:
    """Divide a complete log into parts, and yield the parts in the order of time.

    Each part is a log file. When the caller requests the next part, the function overwrites the
    file of the previous part.

    Args:
        path: path of a complete log.
        record_scan: list of the records of the log.
        folder: folder for the parts.
        first_slice_duration_ns: duration of the first part of the run [ns].

    Yields:
        the path of the part, and the first new log time [ns]. Each part starts with the definitions
        of all topics. In later parts, the log times of the definitions are older.

    Raises:
        LogError: the log is damaged.
    """
    log_file = LogFile(path)
    try:
        first_chunk = record_scan.chunks[0]
        remaining_chunks = record_scan.chunks[1:]
        start_offsets = [chunk.offset for chunk in remaining_chunks] + [record_scan.end]
        partial_log = folder / "part.mcap"
        for group in _group_chunks(
            first_chunk.first_ns, remaining_chunks, first_slice_duration_ns
        ) or [[]]:
            first_chunk_index = remaining_chunks.index(group[0]) if group else 0
            for chunk in group:
                # The checksum of each chunk is checked, because Rerun would show damaged data.
                log_file.chunk_content(chunk)
            # Every part begins with the head of the log file and the first chunk, which contain the
            # definitions of all topics.
            with partial_log.open("wb") as output_file:
                output_file.write(log_file.read_range(0, start_offsets[0]))
                if group:
                    output_file.write(
                        log_file.read_range(
                            start_offsets[first_chunk_index],
                            start_offsets[first_chunk_index + len(group)]
                            - start_offsets[first_chunk_index],
                        )
                    )
            yield (
                partial_log,
                min((chunk.first_ns for chunk in group), default=first_chunk.first_ns)
                if first_chunk_index
                else first_chunk.first_ns,
            )
    finally:
        log_file.close()


def _group_chunks(
    start_ns: int, chunks: list[ChunkLocation], first_slice_duration_ns: int
) -> list[list[ChunkLocation]]:
    """Divide chunks into groups, one for each part of the run.

    A chunk belongs to the part in which the chunk begins.
    """
    groups: dict[int, list[ChunkLocation]] = {}
    for chunk in chunks:
        groups.setdefault(
            max(-1, (chunk.first_ns - start_ns - first_slice_duration_ns) // SLICE_DURATION_NS), []
        ).append(chunk)
    return list(groups.values())
