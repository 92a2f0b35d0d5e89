"""Recorder process: reads records from stdin, writes the log file, and writes notes as JSON lines to stdout.

The recorder process ends when stdin ends.

Command: `python -m handctl.log.write.recorder_process`. The first record names the log file.

The recorder ignores SIGINT and SIGTERM, because the controller decides when a run ends. If the
controller dies, the system closes the pipe, and the recorder ends.
"""

import ctypes
import json
import os
import select
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from handctl.log.header import RunHeader
from handctl.log.tick_record import (
    END_RECORD_KIND,
    FILE_RECORD_KIND,
    HEADER_RECORD_KIND,
    RECORD_FRAMING_STRUCT,
    SNAPSHOT_RECORD_KIND,
    TICK_RECORD_KIND,
)
from handctl.log.write.disk_syncer import DiskSyncer
from handctl.log.write.log_writer import LogWriter

MAX_READ_BYTES = 1 << 20
"""Largest number of bytes that one read takes from the pipe."""
WRITE_PAUSE_S = 0.01
"""Pause after a read that returned few bytes [s].

After the pause, one read returns the records of several ticks. During the pause, the pipe never
comes close to full.
"""
MIN_BYTES_WITHOUT_PAUSE = 64 << 10
"""Number of bytes returned by a read below which a pause follows the read."""
MAX_UNWRITTEN_S = 0.15
"""Longest time for which a tick waits to be written to the file, in real time [s].

The pause after a read, the write to the file and the delays of a busy machine add to this time. If
the recorder is killed, less than 0.25 s of ticks are lost in all.
"""
SYNC_PERIOD_S = 1.0
"""Interval between two requests to sync the file to disk [s]."""
RECORDER_NICE_VALUE = -10
"""Nice value of the recorder process.

If the system permits it, the recorder has a higher priority than other programs. The control loop
has real-time priority, which is higher than the priority of the recorder.
"""
KEPT_MEMORY_BYTES = 32 << 20
"""Amount of freed memory that the allocator keeps for later allocations [bytes].

Some versions of glibc refuse a larger ``M_MMAP_THRESHOLD``.
"""
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Parameters of ``mallopt`` in the C library glibc. Source: glibc, malloc/malloc.h; mallopt(3)."""


def send_note(note: dict[str, object]) -> None:
    """Send a note to the controller, as one line of JSON.

    If the pipe to the controller is full, the note is lost, because the recorder must never wait.
    """
    with suppress(BlockingIOError, BrokenPipeError):
        os.write(1, json.dumps(note).encode() + b"\n")


def report_event(event: str, number: int) -> None:
    """Send a note to the controller about an event of the log writer."""
    send_note({"event": event, "number": number})


class RecordSplitter:
    """Splitter that divides the bytes from the pipe into records.

    The splitter keeps an incomplete record until the missing bytes of the record arrive.
    """

    def __init__(self) -> None:
        """Start with an empty stream.

        The first byte of the stream must be the start of a record.
        """
        self._rest = b""

    def complete_records(self, pipe_bytes: bytes) -> Iterator[tuple[int, bytes]]:
        """Add bytes to the stream.

        For each record that is now complete, yield the kind and the body.
        """
        pipe_bytes = self._rest + pipe_bytes
        at = 0
        while at + RECORD_FRAMING_STRUCT.size <= len(pipe_bytes):
            length, kind = RECORD_FRAMING_STRUCT.unpack_from(pipe_bytes, at)
            end = at + RECORD_FRAMING_STRUCT.size + length
            if end > len(pipe_bytes):
                break
            yield kind, pipe_bytes[at + RECORD_FRAMING_STRUCT.size : end]
            at = end
        self._rest = pipe_bytes[at:]


class RecorderSession:
    """Recording of one run, from the first record to the end of the input.

    Attributes:
        path: path of the log.
    """

    def __init__(self) -> None:
        """Create a session without a log file.

        The session opens the log file after it has received the path of the file and the run
        header.
        """
        self.path = Path()
        self._min_free_bytes = 0
        self._splitter = RecordSplitter()
        self._writer: LogWriter | None = None
        self._wall_flush = True
        self._reason = "controller died"
        self._dropped = 0
        self._facts: dict[str, str] = {}

    def run(self) -> None:
        """Process records until stdin ends, and then close the log file."""
        last_flushed = next_sync_time = time.monotonic()
        while True:
            if select.select([0], [], [], MAX_UNWRITTEN_S)[0]:
                data = os.read(0, MAX_READ_BYTES)
                if not data:
                    break
                for kind, body in self._splitter.complete_records(data):
                    self._take_record(kind, body)
                if len(data) < MIN_BYTES_WITHOUT_PAUSE:
                    time.sleep(WRITE_PAUSE_S)
            now = time.monotonic()
            if self._writer and self._wall_flush and now >= last_flushed + MAX_UNWRITTEN_S:
                self._writer.flush()
            # `last_flushed` is the last time at which no tick was waiting to be written to the
            # file. With `last_flushed`, MAX_UNWRITTEN_S counts from the arrival of the oldest tick
            # that waits.
            if not (self._writer and self._writer.has_pending_ticks):
                last_flushed = now
            if self._writer and now >= next_sync_time:
                next_sync_time = now + SYNC_PERIOD_S
                self._writer.sync()
        if self._writer:
            send_note({"summary": self._writer.finish(self._reason, self._dropped, self._facts)})

    def _take_record(self, record_kind: int, body: bytes) -> None:
        """Process one record from the controller."""
        if record_kind == TICK_RECORD_KIND and self._writer:
            self._writer.add_tick(body)
        elif record_kind == SNAPSHOT_RECORD_KIND and self._writer:
            self._writer.add_snapshot(body)
        elif record_kind == FILE_RECORD_KIND:
            file = json.loads(body)
            self.path = Path(file["path"])
            self._min_free_bytes = int(file["floor_bytes"])
        elif record_kind == HEADER_RECORD_KIND:
            header = RunHeader.load(body)
            self._wall_flush = not header.deterministic
            self._writer = LogWriter(
                self.path, header, report_event, self._min_free_bytes, sync_file=DiskSyncer()
            )
            send_note({"ready": True})
        elif record_kind == END_RECORD_KIND:
            end = json.loads(body)
            self._reason = str(end["reason"])
            self._dropped = int(end["dropped"])
            self._facts = {str(name): str(value) for name, value in end["facts"].items()}


def keep_freed_memory() -> None:
    """Let the allocator keep freed memory for later allocations.

    For each chunk, the recorder allocates and frees some megabytes. By default, glibc returns freed
    blocks of this size to the system, and the system clears each page again before its next use.
    This took a quarter of the recorder's processor time. Other C libraries stay as they are.
    """
    with suppress(AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_MMAP_THRESHOLD, KEPT_MEMORY_BYTES)
        mallopt(M_TRIM_THRESHOLD, KEPT_MEMORY_BYTES)


def main() -> int:
    """Run the recorder process, and return its exit code.

    If the log file cannot be created, the exit code is 1.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    # Writing a note must not block, because the recorder must never wait.
    os.set_blocking(1, False)
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, RECORDER_NICE_VALUE)
    keep_freed_memory()
    session = RecorderSession()
    try:
        session.run()
    except OSError as error:
        send_note({"error": f"{error.strerror}: {error.filename or session.path}"})
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
