"""Conversion of a hand file of schema 1 to schema 2.

A hand file of schema 2 contains repeated values only once. The conversion keeps the comments of the
file.

The conversion does not change the spelling of a value, for example ``0x1A0`` or ``6.384e-3``. A
comment stays on the same line as the value that it describes.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, Comment, Item, Table, Whitespace

from handctl.errors import ConfigError
from handctl.hand.file.templates import (
    ALL_NAMES_KEYWORD,
    KEYS_ACCEPTING_ONE_VALUE,
    MOMENT_ARM_KEYS,
    SCHEMA_WITH_TEMPLATES,
    SECTION_KINDS,
    SHORT_JOINT_PATTERN,
    TABLE_KINDS_IN_DIGIT,
)
from handctl.hand.file.toml_text import toml_text

MAX_LINE_LENGTH = 120
"""Largest length of a line with an inline table."""
NEVER_SHARED_KEYS = {
    "digit": {"name", "mount_position_m"},
    "tendon": {"name"},
    "motor": {"name", "node_id"},
}
"""Keys that each section of a kind must contain itself, and that no default or template is allowed to contain."""
MIN_SECTIONS_TO_SHARE = 2
"""Smallest number of sections whose common values become a default or a template."""


@dataclass
class TomlEntry:
    """Line of a hand file.

    A line of a hand file contains either a key with its value and a comment, or only a comment.

    Attributes:
        key: key of the line, empty for a blank line and for a line with only a comment.
        text: text of the value, or the whole line if the line has no key.
        value: parsed value, or None in a line without a key.
        comment: comment after the value, including the character #, or an empty text.
    """

    key: str
    text: str
    value: Any = None
    comment: str = ""

    def line(self) -> str:
        """Return the TOML text of this entry, with its comment."""
        if not self.key:
            return self.text
        return f"{self.key} = {self.text}" + (f"   {self.comment}" if self.comment else "")


@dataclass
class TomlTable:
    """Table of a hand file, or the part of the file before the first table.

    Attributes:
        entries: lines of the table, in the order of the file.
        comments_before: comment lines before the header of the table.
        comment: comment after the header of the table.
        subtables: tables of the tendons and motors within a digit, by section kind and short name.
    """

    entries: list[TomlEntry]
    comments_before: list[str] = field(default_factory=list)
    comment: str = ""
    subtables: dict[str, dict[str, "TomlTable"]] = field(
        default_factory=lambda: {kind: {} for kind in TABLE_KINDS_IN_DIGIT}
    )

    def values(self) -> dict[str, Any]:
        """Return the values of the table by key."""
        return {entry.key: entry.value for entry in self.entries if entry.key}

    def take(self, keys: Iterable[str]) -> list[TomlEntry]:
        """Remove the lines with the given keys from the table, and return these lines."""
        entries = [entry for entry in self.entries if entry.key in set(keys)]
        self.entries = [entry for entry in self.entries if entry not in entries]
        return entries


def convert_to_schema_2(text: str, source_name: str) -> str:
    """Convert the text of a hand file of schema 1 to schema 2.

    Args:
        text: text of a valid hand file of schema 1.
        source_name: name of the file, for error messages.

    Raises:
        ConfigError: the text is not TOML.
    """
    try:
        document = tomlkit.parse(text)
    except (TOMLKitError, ValueError, RecursionError) as error:
        raise ConfigError(f"not TOML: {error}", source_name, "valid TOML") from None
    root, tables = _parse_blocks(document)
    for entry in root.entries:
        if entry.key == "schema":
            entry.text = str(SCHEMA_WITH_TEMPLATES)
    sections = {kind: [block for name, block in tables if name == kind] for kind in SECTION_KINDS}
    other_blocks = [(name, block) for name, block in tables if name not in SECTION_KINDS]
    _shorten_sensor_node(other_blocks, sections)
    defaults = {kind: _remove_common_values(kind, sections[kind]) for kind in SECTION_KINDS}
    for kind in TABLE_KINDS_IN_DIGIT:
        _move_sections_into_digits(kind, sections)
    templates = _remove_values_to_templates(sections["digit"])
    lines = _table_lines(root, "")
    for name, block in other_blocks:
        array = isinstance(document[name], AoT)
        header = f"[[{name}]]" if array else f"[{name}]" + _header_comment(block)
        lines += ["", *block.comments_before, header, *_table_lines(block, name)]
    for kind in SECTION_KINDS:
        lines += _lines_of_section_kind(
            kind, defaults[kind], templates if kind == "digit" else {}, sections[kind]
        )
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines).strip("\n")) + "\n"


def _parse_blocks(document: tomlkit.TOMLDocument) -> tuple[TomlTable, list[tuple[str, TomlTable]]]:
    """Return the root table of a TOML document and the other tables, in the order of the document.

    The comments before the header of a table belong to the table.
    """
    root = TomlTable([])
    tables: list[tuple[str, TomlTable]] = []
    last_table = root
    for key, item in document.body:
        if key is None or not isinstance(item, Table | AoT):
            last_table.entries += _parse_entry(key.key if key else "", item)
            continue
        for table in item.body if isinstance(item, AoT) else [item]:
            block = TomlTable([], _trailing_comments(last_table), table.trivia.comment)
            for name, value in table.value.body:
                block.entries += _parse_entry(name.key if name else "", value)
            tables.append((key.key, block))
            last_table = block
    return root, tables


def _parse_entry(key: str, item: Item) -> list[TomlEntry]:
    """Return the lines for one TOML item, which is a key, a comment, or blank lines."""
    if isinstance(item, Whitespace):
        return []
    if isinstance(item, Comment):
        return [TomlEntry("", item.trivia.comment)]
    if isinstance(item, Table):
        comments = [
            TomlEntry("", value.trivia.comment)
            for name, value in item.value.body
            if isinstance(value, Comment)
        ]
        return [*comments, TomlEntry(key, _inline_table_text(item.unwrap()), item.unwrap())]
    return [TomlEntry(key, item.as_string().strip(), item.unwrap(), item.trivia.comment)]


def _trailing_comments(block: TomlTable) -> list[str]:
    """Remove the comment lines at the end of a table, and return the removed lines.

    The comment lines at the end of a table belong to the next table.
    """
    trailing: list[str] = []
    while len(block.entries) > 1 and not block.entries[-1].key:
        trailing.insert(0, block.entries.pop().text)
    return trailing


def _remove_common_values(
    section_kind: str, section_tables: Sequence[TomlTable]
) -> list[TomlEntry]:
    """Remove the values that all sections of a kind have in common, and return the lines of these values."""
    if section_kind == "digit":
        for block in section_tables:
            _shorten_lists_per_link(block)
    if len(section_tables) < MIN_SECTIONS_TO_SHARE:
        return []
    never_shared_keys = (*NEVER_SHARED_KEYS[section_kind], "motor", *MOMENT_ARM_KEYS)
    return _remove_shared_values(section_tables, lambda key, value: key not in never_shared_keys)


def _remove_shared_values(
    section_tables: Sequence[TomlTable], may_be_shared: Callable[[str, Any], bool]
) -> list[TomlEntry]:
    """Remove the values that are equal in all tables, and return one entry for each removed value.

    The entry contains the comments that the tables have about the value.
    """
    values_of_first_section = section_tables[0].values()
    other_values = [block.values() for block in section_tables[1:]]
    keys = [
        key
        for key, value in values_of_first_section.items()
        if may_be_shared(key, value)
        and all(
            key in other_block_values and _are_equal(other_block_values[key], value)
            for other_block_values in other_values
        )
    ]
    entries = {entry.key: entry for entry in section_tables[0].take(keys)}
    for block in section_tables[1:]:
        for entry in block.take(keys):
            known_entry = entries[entry.key]
            if entry.comment and entry.comment not in known_entry.comment:
                known_entry.comment = (
                    f"{known_entry.comment}; {entry.comment.lstrip('# ')}"
                    if known_entry.comment
                    else entry.comment
                )
    return list(entries.values())


def _are_equal(value: Any, other_value: Any) -> bool:
    """Return True if two values are equal. A boolean never equals a number.

    In Python, True equals 1, but in TOML, true and 1 are different values.
    """
    return bool(value == other_value) and isinstance(value, bool) == isinstance(other_value, bool)


def _shorten_lists_per_link(block: TomlTable) -> None:
    """Replace each list of equal numbers, one per link, by a single number."""
    for entry in block.entries:
        values = entry.value
        if entry.key not in KEYS_ACCEPTING_ONE_VALUE or not isinstance(values, list) or not values:
            continue
        if isinstance(values[0], int | float) and all(value == values[0] for value in values):
            # The text between the bracket and the first comma is the number in the spelling of the
            # file, and is copied.
            entry.text = entry.text.strip("[] \n").split(",")[0].strip()
            entry.value = values[0]


def _shorten_sensor_node(
    other_tables: Sequence[tuple[str, TomlTable]], tables_of_kind: dict[str, list[TomlTable]]
) -> None:
    """Replace a list of all tendons or of all joints in the sensor node by ``"all"``."""
    digits = [block.values() for block in tables_of_kind["digit"]]
    names = {
        "tendons": [block.values().get("name") for block in tables_of_kind["tendon"]],
        "joints": [
            f"{digit['name']}_j{i + 1}"
            for digit in digits
            for i in range(len(digit["link_length_m"]))
        ],
    }
    for name, block in other_tables:
        for entry in block.entries if name == "sensor_node" else ():
            if entry.key in names and entry.value == names[entry.key]:
                entry.text = f'"{ALL_NAMES_KEYWORD}"'


def _move_sections_into_digits(
    section_kind: str, tables_of_kind: dict[str, list[TomlTable]]
) -> None:
    """Move each tendon or motor into its digit.

    The name of each tendon or motor must begin with the name of its digit. If any name begins
    differently, the function moves no tendon and no motor.
    """
    moved_tables: list[tuple[TomlTable, str, TomlTable]] = []
    digits = {block.values()["name"]: block for block in tables_of_kind["digit"]}
    for block in tables_of_kind[section_kind]:
        name = str(block.values()["name"])
        digit_name = max(
            (digit for digit in digits if name.startswith(f"{digit}_")), key=len, default=None
        )
        if digit_name is None or not all(
            joint.startswith(f"{digit_name}_j")
            for key in MOMENT_ARM_KEYS
            for joint in block.values().get(key, ())
        ):
            return
        moved_tables.append((digits[digit_name], name.removeprefix(f"{digit_name}_"), block))
    if [
        id(block)
        for *_, block in sorted(moved_tables, key=lambda row: list(digits.values()).index(row[0]))
    ] != [id(block) for block in tables_of_kind[section_kind]]:
        return  # moving the sections would change the order of the tendons or motors
    comments: list[str] = []
    if tables_of_kind[section_kind]:
        comments, tables_of_kind[section_kind][0].comments_before = (
            tables_of_kind[section_kind][0].comments_before,
            [],
        )
    for digit, short_name, block in moved_tables:
        digit_name = digit.values()["name"]
        block.take(["name"])
        for entry in block.entries:
            if entry.key == "motor" and str(entry.value).startswith(f"{digit_name}_"):
                entry.value = str(entry.value).removeprefix(f"{digit_name}_")
                entry.text = f'"{entry.value}"'
            if entry.key in MOMENT_ARM_KEYS:
                entry.value = {
                    joint.removeprefix(f"{digit_name}_"): arm for joint, arm in entry.value.items()
                }
                entry.text = entry.text.replace(f"{digit_name}_j", "j")
                assert all(SHORT_JOINT_PATTERN.fullmatch(joint) for joint in entry.value)
        digit.subtables[section_kind][short_name] = block
    tables_of_kind[section_kind].clear()
    if comments:
        tables_of_kind[section_kind].append(TomlTable([], comments))


def _remove_values_to_templates(digits: Sequence[TomlTable]) -> dict[str, TomlTable]:
    """Remove the values that digits with equal links have in common, and return templates that contain these values."""
    groups: dict[str, list[TomlTable]] = {}
    for block in digits:
        groups.setdefault(str(block.values().get("link_length_m")), []).append(block)
    templates: dict[str, TomlTable] = {}
    for group in groups.values():
        if len(group) < MIN_SECTIONS_TO_SHARE or "link_length_m" not in group[0].values():
            continue
        template = TomlTable(
            _remove_shared_values(group, lambda key, value: key not in NEVER_SHARED_KEYS["digit"])
        )
        for kind in TABLE_KINDS_IN_DIGIT:
            # In the resolved content of a hand file, the tendons and motors of a template precede
            # the tendons and motors of the digit itself. Because the order of tendons and motors
            # must not change, only those before the first difference between the digits are moved
            # into the template.
            for short_name in group[0].subtables[kind]:
                if not all(short_name in block.subtables[kind] for block in group):
                    break
                tables = [block.subtables[kind][short_name] for block in group]
                shared_entries = _remove_shared_values(tables, lambda key, value: key != "node_id")
                if not shared_entries:
                    break
                template.subtables[kind][short_name] = TomlTable(shared_entries)
        name = "finger" if not templates else f"finger_{len(templates) + 1}"
        templates[name] = template
        for block in group:
            template_index = (
                next(i for i, entry in enumerate(block.entries) if entry.key == "name") + 1
            )
            block.entries.insert(template_index, TomlEntry("template", f'"{name}"', name))
    return templates


def _lines_of_section_kind(
    section_kind: str,
    default_entries: Sequence[TomlEntry],
    table_of_template: dict[str, TomlTable],
    section_tables: Sequence[TomlTable],
) -> list[str]:
    """Return the lines of the converted hand file for all sections of one kind.

    The lines contain the default of this kind, the templates of this kind, and the sections.
    """
    lines = ["", *(section_tables[0].comments_before if section_tables else [])]
    if default_entries:
        lines += [f"[default.{section_kind}]", *(entry.line() for entry in default_entries), ""]
    for name, template in table_of_template.items():
        lines += [
            f"[{section_kind}_template.{name}]",
            *_table_lines(template, f"{section_kind}_template.{name}"),
            "",
        ]
    for i, block in enumerate(section_tables):
        if block.entries or any(block.subtables.values()):
            header = f"[[{section_kind}]]" + _header_comment(block)
            lines += [
                *(block.comments_before if i else []),
                header,
                *_table_lines(block, section_kind),
                "",
            ]
    return lines


def _header_comment(block: TomlTable) -> str:
    """Return the text of the comment after the header of a table."""
    return f"   {block.comment}" if block.comment else ""


def _table_lines(block: TomlTable, header: str) -> list[str]:
    """Return the lines of a TOML table, with its subtables of tendons and motors."""
    lines = [entry.line() for entry in block.entries]
    tables: list[str] = []
    for kind, subtables in block.subtables.items():
        for short_name, table in subtables.items():
            key_entries = [entry for entry in table.entries if entry.key]
            comments = "; ".join(
                entry.comment.lstrip("# ") for entry in key_entries if entry.comment
            )
            comment_text = f"   # {comments}" if comments else ""
            line = (
                f"{kind}.{short_name} = {{ "
                + ", ".join(f"{entry.key} = {entry.text}" for entry in key_entries)
                + " }"
                + comment_text
            )
            comment_entries = [entry for entry in table.entries if not entry.key]
            if len(key_entries) == 1 and not comment_entries and not table.comments_before:
                lines.append(f"{kind}.{short_name}.{key_entries[0].line()}")
            elif key_entries and len(line) <= MAX_LINE_LENGTH and "\n" not in line:
                lines += (
                    [*table.comments_before, *(entry.text for entry in comment_entries), line]
                    if comment_entries or not lines
                    else [line]
                )
            elif key_entries:
                tables += [
                    "",
                    f"[{header}.{kind}.{short_name}]",
                    *(entry.line() for entry in table.entries),
                ]
            elif kind == "motor":
                lines.append(f"{kind}.{short_name} = {{}}")
    return lines + tables


def _inline_table_text(table_values: dict[str, Any]) -> str:
    """Return the text of an inline table."""
    return toml_text({"x": [{"x": table_values}]}).split("x = ", 1)[1].strip()
