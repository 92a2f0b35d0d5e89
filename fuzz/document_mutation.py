"""Convert the random bytes of a fuzzer to nearly valid documents.

Without the conversion, the random bytes would never pass the first check of a parser.
"""

import struct
from collections.abc import Iterator, Mapping
from typing import Any

UNUSUAL_VALUES = (
    float("nan"), float("inf"), -0.0, 0, -1, 1, True, "", "x\ny", [], {}, [[]], [{}], 2**70, 1e308, -1e-320, 1e9,
    {"name": 3}, [1, 2, 3, 4], "main", "mit", "index", 10**400,
)  # fmt: skip
OPERATION_COUNT = 8
KeyPath = tuple[Any, ...]


def paths_of_values(document_node: Any, node_path: KeyPath = ()) -> Iterator[KeyPath]:
    """Yield the path (keys and indices) of every value below a node of a document.

    Tables and lists also count as values.
    """
    entries = (
        document_node.items()
        if isinstance(document_node, Mapping)
        else enumerate(document_node)
        if isinstance(document_node, list)
        else ()
    )
    for key, value in entries:
        yield (*node_path, key)
        yield from paths_of_values(value, (*node_path, key))


class ByteSource:
    """Reader of the bytes that a fuzzer has generated.

    Each call of the reader consumes the next bytes. After the last byte, the reader returns zeros.
    """

    def __init__(self, data: bytes) -> None:
        """Create a reader that starts at the first byte of the data."""
        self.data = data
        self.at = 0

    def take_bytes(self, byte_count: int) -> bytes:
        """Consume ``byte_count`` bytes, and return these bytes."""
        self.at += byte_count
        return self.data[self.at - byte_count : self.at].ljust(byte_count, b"\0")

    def take_number(self, upper_limit: int) -> int:
        """Consume bytes, and return a number from 0 to ``upper_limit`` - 1."""
        return int.from_bytes(self.take_bytes(2), "little") % upper_limit

    @property
    def is_empty(self) -> bool:
        """Return True if all bytes are consumed."""
        return self.at >= len(self.data)


def replacement_value(source: ByteSource, old_value: Any) -> Any:
    """Return a replacement for a value: an unusual value, random bits, or the scaled old value."""
    kind = source.take_number(5)
    if kind == 0:
        return struct.unpack("<d", source.take_bytes(8))[0]
    if kind == 1:
        return source.take_bytes(source.take_number(12)).decode("latin-1")
    if kind == 2 and isinstance(old_value, int | float) and -1e300 < old_value < 1e300:
        return old_value * (1000.0, 0.001, -1.0, 1.0001, 2.0)[source.take_number(5)]
    if kind == 3:
        return int.from_bytes(source.take_bytes(3), "little", signed=True)
    return UNUSUAL_VALUES[source.take_number(len(UNUSUAL_VALUES))]


def mutated_content(
    content: Mapping[str, Any], paths: list[KeyPath], source: ByteSource, max_changes: int = 4
) -> dict[str, Any]:
    """Return a copy of a document in which some values are changed, removed, renamed or repeated.

    Args:
        content: parsed TOML file, which the function does not change.
        paths: paths of all values of the content, see ``paths_of_values``.
        source: reader of the bytes that select the changes.
        max_changes: maximum number of changes.
    """
    mutated: dict[str, Any] = dict(content)
    for _ in range(max_changes):
        if source.is_empty:
            break
        path = paths[source.take_number(len(paths))]
        parent = _copy_node(mutated, path[:-1])
        if parent is not None:
            _mutate_entry(parent, path[-1], source)
    return mutated


def _copy_node(root_table: dict[str, Any], node_path: KeyPath) -> Any:
    """Replace each node on a path of a document by a copy, and return the copy at the end of the path.

    An earlier mutation may have removed a node of the path from the document. If so, return None.
    """
    node: Any = root_table
    for key in node_path:
        try:
            child = node[key]
        except (LookupError, TypeError):
            return None
        if not isinstance(child, dict | list):
            return None
        copied_child = child.copy()
        node[key] = copied_child
        node = copied_child
    return node


def _mutate_entry(parent_node: Any, entry_key: Any, source: ByteSource) -> None:
    try:
        old_entry = parent_node[entry_key]
    except (LookupError, TypeError):
        return
    operation = source.take_number(OPERATION_COUNT)
    if operation == 0:
        del parent_node[entry_key]
    elif operation == 1 and isinstance(parent_node, dict):
        parent_node[str(entry_key) + chr(97 + source.take_number(26))] = parent_node.pop(entry_key)
    elif operation == 2 and isinstance(parent_node, list):
        parent_node.insert(entry_key, old_entry)
    elif operation == 3 and isinstance(parent_node, list):
        parent_node.reverse()
    else:
        parent_node[entry_key] = replacement_value(source, old_entry)
