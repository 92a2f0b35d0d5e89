"""Observations of a running hand in shared memory.

The shared memory contains one numpy record for each tick. Any number of programs can read the
records.

The controller writes the records into a ring. The ring is part of a file in the folder of the
sockets. A reader maps the file and copies records, without locks or system calls. Each record has a
counter that is odd while the controller writes the record (a seqlock). If the counter of a record
has changed during a copy, the reader copies the record again.

The file begins with a magic text of 8 bytes. Five u64 numbers follow: length of the description,
size of a record, number of records in the ring, number of records written so far, and end mark.
After the five numbers, the file contains the description as JSON, and the ring.
"""

import contextlib
import json
import mmap
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import (
    TELEMETRY_AXES,
    TELEMETRY_FIELDS,
    PackedTelemetry,
    TickIn,
    TickOut,
)
from handctl.errors import BusError
from handctl.programs.stream_plans import StreamStatus
from handctl.runtime.mailbox import RUN_FOLDER_ADVICE
from handctl.runtime.socket_paths import observations_path

OBSERVATION_FILE_MAGIC = b"HCOBS001"
HEADER_STRUCT = struct.Struct("<8sQQQQQ")
"""Layout at the start of the file: magic text, and the five numbers that the module's docstring explains."""
WRITTEN_COUNT_OFFSET = 32
END_MARK_OFFSET = 40
"""Offsets in the file of the number of records written so far, and of the end mark [bytes]."""
RING_RECORDS = 512
"""Number of records in the ring.

A ring of this size contains about the last second of a run at 500 Hz.
"""
PAGE_BYTES = 4096
"""Alignment of the ring in the file [bytes]."""
MAX_COPY_ATTEMPTS = 100
"""Number of attempts to copy a record that the controller is overwriting."""
PUBLISHED_NAME_BY_FIELD = {
    "q": "q_rad", "dq": "dq_rad_s", "q_goal": "q_goal_rad", "dq_goal": "dq_goal_rad_s",
    "joint_torque": "joint_torque_N_m", "joint_encoder": "joint_encoder_rad", "excursion": "excursion_m",
    "excursion_rate": "excursion_rate_m_s", "tension": "tension_N", "tension_sigma": "tension_sigma_N",
    "tension_raw": "tension_raw_N", "tension_goal": "tension_goal_N", "stretch_offset": "stretch_offset_m",
    "innovation": "innovation_N", "nis": "nis", "external_tension": "external_tension_N",
    "motor_position": "motor_position_rad", "motor_velocity": "motor_velocity_rad_s",
    "motor_torque": "motor_torque_N_m", "motor_torque_goal": "motor_torque_goal_N_m",
    "motor_temperature": "motor_temperature_degC", "motor_age": "motor_age_s", "drive_phase": "drive_phase",
    "tip_force": "tip_force_N", "contact": "contact", "q_sigma": "q_sigma_rad", "tip_force_sigma": "tip_force_sigma_N",
}  # fmt: skip
"""Name of each telemetry field in a record. The name ends with the unit."""
COUNTER_DTYPE = "<u8"
LEADING_FIELDS: tuple[tuple[str, str], ...] = (
    ("k", "<i8"), ("t_ns", "<i8"), ("late_ns", "<i8"), ("published_ns", "<i8"), ("mode", "<i4"), ("action", "<i4"),
    ("phase", "S24"),
    ("stream_number", "<i8"), ("stream_age_s", "<f8"), ("stream_accepted", "<i8"), ("stream_clipped", "<i8"),
    ("stream_late", "<i8"), ("stream_refused", "<i8"), ("stream_limited", "<i8"),
)  # fmt: skip
"""Fields of a record before the telemetry fields."""
_SCALAR_FIELDS_STRUCT = struct.Struct("<qqqqii24sqdqqqqq")


def observation_dtype(axes: Mapping[str, int]) -> np.dtype[np.void]:
    """Return the numpy type of the record of a tick.

    Args:
        axes: numbers of joints, tendons, motors and digits of the hand, with the keys "joint",
            "tendon", "motor" and "digit".
    """
    numbers = [
        (PUBLISHED_NAME_BY_FIELD[name], "<f8", (axes[TELEMETRY_AXES[name]],))
        for name in TELEMETRY_FIELDS
    ]
    return np.dtype([*LEADING_FIELDS, *numbers])


def _create_mapped_file(path: Path, byte_count: int) -> mmap.mmap:
    """Create a file of a given size [bytes], and return the mapping of the file into memory.

    After an error, the file does not exist.

    Raises:
        OSError: the file cannot be created, or the disk is full.
    """
    path.unlink(missing_ok=True)
    descriptor = os.open(
        path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600
    )
    try:
        os.posix_fallocate(descriptor, 0, byte_count)
        return mmap.mmap(descriptor, 0)
    except OSError:
        path.unlink(missing_ok=True)
        raise
    finally:
        os.close(descriptor)


class ObservationWriter:
    """Writer of the observations, owned by the controller."""

    def __init__(self, bus: str, axes: Mapping[str, int], description: Mapping[str, Any]) -> None:
        """Create the shared-memory file for the observations of a bus.

        Args:
            bus: bus of the controller. The controller must have locked this bus.
            axes: counts of joints, tendons, motors and digits, see ``observation_dtype``.
            description: names and constants of the hand, for the readers of the file.

        Raises:
            BusError: the file cannot be created.
        """
        self.path = observations_path(bus)
        kind = observation_dtype(axes)
        self._size = 8 + kind.itemsize
        self._written = 0
        text = json.dumps({"axes": dict(axes), **description}).encode()
        self._ring_at = -(-(HEADER_STRUCT.size + len(text)) // PAGE_BYTES) * PAGE_BYTES
        try:
            self._map = _create_mapped_file(self.path, self._ring_at + RING_RECORDS * self._size)
        except OSError as error:
            raise BusError(
                f"cannot write observations: {error}", str(self.path.parent), RUN_FOLDER_ADVICE
            ) from None
        # All telemetry fields consist of 8-byte numbers without gaps. The telemetry fields are
        # written together, as one vector at the end of the record.
        count = sum(axes[TELEMETRY_AXES[name]] for name in TELEMETRY_FIELDS)
        assert kind.itemsize == _SCALAR_FIELDS_STRUCT.size + 8 * count
        slot_offsets = [self._ring_at + self._size * slot for slot in range(RING_RECORDS)]
        self._counters = [
            np.frombuffer(self._map, COUNTER_DTYPE, 1, start) for start in slot_offsets
        ]
        self._numbers = [
            np.frombuffer(self._map, "<f8", count, start + 8 + _SCALAR_FIELDS_STRUCT.size)
            for start in slot_offsets
        ]
        self._map[HEADER_STRUCT.size : HEADER_STRUCT.size + len(text)] = text
        HEADER_STRUCT.pack_into(
            self._map, 0, OBSERVATION_FILE_MAGIC, len(text), self._size, RING_RECORDS, 0, 0
        )
        self._total = np.frombuffer(self._map, COUNTER_DTYPE, 1, WRITTEN_COUNT_OFFSET)
        self._ended = np.frombuffer(self._map, COUNTER_DTYPE, 1, END_MARK_OFFSET)

    def write_record(
        self, entry: TickIn, tick_output: TickOut, stream: StreamStatus, sent_ns: int
    ) -> None:
        """Write the record of a tick.

        Args:
            entry: inputs of the tick.
            tick_output: output of the tick.
            stream: status of the stream of targets that a client has opened.
            sent_ns: reading of CLOCK_MONOTONIC after the commands of the tick had been sent [ns].
        """
        numbers = tick_output.telemetry
        assert isinstance(numbers, PackedTelemetry)
        written_count = self._written
        slot = written_count % RING_RECORDS
        counter = self._counters[slot]
        counter[0] = 2 * written_count + 1
        _SCALAR_FIELDS_STRUCT.pack_into(
            self._map, self._ring_at + self._size * slot + 8, entry.k, entry.t_ns, entry.late_ns, sent_ns,
            tick_output.mode, tick_output.action, tick_output.phase.encode()[:24], *stream,
        )  # fmt: skip
        self._numbers[slot][...] = numbers.numbers
        counter[0] = 2 * written_count + 2
        self._written = written_count + 1
        self._total[0] = written_count + 1

    def close(self) -> None:
        """Write the end mark, and remove the file.

        The end mark tells all readers that the run has ended.
        """
        self._ended[0] = 1
        self.path.unlink(missing_ok=True)
        del self._counters, self._numbers, self._total, self._ended
        self._map.close()


class ObservationReader:
    """Reader of the observations, in a client.

    Attributes:
        description: names and constants of the hand.
        kind: type of a record.
    """

    def __init__(self, bus: str) -> None:
        """Map the file with the observations of a running controller.

        Raises:
            BusError: no controller writes observations for this bus, or the version of the
                controller is different.
        """
        self._path: Path = observations_path(bus)
        try:
            with open(self._path, "rb") as file:
                self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError):
            raise BusError("no observations", f"bus {bus}", "a running handctl run") from None
        if len(self._map) < HEADER_STRUCT.size or self._map[:8] != OBSERVATION_FILE_MAGIC:
            self._map.close()
            raise BusError(
                "no observations of this version", f"bus {bus}", "a controller of the same version"
            )
        _, length, self._size, self._records, _, _ = HEADER_STRUCT.unpack_from(self._map)
        self._ring_at = -(-(HEADER_STRUCT.size + length) // PAGE_BYTES) * PAGE_BYTES
        self.description: dict[str, Any] = json.loads(
            self._map[HEADER_STRUCT.size : HEADER_STRUCT.size + length]
        )
        self.kind = observation_dtype(self.description["axes"])
        self.last_read_number = 0

    @property
    def written_count(self) -> int:
        """Return the number of records written so far."""
        return int.from_bytes(self._map[WRITTEN_COUNT_OFFSET : WRITTEN_COUNT_OFFSET + 8], "little")

    @property
    def has_run_ended(self) -> bool:
        """Return True if the run has ended."""
        return self._map[END_MARK_OFFSET] != 0

    def latest_record(self) -> NDArray[np.void] | None:
        """Return the latest record as an array of shape (), or None before the first record."""
        for _ in range(MAX_COPY_ATTEMPTS):
            written_count = self.written_count
            if written_count == 0:
                return None
            record = self.read_record(written_count - 1)
            if record is not None:
                self.last_read_number = written_count
                return record
        return None

    def next_record(self) -> NDArray[np.void] | None:
        """Return the record that follows the record returned by the previous call.

        If the next record has not been written yet, return None. If the next record has already
        been overwritten, return the oldest usable record in the ring.
        """
        for _ in range(MAX_COPY_ATTEMPTS):
            written_count = self.written_count
            # The reader does not use the oldest record in the ring, because the controller can
            # overwrite this record at any time.
            record_index = max(self.last_read_number, written_count - self._records + 2)
            if record_index >= written_count:
                return None
            record = self.read_record(record_index)
            if record is not None:
                self.last_read_number = record_index + 1
                return record
        return None

    def read_record(self, record_index: int) -> NDArray[np.void] | None:
        """Return the record with the number ``record_index``.

        If the ring buffer does not contain this record, return None.
        """
        start = self._ring_at + self._size * (record_index % self._records)
        data = self._map[start : start + self._size]
        bytes_after = self._map[start : start + 8]
        complete_counter = (2 * record_index + 2).to_bytes(8, "little")
        if data[:8] != complete_counter or bytes_after != complete_counter:
            return None
        return np.frombuffer(data, self.kind, 1, 8).reshape(())

    def close(self) -> None:
        """Unmap the file with the observations."""
        with contextlib.suppress(BufferError):
            self._map.close()
