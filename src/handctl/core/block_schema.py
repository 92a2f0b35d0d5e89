"""Blocks of numbers in contiguous memory, divided into tables by a schema.

A schema is a list of fields. A field is one row or several rows of a table. Each table has an axis:
for example, a row of the table ``tendon`` has one number per tendon. The declaration of a field
returns the index of the field's first row. Compiled code and the controller find the field by the
index of its first row::

    TENSION = STATE.declare_real_field("tension", "tendon", "N", "estimated tension")
    x.tendon[TENSION, n]

A block is one array of float64 that contains all tables of a schema. An integer table is a part of
the block in which the bits of each element are read as int64. The name of an integer table ends
with ``_int``. A layout belongs to a given hand, and contains the lengths of the axes and the
positions of the tables in a block. Because a block is one array, it can be copied by one operation
and stored as bytes. Two blocks can be compared field by field.
"""

import functools
import hashlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

BlockArray = NDArray[np.float64]
"""Array with all tables of a schema, in the order of the schema."""
TableOffsets = NDArray[np.int64]
"""Positions of tables: lengths of the axes, position of the first element of each table, and end of the last table."""

INTEGER_TABLE_SUFFIX = "_int"
"""Ending of the names of integer tables."""


class BlockField(NamedTuple):
    """Declaration of a quantity in a block.

    Attributes:
        name: name of the quantity.
        table: name of the table that contains the quantity.
        first_row: index of the first row in the table.
        rows: number of rows of the quantity.
        unit: SI unit of the quantity, or an empty text if it has no unit.
        meaning: description of the quantity.
        initial: value of the quantity before the first tick.
    """

    name: str
    table: str
    first_row: int
    rows: int
    unit: str
    meaning: str
    initial: float


class BlockSchema:
    """List of the tables and fields of a block, with the declaration of each field.

    Attributes:
        tables: names of the tables, in the order of the memory. The name of a table is the name of
            an axis, or the names of several axes joined by ``*``. The name of an integer table ends
            with ``_int``.
        optional_axis: name of the only axis that is allowed to have the length 0, or an empty text
            if every axis needs a length of at least 1. An optional axis of length 0 has no effect
            on ``BlockLayout.identity``.
        fields: all fields, in the order of declaration.
    """

    def __init__(self, *tables: str, optional_axis: str = "") -> None:
        """Create a schema without fields.

        Args:
            tables: names of the tables in memory order.
            optional_axis: name of the only axis that is allowed to have the length 0, see the
                attributes of the class.
        """
        self.tables = tables
        self.optional_axis = optional_axis
        self.fields: list[BlockField] = []
        self._rows = dict.fromkeys(tables, 0)

    def declare_real_field(
        self,
        name: str,
        axis_name: str,
        unit: str,
        meaning: str,
        rows: int = 1,
        initial: float = 0.0,
    ) -> int:
        """Declare a field of float64 numbers, and return the index of its first row."""
        return self._declare_field(
            BlockField(name, axis_name, self._rows[axis_name], rows, unit, meaning, initial)
        )

    def declare_integer_field(
        self, name: str, axis_name: str, unit: str, meaning: str, rows: int = 1, initial: int = 0
    ) -> int:
        """Declare a field of int64 numbers, and return the index of its first row."""
        table = axis_name + INTEGER_TABLE_SUFFIX
        return self._declare_field(
            BlockField(name, table, self._rows[table], rows, unit, meaning, initial)
        )

    def _declare_field(self, field: BlockField) -> int:
        self.fields.append(field)
        self._rows[field.table] += field.rows
        return field.first_row

    def layout(self, axes: Mapping[str, int]) -> "BlockLayout":
        """Return the layout of the schema's tables, for given lengths of the axes.

        Layouts with equal axes are the same object, because a search for gains builds thousands of
        models of one hand.
        """
        return _layout_of_fields(self, len(self.fields), tuple(axes.items()))

    def rows(self, table_name: str) -> int:
        """Return the number of rows of a table."""
        return self._rows[table_name]


@functools.lru_cache(maxsize=64)
def _layout_of_fields(
    schema: BlockSchema, field_count: int, axes: tuple[tuple[str, int], ...]
) -> "BlockLayout":
    """Return the layout of a schema with the given number of declared fields."""
    assert len(schema.fields) == field_count
    return BlockLayout(schema, dict(axes))


class BlockLayout:
    """Positions of the tables of a schema in a block, for given lengths of the axes.

    Attributes:
        schema: schema with the tables and fields.
        axes: length of each axis.
        offsets: lengths of the axes, position of the first element of each table, and end of the
            last table. Compiled code reads the array ``offsets``.
        starts: position of the first element of each table in a block, by name of the table.
        size: number of elements of a block.
        identity: 8-byte hash of all fields and of the lengths of all axes.
        initial: block before the first tick, read-only.
    """

    def __init__(self, schema: BlockSchema, axes: Mapping[str, int]) -> None:
        """Compute the positions of all tables and fields in a block.

        Args:
            schema: schema with the tables and fields.
            axes: length of each axis, in the order in which compiled code indexes ``offsets``.
        """
        self.schema = schema
        self.axes = dict(axes)
        omitted_axis = ""
        if schema.optional_axis:
            self.axes.setdefault(schema.optional_axis, 0)
            omitted_axis = "" if self.axes[schema.optional_axis] else schema.optional_axis
        table_widths = {table: self._table_width(table) for table in schema.tables}
        end_offsets = np.cumsum(
            [0, *(schema.rows(table) * table_widths[table] for table in schema.tables)]
        )
        self.size = int(end_offsets[-1])
        layout_text = repr((
            {axis: length for axis, length in self.axes.items() if axis != omitted_axis},
            tuple(table for table in schema.tables if table != omitted_axis),
            [field[:4] for field in schema.fields if field.table != omitted_axis],
        ))  # fmt: skip
        self.identity = hashlib.blake2b(layout_text.encode(), digest_size=8).digest()
        self.offsets: TableOffsets = np.concatenate((list(self.axes.values()), end_offsets)).astype(
            np.int64
        )
        table_spans = zip(
            schema.tables, end_offsets[:-1].tolist(), end_offsets[1:].tolist(), strict=True
        )
        self._tables = {
            table: (first_offset, end, table_widths[table], table.endswith(INTEGER_TABLE_SUFFIX))
            for table, first_offset, end in table_spans
        }
        self.starts = {table: span[0] for table, span in self._tables.items()}
        self._shapes = {
            table: (
                (schema.rows(table), width),
                np.dtype(np.int64 if is_integer else np.float64),
                8 * first_offset,
            )
            for table, (first_offset, _, width, is_integer) in self._tables.items()
        }
        self._fields = {field.name: self._field_span(field) for field in schema.fields}
        self.initial: BlockArray = np.zeros(self.size)
        for field in schema.fields:
            self.view(self.initial, field.name)[...] = field.initial
        self.initial.flags.writeable = False

    def _table_width(self, table_name: str) -> int:
        return int(
            np.prod([self.axes[axis] for axis in _axes_of_table(table_name)], dtype=np.int64)
        )

    def _field_span(self, field: BlockField) -> tuple[int, int, tuple[int, ...], bool]:
        """Return first element, end and shape of a field in a block, and True if the field contains integers."""
        start, _, width, is_integer = self._tables[field.table]
        shape = tuple(self.axes[axis] for axis in _axes_of_table(field.table))
        first_offset = start + field.first_row * width
        return (
            first_offset,
            first_offset + field.rows * width,
            shape if field.rows == 1 else (field.rows, *shape),
            is_integer,
        )

    def view(self, block: BlockArray, name: str) -> NDArray[Any]:
        """Return a view of a field in a block.

        The view of a field with several rows has the shape (rows, *axes), where ``axes`` are the
        lengths of the axes of the table. The view of a field with a single row has the shape
        (*axes), without an axis for the rows.
        """
        first_offset, end, shape, is_integer = self._fields[name]
        table_elements = block[first_offset:end]
        return (table_elements.view(np.int64) if is_integer else table_elements).reshape(shape)

    def axis_name_of_field(self, name: str) -> str:
        """Return the names of all axes of a field's table, joined by ``*``.

        For a field in a table with the axes ``a`` and ``b``, the result is ``a*b``.
        """
        return next(field.table for field in self.schema.fields if field.name == name).removesuffix(
            INTEGER_TABLE_SUFFIX
        )

    def table(self, block: BlockArray, name: str) -> NDArray[Any]:
        """Return a view of a table in a block, with the shape (rows, length of the axis)."""
        shape, kind, offset = self._shapes[name]
        return np.ndarray(
            shape, kind, block, offset
        )  # one call creates the view, because every tick creates several views

    def first_difference(
        self, block: BlockArray, other_block: BlockArray
    ) -> tuple[str, int, float, float] | None:
        """Return the first difference between two blocks.

        The result contains the name of the field, the index of the element in the field, and both
        values. If the blocks are equal, return None. The comparison uses the bits of the values, so
        NaN equals NaN, and 0.0 differs from -0.0.
        """
        # The numbers are compared as integers, so NaN equals NaN, and 0.0 differs from -0.0.
        differing_elements = np.flatnonzero(block.view(np.int64) != other_block.view(np.int64))
        if not len(differing_elements):
            return None
        for field in self.schema.fields:
            first_offset, end, _, is_integer = self._fields[field.name]
            differing_in_field = differing_elements[
                (differing_elements >= first_offset) & (differing_elements < end)
            ]
            if len(differing_in_field):
                kind = np.int64 if is_integer else np.float64
                at = int(differing_in_field[0])
                return (
                    field.name,
                    at - first_offset,
                    block.view(kind)[at].item(),
                    other_block.view(kind)[at].item(),
                )
        raise AssertionError("a difference outside of all fields")


def _axes_of_table(table_name: str) -> list[str]:
    """Return the names of a table's axes."""
    return table_name.removesuffix(INTEGER_TABLE_SUFFIX).split("*")
