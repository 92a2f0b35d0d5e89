"""Reading of new chunks from a log that is being written, in the form of small logs."""

from pathlib import Path

from handctl.log.read.logfile import LogFile
from handctl.log.read.record_scan import RecordScan, scan_records


class LogTail:
    """Reader of a growing log, from its start to its end.

    Attributes:
        ended: True if the end mark of the log was read.
    """

    def __init__(self, path: Path) -> None:
        """Start before the first chunk.

        Args:
            path: path of the log.
        """
        self._path = path
        self._sent_chunks = 0
        self.ended = False

    def write_new(self, part: Path) -> int | None:
        """Write the chunks since the last call into a log without an end.

        Args:
            part: file to write, with all definitions of topics.

        Returns:
            The first new log time [ns], or None if no new chunk is complete. The file is then not
            written.

        Raises:
            LogError: the log is damaged.
        """
        file = LogFile(self._path)
        scan = RecordScan()
        try:
            scan_records(file, scan)
            self.ended = scan.complete
            # Rerun loses messages of a chunk whose index is not complete, so a chunk waits for what
            # follows it.
            ends = [
                *(chunk.offset for chunk in scan.chunks[1:]),
                *([scan.end] if scan.complete else []),
            ]
            new = scan.chunks[self._sent_chunks : len(ends)]
            if not new:
                return None
            with part.open("wb") as out:
                # The first chunk has the definitions of all topics. Every part begins with it.
                if self._sent_chunks:
                    out.write(file.read(0, ends[0]))
                start = new[0].offset if self._sent_chunks else 0
                out.write(file.read(start, ends[-1] - start))
        finally:
            file.close()
        self._sent_chunks = len(ends)
        return min(chunk.first for chunk in new)
