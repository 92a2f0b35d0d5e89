"""Reader for a log that another process is still writing.

The reader copies each group of new chunks into a small log.
"""

from pathlib import Path

from handctl.log.read.logfile import LogFile
from handctl.log.read.record_scan import RecordScan, scan_records


class LogTail:
    """Reader of a growing log, from the start to the end.

    Each call of ``write_new_chunks`` continues at the position in the log at which the last call
    ended.
    """

    def __init__(self, path: Path) -> None:
        """Set the reading position before the first chunk of a log.

        Args:
            path: path of the growing log.
        """
        self._path = path
        self._scan = RecordScan()
        self._sent_chunks = 0

    @property
    def has_log_ended(self) -> bool:
        """Return True if the end mark of the log has been read."""
        return self._scan.is_complete

    def write_new_chunks(self, path: Path) -> int | None:
        """Write into a log file the chunks that have been added since the last call of this method.

        The written file has no end mark.

        Args:
            path: log file to write. The written file also contains the definitions of all topics.

        Returns:
            the time of the first new message in the log [ns]. If no new chunk is complete, the
            result is None, and the function writes no file.

        Raises:
            LogError: the log is damaged.
        """
        record_scan = self._scan
        if record_scan.is_complete:
            return None
        file = LogFile(self._path)
        try:
            scan_records(file, record_scan)
            # If the message indexes after a chunk are incomplete, Rerun loses messages of this
            # chunk. To avoid this loss, the reader passes on a chunk only when the record after the
            # message indexes exists.
            end_offsets = [
                *(chunk.offset for chunk in record_scan.chunks[1:]),
                *([record_scan.end] if record_scan.is_complete else []),
            ]
            new_chunks = record_scan.chunks[self._sent_chunks : len(end_offsets)]
            if not new_chunks:
                return None
            with path.open("wb") as output_file:
                # The first chunk of the log contains the definitions of all topics. Therefore every
                # written log file begins with the first chunk.
                if self._sent_chunks:
                    output_file.write(file.read_range(0, end_offsets[0]))
                start = new_chunks[0].offset if self._sent_chunks else 0
                output_file.write(file.read_range(start, end_offsets[-1] - start))
        finally:
            file.close()
        self._sent_chunks = len(end_offsets)
        return min(chunk.first_ns for chunk in new_chunks)
