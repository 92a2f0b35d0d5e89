"""The recorder process: records on stdin, notes as JSON lines on stdout; ends when its input ends.

``python -m handctl.log.write.process PATH FLOOR_BYTES``. It ignores SIGINT and SIGTERM: the controller decides when
a run is over, and if the controller dies the pipe ends.
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
from handctl.log.record import END, FRAMING, HEADER, SNAPSHOT, TICK
from handctl.log.write.syncer import Syncer
from handctl.log.write.writer import LogWriter

READ_BYTES = 1 << 20
NAP_S = 0.01
"""Between reads when little is waiting: one wake-up for several ticks, far below the pipe's room."""
NAP_BELOW_BYTES = 64 << 10
FLUSH_S = 0.15
"""Longest that a tick waits to be written in real time; with the nap, the write and a busy machine a killed recorder
loses less than 0.25 s."""
SYNC_S = 1.0
NICE = -10
"""Before what else the machine does, where that is permitted; the loop has real-time priority and stays before it."""


def tell(note: dict[str, object]) -> None:
    """A note for the controller; never waits for it."""
    with suppress(BlockingIOError, BrokenPipeError):
        os.write(1, json.dumps(note).encode() + b"\n")


def report(event: str, number: int) -> None:
    """An event of the writer as a note."""
    tell({"event": event, "number": number})


class Splitter:
    """Cuts a stream of bytes into records; an incomplete one waits for the rest."""

    def __init__(self) -> None:
        self._rest = b""

    def split(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """(kind, body) of each record that is complete now."""
        data, at = self._rest + data, 0
        while at + FRAMING.size <= len(data):
            length, kind = FRAMING.unpack_from(data, at)
            end = at + FRAMING.size + length
            if end > len(data):
                break
            yield kind, data[at + FRAMING.size : end]
            at = end
        self._rest = data[at:]


class Session:
    """One run from the first record to the end of the input."""

    def __init__(self, path: Path, floor_bytes: int) -> None:
        self._path, self._floor = path, floor_bytes
        self._splitter = Splitter()
        self._writer: LogWriter | None = None
        self._wall_flush = True
        self._reason, self._dropped = "controller died", 0

    def run(self) -> None:
        """Read until the input ends, then close the file."""
        clean = next_sync = time.monotonic()
        while True:
            if select.select([0], [], [], FLUSH_S)[0]:
                data = os.read(0, READ_BYTES)
                if not data:
                    break
                for kind, body in self._splitter.split(data):
                    self._take(kind, body)
                if len(data) < NAP_BELOW_BYTES:
                    time.sleep(NAP_S)
            now = time.monotonic()
            if self._writer and self._wall_flush and now >= clean + FLUSH_S:
                self._writer.flush()
            if not (self._writer and self._writer.pending):
                clean = now
            if self._writer and now >= next_sync:
                next_sync = now + SYNC_S
                self._writer.sync()
        if self._writer:
            tell({"summary": self._writer.finish(self._reason, self._dropped)})

    def _take(self, kind: int, body: bytes) -> None:
        if kind == TICK and self._writer:
            self._writer.add(body)
        elif kind == SNAPSHOT and self._writer:
            self._writer.add_snapshot(body)
        elif kind == HEADER:
            header = RunHeader.load(body)
            self._wall_flush = not header.deterministic
            self._writer = LogWriter(self._path, header, report, self._floor, to_disk=Syncer())
            tell({"ready": True})
        elif kind == END:
            end = json.loads(body)
            self._reason, self._dropped = str(end["reason"]), int(end["dropped"])


def main() -> int:
    """Run the recorder; 1 if the file cannot be created."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    os.set_blocking(1, False)
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
    session = Session(Path(sys.argv[1]), int(sys.argv[2]))
    try:
        session.run()
    except OSError as error:
        tell({"error": f"{error.strerror}: {error.filename or sys.argv[1]}"})
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
