"""TOML text of a hand's resolved content, for the log. A hand that is read from the text is equal."""

import json
from collections.abc import Mapping
from typing import Any

from handctl.printing import escape_surrogates


def toml_text(content: Mapping[str, Any]) -> str:
    """Write plain values, then tables, then arrays of tables.

    None and empty tables are left out.
    """
    lines = _value_lines(content)
    for key, value in content.items():
        if isinstance(value, Mapping):
            lines += ["", f"[{key}]", *_value_lines(value)]
        elif _is_table_array(value):
            for table in value:
                lines += ["", f"[[{key}]]", *_value_lines(table, inline_tables=True)]
    return "\n".join(lines) + "\n"


def _value_lines(table: Mapping[str, Any], inline_tables: bool = False) -> list[str]:
    """Return the lines of a table's plain values."""

    def is_entry(value: Any) -> bool:
        """Return True for a value that is written in a line of its table."""
        return bool(inline_tables and value) if isinstance(value, Mapping) else not _is_table_array(value)

    return [f"{key} = {_value_text(value)}" for key, value in table.items() if value is not None and is_entry(value)]


def _is_table_array(value: Any) -> bool:
    """Return True for a non-empty list of tables."""
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(entry, Mapping) for entry in value)


def _value_text(value: Any) -> str:
    """Return one value. Python's repr of a float is the shortest exact text, and valid TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key_text(key)} = {_value_text(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value_text(entry) for entry in value) + "]"
    return repr(value)


def quoted(text: str) -> str:
    """Return a basic string.

    Characters without a UTF-8 encoding are escaped as text, since TOML has no escape for them.
    """
    return json.dumps(escape_surrogates(text), ensure_ascii=False).replace("\x7f", "\\u007f")


def _key_text(key: str) -> str:
    """Return a key, quoted if necessary."""
    return key if key.isascii() and key.replace("_", "").replace("-", "").isalnum() else quoted(key)
