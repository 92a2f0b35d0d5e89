"""TOML text of the resolved content of a hand file, for the log.

A hand that is read from the TOML text equals the original hand.
"""

import json
from collections.abc import Mapping
from typing import Any

from handctl.printing import escape_surrogates


def toml_text(content: Mapping[str, Any]) -> str:
    """Write content as TOML text: first plain values, then tables and arrays of tables.

    The text omits empty inline tables, and values that are None.
    """
    lines = _value_lines(content)
    for key, value in content.items():
        if isinstance(value, Mapping):
            lines += ["", f"[{key}]", *_value_lines(value)]
        elif _is_table_array(value):
            for table in value:
                lines += ["", f"[[{key}]]", *_value_lines(table, inline_tables=True)]
    return "\n".join(lines) + "\n"


def _value_lines(table_content: Mapping[str, Any], inline_tables: bool = False) -> list[str]:
    """Return the lines with the values of a table, one line for each value."""

    def is_single_line_value(value: Any) -> bool:
        """Return True for a value that the table can contain in one line ``key = value``."""
        return (
            bool(inline_tables and value)
            if isinstance(value, Mapping)
            else not _is_table_array(value)
        )

    return [
        f"{key} = {_value_text(value)}"
        for key, value in table_content.items()
        if value is not None and is_single_line_value(value)
    ]


def _is_table_array(value: Any) -> bool:
    """Return True for a non-empty list of tables."""
    return (
        isinstance(value, list | tuple)
        and len(value) > 0
        and all(isinstance(entry, Mapping) for entry in value)
    )


def _value_text(value: Any) -> str:
    """Return the TOML text of a value.

    Python's repr of a float is the shortest exact text, and is valid TOML.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return quoted_string(value)
    if isinstance(value, Mapping):
        return (
            "{ "
            + ", ".join(f"{_key_text(key)} = {_value_text(entry)}" for key, entry in value.items())
            + " }"
        )
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value_text(entry) for entry in value) + "]"
    return repr(value)


def quoted_string(text: str) -> str:
    """Return a text as a TOML basic string, with quotes.

    TOML has no escape sequence for characters without a UTF-8 encoding. The function replaces each
    character without a UTF-8 encoding by the visible text of an escape sequence.
    """
    return json.dumps(escape_surrogates(text), ensure_ascii=False).replace("\x7f", "\\u007f")


def _key_text(key: str) -> str:
    """Return the TOML text of a key, with quotes if quotes are necessary."""
    return (
        key
        if key.isascii() and key.replace("_", "").replace("-", "").isalnum()
        else quoted_string(key)
    )
