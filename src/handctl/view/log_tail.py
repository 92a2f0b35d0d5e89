"""Reader for a log that is being written.

The reader copies each group of new chunks into a small log.
"""

from pathlib import Path

from handctl.log.read.logfile import LogFile
from handctl.log.read.record_scan import RecordScan, scan_records


class LogTail:
    """Reader of a growing log, from start to end. Each call continues where the last one ended."""

    def __init__(self, path: Path) -> None:
        """Start before the first chunk of a log.

        Args:
            path: path of the log.
        """
        self._path = path
        self._scan = RecordScan()
        self._sent_chunks = 0

    @property
    def log_ended(self) -> bool:
        """Return True if the end mark of the log has been read."""
        return self._scan.complete

    def write_new_chunks(self, path: Path) -> int | None:
        """Write the chunks that are new since the last call into a log file without an end mark.

        Args:
            path: log file to write. The file also has the definitions of all topics.

        Returns:
            the first new log time [ns]. If no new chunk is complete, the result is None, and no
            file is written.

        Raises:
            LogError: the log is damaged.
        """
        scan = self._scan
        if scan.complete:
            return None
        file = LogFile(self._path)
        try:
            scan_records(file, scan)
            # Rerun loses messages of a chunk whose message indexes are not complete. So a chunk is
            # sent only when the record after its message indexes exists.
            ends = [
                *(chunk.offset for chunk in scan.chunks[1:]),
                *([scan.end] if scan.complete else []),
            ]
            new = scan.chunks[self._sent_chunks : len(ends)]
            if not new:
                return None
            with path.open("wb") as out:
                # The first chunk of the log has the definitions of all topics. Therefore every
                # written part begins with this chunk.
                if self._sent_chunks:
                    out.write(file.read_range(0, ends[0]))
                start = new[0].offset if self._sent_chunks else 0
                out.write(file.read_range(start, ends[-1] - start))
        finally:
            file.close()
        self._sent_chunks = len(ends)
        return min(chunk.first_ns for chunk in new)
