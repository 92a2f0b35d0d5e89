"""Conversion between Rerun's chunks and numpy arrays: times, numbers and columns."""

from collections.abc import Iterable

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from numpy.typing import NDArray
from rerun import ComponentColumn, TimeColumn
from rerun.chunk import Chunk

RUN_TIME_TIMELINE = "run_time"
"""Name of the timeline with the time since the start of the run, as in `RunLog.times`."""
LOG_TIME_TIMELINE = "message_log_time"
"""Name of the timeline on which Rerun's MCAP reader puts log times."""
_INDEX_KIND = b"index"

TimesNs = NDArray[np.int64]
FloatArray = NDArray[np.float64]


def times_since_start(chunk: Chunk, offset_ns: int) -> TimesNs:
    """Return the times (n,) [ns] of the rows of a chunk, counted from the start of the run."""
    return (
        np.asarray(chunk.to_record_batch().column(LOG_TIME_TIMELINE).cast(pa.int64())) - offset_ns
    )


def temporal_chunk(entity_path: str, times: TimesNs, columns: Iterable[ComponentColumn]) -> Chunk:
    """Create a chunk whose rows have times.

    Args:
        entity_path: path of the entity to which the rows belong.
        times: (n,) time of each row since the start of the run [ns].
        columns: components of the entity, with a value for each row.
    """
    return Chunk.from_columns(
        entity_path,
        [TimeColumn(RUN_TIME_TIMELINE, duration=times.astype("timedelta64[ns]"))],
        columns,
    )


def static_chunk(entity_path: str, columns: Iterable[ComponentColumn]) -> Chunk:
    """Create a chunk with a single row, which is valid at all times."""
    return Chunk.from_columns(entity_path, [], columns)


def chunk_with_run_times(chunk: Chunk, offset_ns: int) -> Chunk:
    """Convert the times of a chunk from Rerun's MCAP reader to times since the start of the run.

    A chunk without times is returned unchanged.
    """
    if LOG_TIME_TIMELINE not in chunk.timeline_names:
        return chunk
    batch = chunk.to_record_batch()
    fields = []
    columns = []
    for field, column in zip(batch.schema, batch.columns, strict=True):
        if field.name == LOG_TIME_TIMELINE:
            column = pa.array(times_since_start(chunk, offset_ns)).cast(pa.duration("ns"))
            field = pa.field(
                RUN_TIME_TIMELINE,
                column.type,
                metadata=field.metadata | {b"rerun:index_name": RUN_TIME_TIMELINE.encode()},
            )
        # Rerun marks the column of each timeline as an index. This function removes all timelines
        # except the timeline of the run.
        elif (field.metadata or {}).get(b"rerun:kind") == _INDEX_KIND:
            continue
        fields.append(field)
        columns.append(column)
    schema = pa.schema(fields, metadata=batch.schema.metadata)
    (new_chunk,) = Chunk.from_record_batch(pa.RecordBatch.from_arrays(columns, schema=schema))
    return new_chunk


def decoded_messages(chunk: Chunk) -> pa.StructArray | None:
    """Return the decoded messages of a chunk, one message for each row.

    If the chunk has no messages, return None.
    """
    batch = chunk.to_record_batch()
    for field, column in zip(batch.schema, batch.columns, strict=True):
        if field.name.endswith(":message"):
            return column.flatten()
    return None


def column_as_array(column: pa.ListArray) -> FloatArray:
    """Convert a column of n lists of equal length to an array (n, width)."""
    return np.asarray(column.flatten(), np.float64).reshape(len(column), -1)
