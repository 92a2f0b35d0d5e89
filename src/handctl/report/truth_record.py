"""Reader of the truth file, in which the simulator writes the true values of a run.

The controller never opens the truth file.
"""

import json
import os
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from handctl.errors import LogError
from handctl.log.read.reader import RunLog

ROWS_PER_BLOCK = 16384
"""Largest number of rows that a copy of a truth file has in memory at a time."""


@dataclass(frozen=True, slots=True)
class TruthRecord:
    """True values of the simulated plant during a run.

    Attributes:
        header: content of the first line of the truth file.
        t_ns: (rows,) time on the clock of the simulator [ns].
        values: (rows, columns) float64, true values at each time.
        columns: names of the columns, e.g. `tension/index_tendon`, `q/index_j1`, `object/x`.
    """

    header: dict[str, object]
    t_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    columns: tuple[str, ...]

    def has_column(self, name: str) -> bool:
        """Return True if the record has a column with this name."""
        return name in self.columns

    def contains_any_time(self, t_ns: NDArray[np.int64]) -> bool:
        """Return True if at least one of the given times lies within the record."""
        return bool(((t_ns >= self.t_ns[0]) & (t_ns <= self.t_ns[-1])).any())

    def interpolated_column(self, name: str, t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return a column of the record, interpolated at times on the clock of the simulator [ns].

        At times outside of the record, the result is NaN.

        Raises:
            LogError: the column is missing, for example because the truth file is of another hand.
        """
        if name not in self.columns:
            raise LogError(
                f"no column {name!r}", "the simulator's truth", "a truth file of the same hand"
            )
        values = self.values[:, self.columns.index(name)]
        # The difference of two int64 times is exact in float64. The two int64 times themselves are
        # too large to be exact in float64.
        base = int(self.t_ns[0])
        return np.interp(
            (t_ns - base).astype(np.float64),
            (self.t_ns - base).astype(np.float64),
            values,
            left=np.nan,
            right=np.nan,
        )

    def interpolated_columns(
        self, column_names: list[str], t_ns: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Return the columns with the given names, interpolated at the given times.

        The result has the shape (times, columns). The times are on the clock of the simulator [ns].
        """
        return np.column_stack([self.interpolated_column(name, t_ns) for name in column_names])


def read_truth(path: Path) -> TruthRecord:
    """Read a truth file: one line of JSON, and then rows of an int64 time [ns] and float64 columns.

    Raises:
        LogError: the file is missing or is not a truth file.
    """
    try:
        if path.exists() and not path.is_file():
            raise LogError("cannot be read: not a file", str(path), "the simulator's truth file")
        with path.open("rb") as file:
            header = json.loads(file.readline())
            columns = tuple(str(name) for name in header["columns"])
            rows = np.frombuffer(
                _complete_rows(file.read(), len(columns)),
                [("t_ns", "<i8"), ("v", "<f8", (len(columns),))],
            )
    except OSError as error:
        raise LogError(
            f"cannot be read: {error.strerror}", str(path), "the simulator's truth file"
        ) from None
    except (ValueError, KeyError, TypeError) as error:
        raise LogError(
            f"is not a truth file: {error}", str(path), "a JSON line and float64 rows"
        ) from None
    if not len(rows):
        raise LogError("is empty", str(path), "at least one row of truth")
    return TruthRecord(header, rows["t_ns"].copy(), rows["v"].copy(), columns)


def copy_truth(source_path: Path, target_path: Path, start_ns: int, end_ns: int) -> int:
    """Copy the rows of a truth file that are between two times, and return the number of copied rows.

    The truth file of a simulator can contain many runs. Because the simulator writes 1.6 GB per
    hour, this function reads only the rows that it copies. If there are no rows between the two
    times, no file is written.

    Args:
        source_path: truth file of a simulator. The simulator is allowed to write to this file
            during the copy.
        target_path: new file.
        start_ns: first time to copy, on the simulator's clock [ns].
        end_ns: last time to copy, on the simulator's clock [ns].

    Raises:
        LogError: the source is not a truth file.
        OSError: a file cannot be read or written.
    """
    with source_path.open("rb") as file:
        header_line = file.readline()
        try:
            bytes_per_row = 8 * (len(json.loads(header_line)["columns"]) + 1)
        except (ValueError, KeyError, TypeError) as error:
            expected = "a JSON line and float64 rows"
            raise LogError(f"is not a truth file: {error}", str(source_path), expected) from None
        row_count = (file.seek(0, os.SEEK_END) - len(header_line)) // bytes_per_row

        def time_of_row(row: int) -> int:
            file.seek(len(header_line) + bytes_per_row * row)
            return int.from_bytes(file.read(8), "little", signed=True)

        first_row = bisect_left(range(row_count), start_ns, key=time_of_row)
        end_row = bisect_right(range(row_count), end_ns, lo=first_row, key=time_of_row)
        if first_row == end_row:
            return 0
        file.seek(len(header_line) + bytes_per_row * first_row)
        with target_path.open("wb") as copy:
            copy.write(header_line)
            for row in range(first_row, end_row, ROWS_PER_BLOCK):
                copy.write(file.read(bytes_per_row * min(ROWS_PER_BLOCK, end_row - row)))
    return end_row - first_row


def truth_file_path(log_path: Path) -> Path:
    """Return the path of the truth file that a lockstep run writes next to its log."""
    return log_path.with_suffix(".truth")


def find_truth(given_file: Path | None, log_path: Path, log: RunLog) -> TruthRecord | None:
    """Return the true values of a run.

    The true values come from the file that the user has named. If the user has named no file, the
    true values come from the file next to the log of a lockstep run. If there is no truth file of
    the run, return None.

    Args:
        given_file: truth file that the user has named, or None if the user has named no file.
        log_path: path of the log.
        log: open log of the run.

    Raises:
        LogError: the named file belongs to another run, or a truth file cannot be read.
    """
    file_next_to_log = truth_file_path(log_path)
    if given_file is None and not (log.header.deterministic and file_next_to_log.is_file()):
        return None
    truth = read_truth(given_file or file_next_to_log)
    if truth.contains_any_time(log.t_ns + log.header.truth_offset_ns):
        return truth
    if given_file is None:
        return None
    problem = "was recorded at another time than the log"
    raise LogError(problem, str(given_file), "the truth of the same run, in lockstep")


def _complete_rows(file_content: bytes, column_count: int) -> bytes:
    """Return the given bytes without an incomplete last row.

    If a simulator is killed, the last row in its truth file can be incomplete.
    """
    size = 8 * (column_count + 1)
    return file_content[: len(file_content) // size * size]
