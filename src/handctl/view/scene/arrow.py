"""Between Rerun's chunks and numpy: times, numbers and columns."""

from collections.abc import Iterable

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from numpy.typing import NDArray
from rerun import ComponentColumn, TimeColumn
from rerun.chunk import Chunk

TIMELINE = "run_time"
"""Time since the start of the run, as ``RunLog.times``."""
LOG_TIME = "message_log_time"
_INDEX = b"index"

Times = NDArray[np.int64]
Floats = NDArray[np.float64]


def run_times(chunk: Chunk, offset_ns: int) -> Times:
    """(n,) time of each row of a chunk out of a log since the start of the run [ns]."""
    return np.asarray(chunk.to_record_batch().column(LOG_TIME).cast(pa.int64())) - offset_ns


def timed(entity: str, times: Times, columns: Iterable[ComponentColumn]) -> Chunk:
    """A new chunk of rows at these times since the start of the run [ns]."""
    return Chunk.from_columns(entity, [TimeColumn(TIMELINE, duration=times.astype("timedelta64[ns]"))], columns)


def static(entity: str, columns: Iterable[ComponentColumn]) -> Chunk:
    """A new chunk of one row that holds at all times."""
    return Chunk.from_columns(entity, [], columns)


def retimed(chunk: Chunk, offset_ns: int) -> Chunk:
    """The same chunk on the timeline of the run; a chunk without times as it is."""
    if LOG_TIME not in chunk.timeline_names:
        return chunk
    batch = chunk.to_record_batch()
    fields, columns = [], []
    for field, column in zip(batch.schema, batch.columns, strict=True):
        if field.name == LOG_TIME:
            column = pa.array(run_times(chunk, offset_ns)).cast(pa.duration("ns"))
            field = pa.field(TIMELINE, column.type, metadata=field.metadata | {b"rerun:index_name": TIMELINE.encode()})
        elif (field.metadata or {}).get(b"rerun:kind") == _INDEX:
            continue
        fields.append(field)
        columns.append(column)
    schema = pa.schema(fields, metadata=batch.schema.metadata)
    (new,) = Chunk.from_record_batch(pa.RecordBatch.from_arrays(columns, schema=schema))
    return new


def message(chunk: Chunk) -> pa.StructArray | None:
    """The decoded messages of a chunk, one a row; None if it holds something else."""
    batch = chunk.to_record_batch()
    for field, column in zip(batch.schema, batch.columns, strict=True):
        if field.name.endswith(":message"):
            return column.flatten()
    return None


def numbers(column: pa.ListArray) -> Floats:
    """(n, width) of a column of lists, all of one length."""
    return np.asarray(column.flatten(), np.float64).reshape(len(column), -1)
