"""The truth file: a record of the true state of the plant, by default in every millisecond.

Tests compare the estimates of a controller with the truth file.

The truth file starts with a header line of JSON. The header line is padded with spaces to a fixed
size, so that the writer can complete it when the file is closed. Rows of data follow after the
header line. Each row consists of an int64 t_ns and of a float64 for each column, little-endian.
"""

import json
import os
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from firmware_sim.plant.plant import Plant

PERIOD_NS = 1_000_000
"""Default time from one row of the truth file to the next row [ns]."""
_HEADER_SIZE = 8192
"""Size of the header line [bytes]."""
_BUFFERED_ROW_COUNT = 256
"""Number of rows that the writer collects before it writes to the file."""
MIN_FREE_DISK_BYTES = 64 << 20
"""Free disk space below which the writer writes no more rows [bytes].

The run folder can be in memory, and a simulator can run for days.
"""
MAX_UNNAMED_FILE_BYTES = 1 << 30
"""Largest size of a truth file that no user has named [bytes].

A truth file of this size contains about 40 minutes of simulation.
"""


class TruthFile(NamedTuple):
    """Content of a truth file, in which a simulator records the true state of its plant.

    Attributes:
        header: content of the header line.
        t_ns: (rows,) time of each row [ns].
        values: (rows, columns) true values. ``header["units"]`` contains the unit of each column.
    """

    header: dict[str, Any]
    t_ns: npt.NDArray[np.int64]
    values: npt.NDArray[np.float64]

    def column(self, name: str) -> npt.NDArray[np.float64]:
        """Return the values (rows,) of the column with the given name."""
        return self.values[:, self.header["columns"].index(name)]


def truth_columns(plant: Plant) -> list[tuple[str, str]]:
    """List the name and the unit of every column of a plant's truth file."""
    hand = plant.hand
    column_names = [(f"tension/{tendon.name}", "N") for tendon in hand.tendons]
    prismatic_joints = {
        joint
        for digit in hand.digits
        for joint, is_prismatic in zip(digit.joints, digit.prismatic, strict=True)
        if is_prismatic
    }
    units = {joint: "m" if joint in prismatic_joints else "rad" for joint in hand.joints}
    column_names += [(f"q/{joint}", unit) for joint, unit in units.items()]
    column_names += [(f"dq/{joint}", f"{unit}/s") for joint, unit in units.items()]
    column_names += [(f"motor/{motor.name}", "rad") for motor in hand.motors]
    column_names += [(f"torque/{motor.name}", "N m") for motor in hand.motors]
    column_names += [
        (f"contact_force/{digit.name}/{axis}", "N") for digit in hand.digits for axis in "xyz"
    ]
    column_names += [(f"object/{axis}", "m") for axis in "xyz"]
    column_names += [
        (f"object/{quaternion_component}", "1") for quaternion_component in ("qw", "qx", "qy", "qz")
    ]
    column_names += [("slip", "m/s")]
    if plant.has_sinking_table:
        column_names += [("support", "m")]
    if plant.load:
        column_names += [("load", "N"), *[(f"normal/{digit.name}", "N") for digit in hand.digits]]
    column_names += [
        (f"tension/{pair.name}/{tendon_of_pair}", "N")
        for pair in hand.pairs
        for tendon_of_pair in ("first", "second")
    ]
    return column_names


class TruthWriter:
    """Writer of a truth file.

    All values of a row except the contact forces are the values at the time of the row. The contact
    forces are those of the previous step of the plant, 0.5 ms earlier.

    Attributes:
        period_ns: time from one row to the next row [ns].
        due_ns: plant time when the next row must be written [ns].
        full: True after the last row that fits into the file or on the disk. Later rows are
            discarded.
    """

    def __init__(
        self,
        path: Path,
        plant: Plant,
        header: dict[str, object],
        max_bytes: int = sys.maxsize,
        period_ns: int = PERIOD_NS,
    ) -> None:
        """Create the truth file.

        Args:
            path: path of the file.
            plant: plant whose true state is recorded.
            header: additional content of the header line.
            max_bytes: largest size of the file [bytes].
            period_ns: time from one row to the next row [ns]. A row is written at the end of a time
                step of the plant.
        """
        column_names = truth_columns(plant)
        self._header = {
            "columns": [name for name, _ in column_names],
            "units": [unit for _, unit in column_names],
            "period_ns": period_ns,
            **header,
        }
        # A row consists of an integer and of real numbers of the same size.
        self._rows = np.zeros((_BUFFERED_ROW_COUNT, 1 + len(column_names)), "<f8")
        self._times_ns = self._rows.view("<i8")[:, 0]
        self._row_count = 0
        self._file = path.open("wb", buffering=0)
        self.period_ns = period_ns
        self.due_ns = 0
        self.full = False
        self._max_bytes = max_bytes
        self._file.write(self._header_line(_HEADER_SIZE))

    def _header_line(self, size: int) -> bytes:
        """Return the header line, padded with spaces to a given size [bytes]."""
        return json.dumps(self._header).encode().ljust(size - 1) + b"\n"

    def write(self, t_ns: int, plant: Plant) -> None:
        """Write the present true state of the plant as a row."""
        self.due_ns += self.period_ns
        if self.full:
            return
        self._times_ns[self._row_count] = t_ns
        np.concatenate(plant.true_state(), out=self._rows[self._row_count, 1:])
        self._row_count += 1
        if self._row_count >= _BUFFERED_ROW_COUNT:
            self.flush()

    def flush(self) -> None:
        """Write the collected rows to the file, unless the disk is full or the file has its largest size."""
        data = self._rows[: self._row_count].tobytes()
        self._row_count = 0
        disk = os.fstatvfs(self._file.fileno())
        free_bytes = disk.f_bavail * disk.f_frsize
        has_space = (
            self._file.tell() + len(data) <= self._max_bytes and free_bytes >= MIN_FREE_DISK_BYTES
        )
        try:
            # If the disk becomes full during a write, an unbuffered file has written only the first
            # bytes of the data.
            is_written = not self.full and has_space and self._file.write(data) == len(data)
        except OSError:  # nothing could be written
            is_written = False
        self.full = not is_written

    def close(self, run_summary: dict[str, object]) -> None:
        """Write the collected rows, complete the header with a summary of the run, and close the file.

        The header states whether the last rows are missing because the file or the disk was full.
        """
        self.flush()
        self._header.update({**run_summary, "truncated": self.full})
        header_line = self._header_line(_HEADER_SIZE)
        if len(header_line) == _HEADER_SIZE:
            self._file.seek(0)
            self._file.write(header_line)
        self._file.close()


def read_truth(path: str | Path) -> TruthFile:
    """Read a truth file. The reader ignores an incomplete last row.

    Raises:
        ValueError: the file does not begin with a header.
    """
    header_line, newline, body = Path(path).read_bytes().partition(b"\n")
    if not newline:
        raise ValueError(f"{path}: not a truth file")
    header = json.loads(header_line)
    row = np.dtype([("t_ns", "<i8"), ("v", "<f8", (len(header["columns"]),))])
    rows = np.frombuffer(body, row, count=len(body) // row.itemsize)
    return TruthFile(header, rows["t_ns"], rows["v"])
