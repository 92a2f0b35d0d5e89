"""A hand's resolved content as TOML text, for the log: what is read back is the same hand."""

import json
from collections.abc import Mapping
from typing import Any

from handctl.printing import encodable


def toml_text(content: Mapping[str, Any]) -> str:
    """Write plain values, then tables, then arrays of tables; absent (None) values and empty tables are left out."""
    lines = _entries(content)
    for key, value in content.items():
        if isinstance(value, Mapping):
            lines += ["", f"[{key}]", *_entries(value)]
        elif _is_table_array(value):
            for table in value:
                lines += ["", f"[[{key}]]", *_entries(table, inline_tables=True)]
    return "\n".join(lines) + "\n"


def _entries(table: Mapping[str, Any], inline_tables: bool = False) -> list[str]:
    def is_entry(value: Any) -> bool:
        return bool(inline_tables and value) if isinstance(value, Mapping) else not _is_table_array(value)

    return [f"{key} = {_value(value)}" for key, value in table.items() if value is not None and is_entry(value)]


def _is_table_array(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(entry, Mapping) for entry in value)


def _value(value: Any) -> str:
    """One value; Python's repr of a float is the shortest text that reads back the same, and valid TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(entry) for entry in value) + "]"
    return repr(value)


def _quoted(text: str) -> str:
    """A basic string; what has no encoding in UTF-8 is escaped as text, since TOML has no escape for it."""
    return json.dumps(encodable(text), ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(key: str) -> str:
    return key if key.isascii() and key.replace("_", "").replace("-", "").isalnum() else _quoted(key)
