"""Connection between the controller and the recorder process, on the side of the controller.

In a real-time run, the controller sends a record without waiting.
"""

import fcntl
import json
import os
import select
import struct
import subprocess
import termios
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Self

from handctl.core.tick_types import IoEvent
from handctl.errors import LogError
from handctl.log.header import RunHeader
from handctl.log.tick_packing import record_bytes
from handctl.log.tick_record import END_RECORD_KIND, FILE_RECORD_KIND, HEADER_RECORD_KIND
from handctl.log.write.recorder_start import RecorderProcess, get_recorder_process

PIPE_BYTES = (8 << 20, 1 << 20)
"""Sizes to request for the pipe to the recorder, in order of preference [bytes].

Linux grants a pipe of the second size to a process without privileges. A pipe of the second size
can contain more than 250 ticks of the largest hand.
"""
MIN_FREE_DISK_BYTES = 64 << 20
"""Free disk space below which a log is finished early [bytes].

The recorder warns when the free space is below four times MIN_FREE_DISK_BYTES.
"""
START_TIMEOUT_S = 60.0
"""Longest wait until the recorder is ready at the start of a run [s]."""
CLOSE_TIMEOUT_S = 20.0
"""Longest wait until the recorder has finished the log at the end of a run [s]."""
LOCKSTEP_TIMEOUT_S = 60.0
"""Longest wait until the recorder accepts one record of a lockstep run [s]."""
PROCESS_CHECK_PERIOD_NS = 10_000_000
"""Time from one check of the recorder process to the next [ns].

A check of the recorder process needs two system calls. A delay of some milliseconds is acceptable,
because no event of the recorder stops the hand.
"""
CHECKED_PIPE_SHARE = 0.25
"""Share of the pipe's size after which the recorder process is checked earlier than `PROCESS_CHECK_PERIOD_NS`."""


def _enlarge_pipe(descriptor: int) -> int:
    """Request a larger pipe from the system, and return the size that the system has granted [bytes]."""
    for size in PIPE_BYTES if hasattr(fcntl, "F_SETPIPE_SZ") else ():
        with suppress(OSError):
            return fcntl.fcntl(descriptor, fcntl.F_SETPIPE_SZ, size)
    return 1 << 16


class Recorder:
    """Connection of the controller to a running recorder process. The method `start` creates the connection.

    Attributes:
        dropped: number of records that were lost because the pipe was full or the recorder process
            had ended.
    """

    def __init__(self, path: Path, process: RecorderProcess, lossless: bool) -> None:
        """Connect to a recorder process.

        Args:
            path: path of the log file.
            process: recorder process to use.
            lossless: True to wait while the pipe is full, instead of dropping records.
        """
        assert process.child.stdout is not None
        self._path = path
        self._process = process
        self._child, self._pipe = process
        self._notes = process.child.stdout.fileno()
        self._lossless = lossless
        self._size = _enlarge_pipe(self._pipe)
        self._rest = b""
        self._line = b""
        self._ended = self._end_reported = self._filling = False
        self._announced = self.dropped = 0
        self._event_notes: list[dict[str, object]] = []
        self._other_notes: list[dict[str, object]] = []
        self._next_check_ns = 0
        self._unchecked_bytes = 0
        self._max_unchecked_bytes = round(self._size * CHECKED_PIPE_SHARE)
        os.set_blocking(self._notes, False)
        self._poll = select.poll()
        self._poll.register(self._notes, select.POLLIN)

    @classmethod
    def start(
        cls, path: Path, header: RunHeader, min_free_bytes: int = MIN_FREE_DISK_BYTES
    ) -> Self:
        """Start recording, and wait until the log file contains the header.

        If a recorder process has been started in advance, the connection uses this process.

        Args:
            path: path of the new log file.
            header: header of the run.
            min_free_bytes: smallest amount of free disk space for the recording [bytes]. If less
                space is free, the recorder finishes the log early.

        Raises:
            LogError: the log file cannot be created, or the recorder process does not answer.
        """
        recorder = cls(path, get_recorder_process(), header.deterministic)
        file = json.dumps({"path": str(path), "floor_bytes": min_free_bytes}).encode()
        recorder._send_header(
            record_bytes(FILE_RECORD_KIND, file) + record_bytes(HEADER_RECORD_KIND, header.dump())
        )
        return recorder

    def _send_header(self, header: bytes) -> None:
        """Send the header of the run to the recorder process, and wait until the recorder has confirmed the header."""
        os.set_blocking(self._pipe, False)
        try:
            if not self._send(header, START_TIMEOUT_S):
                raise LogError("the recorder process does not read", str(self._path))
            self._read_notes(START_TIMEOUT_S)
            if not any("ready" in note for note in self._other_notes):
                errors = [str(note["error"]) for note in self._other_notes if "error" in note]
                if not errors:
                    failure_text = (
                        "has ended at its start"
                        if self._ended
                        else f"has not started within {START_TIMEOUT_S:g} s"
                    )
                    problem_text = f"the recorder process {failure_text}"
                    raise LogError(problem_text, str(self._path), "a computer with less other load")
                raise LogError(
                    f"cannot record: {errors[0]}",
                    str(self._path),
                    "a new file in a writable directory",
                )
        except LogError:
            self._abandon_process()
            raise

    def _abandon_process(self) -> None:
        """End a recorder process whose start has failed."""
        self._ended = True
        self._process.end_process()

    def _close_note_pipe(self) -> None:
        """Close the pipe for the notes of the recorder."""
        assert self._child.stdout is not None
        self._child.stdout.close()

    def _send(self, data: bytes, timeout_s: float) -> bool:
        """Write all bytes to the pipe, but wait at most `timeout_s` [s].

        Returns:
            True if all bytes were written. If the result is False, the caller must not send further
            records, because the last record in the pipe is incomplete.
        """
        end = time.monotonic() + timeout_s
        view = memoryview(data)
        while view:
            try:
                view = view[os.write(self._pipe, view) :]
            except BlockingIOError:
                remaining = end - time.monotonic()
                if remaining <= 0 or not select.select([], [self._pipe], [], remaining)[1]:
                    return False
            except BrokenPipeError:
                self._ended = True
                return False
        return True

    def send_record(self, data: bytes) -> bool:
        """Send one record.

        If the pipe is full, a real-time run does not wait. A deterministic run waits until the pipe
        has space.

        Args:
            data: encoded record, for example from `record.pack_tick_record`.

        Returns:
            True if the record was sent, and False if it was dropped.
        """
        self._unchecked_bytes += len(data)
        if self._ended:
            self.dropped += 1
            return False
        if self._lossless:
            self._ended = not self._send(data, LOCKSTEP_TIMEOUT_S)
            self.dropped += self._ended
            return not self._ended
        try:
            # If only a part of the last record was written, the rest of this record must be written
            # before the next record. Without the rest of the last record, the recorder could not
            # find the start of the next record.
            if self._rest:
                self._rest = self._rest[os.write(self._pipe, self._rest) :]
            if not self._rest:
                written = os.write(self._pipe, data)
                if written < len(data):
                    self._rest = data[written:]
                return True
        except BlockingIOError:
            pass
        except BrokenPipeError:
            self._ended = True
        self.dropped += 1
        return False

    def take_events(self) -> tuple[IoEvent, ...]:
        """Return the events of the recorder since the last call. The loop calls this method in every tick.

        To save system calls, the method checks the recorder process only once in
        `PROCESS_CHECK_PERIOD_NS`, or when a quarter of the pipe could have been filled since the
        last check.

        All events of the recorder have the kind "recorder".

        `where` is one of:
            dropped: records were dropped. Value: number of dropped records.
            gone: the recorder process has ended.
            filling: the pipe to the recorder has become more than half full. Value: number of bytes
                in the pipe.
            disk_low: little disk space is left. Value: number of free bytes.
            disk_full: the log was finished early, because the disk is full. Value: number of free
                bytes, or errno.
            error: a write to the log file has failed. Value: errno.
            misshapen: the telemetry of a tick does not have the shape that the header describes.
        """
        now_ns = time.monotonic_ns()
        is_check_due = (
            now_ns >= self._next_check_ns or self._unchecked_bytes > self._max_unchecked_bytes
        )
        if not (is_check_due or self._ended or self.dropped != self._announced):
            return ()  # as in most ticks
        events = []
        if is_check_due and not self._ended:
            self._next_check_ns = now_ns + PROCESS_CHECK_PERIOD_NS
            self._unchecked_bytes = 0
            if self._poll.poll(0):
                self._read_notes(0.0)
            events = self._pipe_level_events()
        events += [
            IoEvent("recorder", str(note["event"]), int(str(note["number"])))
            for note in self._event_notes
        ]
        self._event_notes = []
        if self.dropped > self._announced:
            events.append(IoEvent("recorder", "dropped", self.dropped - self._announced))
            self._announced = self.dropped
        if self._ended and not self._end_reported:
            self._end_reported = True
            events.append(IoEvent("recorder", "gone"))
        return tuple(events)

    def _pipe_level_events(self) -> list[IoEvent]:
        """Return an event if the pipe has become more than half full since the last call.

        The number of bytes in the pipe depends on the speed of the machine. For this reason, a
        deterministic run gets no event about the pipe. If the pipe is full, a deterministic run
        waits.
        """
        if self._lossless:
            return []
        # FIONREAD returns the number of bytes in the pipe that the recorder has not read yet.
        buffered_bytes = struct.unpack("i", fcntl.ioctl(self._pipe, termios.FIONREAD, b"\0\0\0\0"))[
            0
        ]
        was_filling = self._filling
        self._filling = buffered_bytes > self._size // 2
        return (
            [IoEvent("recorder", "filling", buffered_bytes)]
            if self._filling and not was_filling
            else []
        )

    def _read_notes(self, timeout_s: float) -> None:
        """Read all notes that the recorder process has sent to the controller.

        Args:
            timeout_s: longest time to wait for the first note [s].
        """
        if timeout_s and not select.select([self._notes], [], [], timeout_s)[0]:
            return
        while True:
            try:
                data = os.read(self._notes, 1 << 16)
            except BlockingIOError:
                return
            if not data:
                self._ended = True
                return
            *lines, self._line = (self._line + data).split(b"\n")
            for line in lines:
                note = json.loads(line)
                (self._event_notes if "event" in note else self._other_notes).append(note)

    def close(
        self, end_reason: str, final_metadata: Mapping[str, str] | None = None
    ) -> dict[str, object]:
        """End the recording of the run, and wait until the log file is complete.

        Args:
            end_reason: reason why the run ended, which is written to the log.
            final_metadata: facts for the log that are known only at the end of the run, by the name of the
                fact.

        Returns:
            A summary with the keys path, bytes, complete and dropped. If the recorder has finished
            the log, the summary also contains ticks, messages, lost and reason.
        """
        body = json.dumps(
            {"reason": end_reason, "dropped": self.dropped, "facts": dict(final_metadata or {})}
        ).encode()
        if not self._ended and self._send(self._rest, CLOSE_TIMEOUT_S):
            self._send(record_bytes(END_RECORD_KIND, body), CLOSE_TIMEOUT_S)
        os.close(self._pipe)
        try:
            self._child.wait(CLOSE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        self._read_notes(0.0)
        self._close_note_pipe()
        summary = next((note["summary"] for note in self._other_notes if "summary" in note), {})
        assert isinstance(summary, dict)
        size = self._path.stat().st_size if self._path.exists() else 0
        return {
            "path": str(self._path),
            "bytes": size,
            "complete": bool(summary),
            "dropped": self.dropped,
        } | summary
