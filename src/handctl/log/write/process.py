"""Recorder process. Reads records from stdin and writes notes as JSON lines to stdout.

The process ends when its input ends.

Command: `python -m handctl.log.write.process`. The first record names the file.

The recorder ignores SIGINT and SIGTERM because the controller decides the end of a run. If the
controller dies, the pipe is closed.
"""

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
from handctl.log.record import END, FILE, FRAMING, HEADER, SNAPSHOT, TICK
from handctl.log.write.syncer import Syncer
from handctl.log.write.writer import LogWriter

READ_BYTES = 1 << 20
"""Largest size of one read [bytes]."""
PAUSE_S = 0.01
"""Pause after a read of few bytes [s].

After the pause one read gets the records of several ticks. The pipe stays far from full.
"""
PAUSE_BELOW_BYTES = 64 << 10
"""Reads below this size are followed by a pause [bytes]."""
MAX_UNWRITTEN_S = 0.15
"""Longest time before a tick is written to the file, in real time [s].

Including the pause, the write, and a busy machine, a killed recorder loses less than 0.25 s.
"""
SYNC_PERIOD_S = 1.0
"""Interval between syncs of the file to disk [s]."""
NICE = -10
"""Scheduling priority (nice value) of the recorder, above other programs if the system permits it.

The control loop has real-time priority, and precedes the recorder.
"""


def send_note(note: dict[str, object]) -> None:
    """Send a note to the controller.

    If the pipe is full, the note is lost, because the recorder must not wait.
    """
    with suppress(BlockingIOError, BrokenPipeError):
        os.write(1, json.dumps(note).encode() + b"\n")


def report_event(event: str, number: int) -> None:
    """Send an event of the writer as a note."""
    send_note({"event": event, "number": number})


class Splitter:
    """Splitter of a byte stream into records.

    An incomplete record is kept until its rest arrives.
    """

    def __init__(self) -> None:
        """Start at the boundary of a record."""
        self._rest = b""

    def split(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield (kind, body) of each complete record."""
        data = self._rest + data
        at = 0
        while at + FRAMING.size <= len(data):
            length, kind = FRAMING.unpack_from(data, at)
            end = at + FRAMING.size + length
            if end > len(data):
                break
            yield kind, data[at + FRAMING.size : end]
            at = end
        self._rest = data[at:]


class RecorderSession:
    """Session of the recorder for one run, from the first record to the end of the input.

    Attributes:
        path: path of the log.
    """

    def __init__(self) -> None:
        """Start without a file."""
        self.path = Path()
        self._floor = 0
        self._splitter = Splitter()
        self._writer: LogWriter | None = None
        self._wall_flush = True
        self._reason = "controller died"
        self._dropped = 0
        self._facts: dict[str, str] = {}

    def run(self) -> None:
        """Read until the input ends, then close the file."""
        clean = next_sync = time.monotonic()
        while True:
            if select.select([0], [], [], MAX_UNWRITTEN_S)[0]:
                data = os.read(0, READ_BYTES)
                if not data:
                    break
                for kind, body in self._splitter.split(data):
                    self._take_record(kind, body)
                if len(data) < PAUSE_BELOW_BYTES:
                    time.sleep(PAUSE_S)
            now = time.monotonic()
            if self._writer and self._wall_flush and now >= clean + MAX_UNWRITTEN_S:
                self._writer.flush()
            # `clean` is the last time at which no tick waited, so that MAX_UNWRITTEN_S counts from
            # the oldest waiting tick.
            if not (self._writer and self._writer.pending):
                clean = now
            if self._writer and now >= next_sync:
                next_sync = now + SYNC_PERIOD_S
                self._writer.sync()
        if self._writer:
            send_note({"summary": self._writer.finish(self._reason, self._dropped, self._facts)})

    def _take_record(self, kind: int, body: bytes) -> None:
        """Process one record."""
        if kind == TICK and self._writer:
            self._writer.add(body)
        elif kind == SNAPSHOT and self._writer:
            self._writer.add_snapshot(body)
        elif kind == FILE:
            file = json.loads(body)
            self.path = Path(file["path"])
            self._floor = int(file["floor_bytes"])
        elif kind == HEADER:
            header = RunHeader.load(body)
            self._wall_flush = not header.deterministic
            self._writer = LogWriter(self.path, header, report_event, self._floor, to_disk=Syncer())
            send_note({"ready": True})
        elif kind == END:
            end = json.loads(body)
            self._reason = str(end["reason"])
            self._dropped = int(end["dropped"])
            self._facts = {str(name): str(value) for name, value in end["facts"].items()}


def main() -> int:
    """Run the recorder. Return 1 if the file cannot be created."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    # Notes must never block the recorder.
    os.set_blocking(1, False)
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
    session = RecorderSession()
    try:
        session.run()
    except OSError as error:
        send_note({"error": f"{error.strerror}: {error.filename or session.path}"})
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
