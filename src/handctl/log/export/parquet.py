"""Export of a log as a Parquet table.

The table has one row for each tick. Each column contains one value of all ticks, such as the tension of a tendon.

Columns with text are dictionary-encoded: a text that occurs several times in a column is stored
only once. The metadata of a numeric column contain the unit under the key `unit`.
"""

from pathlib import Path

import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]

from handctl.log.export.csv_and_candump import (
    INTEGER_COLUMNS,
    TEXT_COLUMNS,
    column_names,
    column_unit,
    table_blocks,
)
from handctl.log.read.hand_in_log import prismatic_joints
from handctl.log.read.reader import RunLog


def export_parquet(log: RunLog, path: Path) -> int:
    """Write the table of a log, and return the number of rows.

    The schema contains the metadata of the run.

    Raises:
        OSError: the file already exists or cannot be written.
    """
    count = 0
    names = column_names(log)
    prismatic = prismatic_joints(log.header)
    text = pa.dictionary(pa.int32(), pa.string())
    fields = [
        pa.field(name, pa.int64(), metadata={"unit": column_unit(name)}) for name in INTEGER_COLUMNS
    ]
    fields += [pa.field(name, text) for name in TEXT_COLUMNS]
    fields += [
        pa.field(name, pa.float64(), metadata={"unit": column_unit(name, prismatic)})
        for name in names
    ]
    schema = pa.schema(
        fields, metadata={f"handctl.{key}": value for key, value in log.header.metadata.items()}
    )
    with path.open("xb") as file, pq.ParquetWriter(file, schema, compression="zstd") as writer:
        for block in table_blocks(log):
            arrays = [pa.array(integer_column) for integer_column in block[:3]]
            arrays += [
                pa.array(text_column, pa.string()).dictionary_encode() for text_column in block[3:6]
            ]
            arrays += [pa.array(column) for column in block.numbers.T]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            count += len(block.k)
    return count
