"""The simulator's truth, for judging a run after it ended; the running controller never opens it."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from handctl.errors import LogError


@dataclass(frozen=True, slots=True)
class Truth:
    """What really happened in the plant.

    Attributes:
        header: the file's first line.
        t_ns: (rows,) time on the simulator's clock [ns].
        values: (rows, columns) float64.
        columns: names, e.g. ``tension/index_tendon``, ``q/index_j1``, ``object/x``.
    """

    header: dict[str, object]
    t_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    columns: tuple[str, ...]

    def has(self, name: str) -> bool:
        """Whether there is such a column."""
        return name in self.columns

    def covers(self, t_ns: NDArray[np.int64]) -> bool:
        """Whether any of these times is in the record."""
        return bool(((t_ns >= self.t_ns[0]) & (t_ns <= self.t_ns[-1])).any())

    def at(self, name: str, t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """A column, interpolated at times [ns on the simulator's clock]; NaN outside of the record.

        Raises:
            LogError: there is no such column: the truth is of another hand.
        """
        if name not in self.columns:
            raise LogError(f"no column {name!r}", "the simulator's truth", "a truth of the same hand")
        values = self.values[:, self.columns.index(name)]
        base = int(self.t_ns[0])
        return np.interp(
            (t_ns - base).astype(np.float64), (self.t_ns - base).astype(np.float64), values, left=np.nan, right=np.nan
        )

    def table(self, names: list[str], t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Several columns at times [ns], (times, names)."""
        return np.column_stack([self.at(name, t_ns) for name in names])


def read_truth(path: Path) -> Truth:
    """Read a truth file.

    Raises:
        LogError: it is not there or not a truth file.
    """
    try:
        if path.exists() and not path.is_file():
            raise LogError("cannot be read: not a file", str(path), "the simulator's truth file")
        with path.open("rb") as file:
            header = json.loads(file.readline())
            columns = tuple(str(name) for name in header["columns"])
            rows = np.frombuffer(
                _whole_rows(file.read(), len(columns)), [("t_ns", "<i8"), ("v", "<f8", (len(columns),))]
            )
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", str(path), "the simulator's truth file") from None
    except (ValueError, KeyError, TypeError) as error:
        raise LogError(f"is not a truth file: {error}", str(path), "a JSON line and float64 rows") from None
    if not len(rows):
        raise LogError("is empty", str(path), "at least one row of truth")
    return Truth(header, rows["t_ns"].copy(), rows["v"].copy(), columns)


def _whole_rows(data: bytes, columns: int) -> bytes:
    size = 8 * (columns + 1)
    return data[: len(data) // size * size]
