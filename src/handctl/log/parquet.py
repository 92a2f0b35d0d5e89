"""A log as a Parquet table: one row a tick, one column a number, text as dictionaries."""

from pathlib import Path

import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]

from handctl.log.export import WORDS, blocks, columns
from handctl.log.reader import RunLog


def export_parquet(log: RunLog, path: Path) -> int:
    """Write the table with the run's metadata in its schema; the number of rows.

    Raises:
        OSError: the file is there already or cannot be written.
    """
    count, names = 0, columns(log)
    text = pa.dictionary(pa.int32(), pa.string())
    fields = [pa.field(name, pa.int64()) for name in ("k", "t_ns", "late_ns")]
    fields += [pa.field(name, text) for name in WORDS] + [pa.field(name, pa.float64()) for name in names]
    schema = pa.schema(fields, metadata={f"handctl.{key}": value for key, value in log.header.metadata.items()})
    with path.open("xb") as file, pq.ParquetWriter(file, schema, compression="zstd") as writer:
        for block in blocks(log):
            arrays = [pa.array(part) for part in block[:3]]
            arrays += [pa.array(part, pa.string()).dictionary_encode() for part in block[3:6]]
            arrays += [pa.array(column) for column in block.numbers.T]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            count += len(block.k)
    return count
