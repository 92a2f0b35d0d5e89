"""A block of numbers with a schema: rows over tendons, joints, digits and so on, in one contiguous piece of memory.

A schema is a list of fields. A field is one or more rows of a table, and a table has an axis: a row of the table
``tendon`` has a number per tendon. Declaring a field returns the index of its first row, by which kernels and
controller find it::

    TENSION = STATE.real("tension", "tendon", "N", "estimated tension")
    x.tendon[TENSION, n]

All tables of a schema lie in one array of float64. Tables of whole numbers are the same memory seen as int64, and their
names end in ``_int``. A layout fixes the lengths of the axes for one hand. Copying a block is copying one array, its
bytes are its snapshot, and comparing two blocks names the first field that differs.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Block = NDArray[np.float64]
"""All tables of a schema, one after the other."""
Places = NDArray[np.int64]
"""Lengths of the axes, and the first element of each table and the end of the last; the form that kernels read."""

INT = "_int"
"""Ending of the names of tables of whole numbers."""


class Field(NamedTuple):
    """One quantity.

    Attributes:
        name: of the quantity. table: it is in. first: its first row there. rows: how many it has.
        unit: SI, empty for none. meaning: what it is.
        initial: value before the first tick.
    """

    name: str
    table: str
    first: int
    rows: int
    unit: str
    meaning: str
    initial: float


class Schema:
    """Fields of a block.

    Attributes:
        tables: names of the tables in the order in which they lie in memory, each the name of its axis, or of its axes
            joined by ``*``, with ``_int`` at the end for whole numbers.
        fields: all fields, in the order of their declaration.
    """

    def __init__(self, *tables: str) -> None:
        self.tables = tables
        self.fields: list[Field] = []
        self._rows = dict.fromkeys(tables, 0)

    def real(self, name: str, axis: str, unit: str, meaning: str, rows: int = 1, initial: float = 0.0) -> int:
        """Declare a field of float64 and return its first row."""
        return self._declare(Field(name, axis, self._rows[axis], rows, unit, meaning, initial))

    def whole(self, name: str, axis: str, unit: str, meaning: str, rows: int = 1, initial: int = 0) -> int:
        """Declare a field of int64 and return its first row."""
        table = axis + INT
        return self._declare(Field(name, table, self._rows[table], rows, unit, meaning, initial))

    def _declare(self, field: Field) -> int:
        self.fields.append(field)
        self._rows[field.table] += field.rows
        return field.first

    def layout(self, axes: Mapping[str, int]) -> "Layout":
        """Lay the tables out for these lengths of the axes."""
        return Layout(self, axes)

    def rows(self, table: str) -> int:
        """Return the number of rows of a table."""
        return self._rows[table]


class Layout:
    """Where the tables of a schema are in a block, for axes of given lengths.

    Attributes:
        schema: whose.
        axes: length of each axis.
        places: the same for kernels: lengths of the axes, first element of each table, end of the last.
        size: elements of a block.
        initial: block before the first tick; read-only.
    """

    def __init__(self, schema: Schema, axes: Mapping[str, int]) -> None:
        self.schema, self.axes = schema, dict(axes)
        ends = np.cumsum([0, *(schema.rows(table) * self._width(table) for table in schema.tables)])
        self.size = int(ends[-1])
        self.places: Places = np.concatenate((list(self.axes.values()), ends)).astype(np.int64)
        self._start = dict(zip(schema.tables, ends[:-1].tolist(), strict=True))
        self._by_name = {field.name: field for field in schema.fields}
        self.initial: Block = np.zeros(self.size)
        for field in schema.fields:
            self._rows_of(self.initial, field)[...] = field.initial
        self.initial.flags.writeable = False

    def _width(self, table: str) -> int:
        return int(np.prod([self.axes[axis] for axis in table.removesuffix(INT).split("*")], dtype=np.int64))

    def _rows_of(self, block: Block, field: Field) -> NDArray[np.float64]:
        width = self._width(field.table)
        start = self._start[field.table] + field.first * width
        rows = block[start : start + field.rows * width]
        return (rows.view(np.int64) if field.table.endswith(INT) else rows).reshape(field.rows, width)

    def view(self, block: Block, name: str) -> NDArray[np.float64]:
        """Return a field of a block: (rows, ...) or, of a single row, its axes alone; changes go into the block."""
        field = self._by_name[name]
        shape = tuple(self.axes[axis] for axis in field.table.removesuffix(INT).split("*"))
        rows = self._rows_of(block, field)
        return rows.reshape(shape) if field.rows == 1 else rows.reshape(field.rows, *shape)

    def start(self, table: str) -> int:
        """Return the first element of a table in a block."""
        return self._start[table]

    def table(self, block: Block, name: str) -> NDArray[np.float64]:
        """Return a table of a block, (rows, length of its axis); changes go into the block."""
        width = self._width(name)
        start = self._start[name]
        part = block[start : start + self.schema.rows(name) * width]
        return (part.view(np.int64) if name.endswith(INT) else part).reshape(-1, width)

    def difference(self, one: Block, other: Block) -> tuple[str, int, float, float] | None:
        """Return the first difference of two blocks in the order of the schema: field, element, and both values.

        Values are compared by their bits, so that NaN equals NaN; None if the blocks are the same.
        """
        apart = np.flatnonzero(one.view(np.int64) != other.view(np.int64))
        if not len(apart):
            return None
        changed = set(apart.tolist())
        for field in self.schema.fields:
            width = self._width(field.table)
            start = self._start[field.table] + field.first * width
            inside = sorted(at for at in range(start, start + field.rows * width) if at in changed)
            if inside:
                kind = np.int64 if field.table.endswith(INT) else np.float64
                at = inside[0]
                return field.name, at - start, one.view(kind)[at].item(), other.view(kind)[at].item()
        raise AssertionError("a difference outside of all fields")
