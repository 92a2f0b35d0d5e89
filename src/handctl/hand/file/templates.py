"""Resolution of a hand file of schema 2.

The resolution replaces defaults and templates by the values for which they stand.

A hand file of schema 2 contains a repeated value only once. The resolved content has the form of
schema 1, where every section contains all of its values. The following rules apply in order:

1. A digit, tendon or motor has the values of ``[default.KIND]``. Values of the section's template
   ``[KIND_template.NAME]`` replace values of the default. Values in the section itself replace
   values of the default and of the template. Tables are merged key by key.
2. Tables ``tendon.NAME`` and ``motor.NAME`` within a digit become tendons and motors with the name
   DIGIT_NAME. Within the tables of a digit, ``j1`` means joint DIGIT_j1, and a motor of the same
   digit can be named without DIGIT.
3. If a key needs a list with a value per link, one number stands for a list of equal values.
4. ``"all"`` in the sensor node stands for all tendons, or all joints.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from handctl.hand.file.checks import KEYS_PER_LINK
from handctl.hand.file.error_text import FileMistake, most_similar_valid_key, toml_spelling
from handctl.hand.file.section_models import PRISMATIC, PRISMATIC_KEYS, REVOLUTE_KEYS
from handctl.printing import similar_name

SCHEMA_WITHOUT_TEMPLATES = 1
"""Schema number of a hand file in which every section has all its values."""
SCHEMA_WITH_TEMPLATES = 2
"""Schema number of a hand file with defaults and templates."""
SECTION_KINDS = ("digit", "tendon", "motor")
"""Kinds of section that can have defaults and templates."""
TABLE_KINDS_IN_DIGIT = ("tendon", "motor")
"""Kinds of table that a digit can contain."""
TEMPLATE_KEYS = {kind: f"{kind}_template" for kind in SECTION_KINDS}
"""Name of the table that contains the templates of each kind of section."""
TEMPLATE_TABLES = ("default", *TEMPLATE_KEYS.values())
"""Names of the tables that contain the defaults and the templates."""
MIN_NAME_SIMILARITY = 0.8
"""Smallest similarity (0 to 1) of a misspelt name to the name of a table with defaults or templates."""
KEYS_PER_JOINT_TYPE = {
    **dict.fromkeys((*REVOLUTE_KEYS, "joint_rated_torque_N_m"), False),
    **dict.fromkeys((*PRISMATIC_KEYS, "joint_rated_force_N"), True),
}
"""Keys of a digit with a value per joint of one type: True for a key of prismatic joints."""
KEYS_ACCEPTING_ONE_VALUE = (*KEYS_PER_LINK, *KEYS_PER_JOINT_TYPE, "link_mesh_scale")
"""Keys of a digit that accept one number in place of a list with a value per link or joint."""
MOMENT_ARM_KEYS = ("moment_arm_m", "excursion_ratio")
"""Keys of a tendon whose value is a table with an entry per joint."""
ALL_NAMES_KEYWORD = "all"
"""Value of the sensor node that stands for all tendons or all joints."""
MAX_MERGED_TABLE_DEPTH = 3
"""Number of levels of nested tables that the resolution merges key by key.

A table on a deeper level is replaced as a whole.
"""
KEY_PATH_PATTERN = re.compile(r"(digit|tendon|motor)\[[^\]]*\]\.([A-Za-z_0-9]+)")
"""Pattern of the key path of a key in a digit, tendon or motor."""
SHORT_JOINT_PATTERN = re.compile(r"j[0-9]+")

TableContent = Mapping[str, Any]
KeyPathOrigins = dict[str, str]
"""Key path of each value in the hand file, by the key path of the value in the resolved content."""


class ValueLayer(NamedTuple):
    """Values that one table of the hand file gives to a section. Several layers can give values to a section.

    Values of a later layer replace values of an earlier layer. ``path`` is the key path of the
    table.
    """

    values: TableContent
    path: str


class ResolvedContent(NamedTuple):
    """Result of replacing the defaults and templates in a hand file.

    Attributes:
        content: content of the hand file in the form of schema 1.
        origins: key path in the hand file, for each value that has a different key path in
            ``content``.
        mistakes: mistakes in the use of defaults and templates.
    """

    content: dict[str, Any]
    origins: KeyPathOrigins
    mistakes: list[FileMistake]


def resolve_templates(content: TableContent) -> ResolvedContent:
    """Replace the defaults and templates of a hand file by the values for which they stand.

    The function does not change the content of a file with schema 1.

    If the value of a section is not a table, the function does not change the value. A later
    validation of the content reports the wrong value with a better message.
    """
    content, spelling_mistakes = _with_correct_table_names(content)
    tables = [key for key in TEMPLATE_TABLES if key in content]
    if content.get("schema") != SCHEMA_WITH_TEMPLATES and not tables:
        return ResolvedContent(dict(content), {}, [])
    resolver = _TemplateResolver(content)
    resolver.mistakes += spelling_mistakes
    if content.get("schema") != SCHEMA_WITH_TEMPLATES:
        given_text = toml_spelling(content["schema"]) if "schema" in content else "missing"
        expected = (
            f"schema = {SCHEMA_WITH_TEMPLATES} in the first line, as the file has [{tables[0]}]"
        )
        resolver.mistakes.append(FileMistake(given_text, "schema", expected))
    resolved_content = {
        key: value for key, value in content.items() if key not in TEMPLATE_TABLES
    } | {"schema": SCHEMA_WITHOUT_TEMPLATES}
    resolver.check_tables()
    sections: dict[str, Any] = {kind: [] for kind in SECTION_KINDS}
    for kind in SECTION_KINDS:
        entries = content.get(kind, [])
        if not _is_list_of_tables(entries):
            sections[kind] = entries
            continue
        for position, entry in enumerate(entries):
            sections[kind].append(
                resolver.entry(
                    kind, [ValueLayer(entry, f"{kind}[{_section_label(entry, position)}]")]
                )
            )
    for kind in TABLE_KINDS_IN_DIGIT:
        if isinstance(sections[kind], list):
            sections[kind] = resolver.of_digits[kind] + sections[kind]
    # A missing section is not added, so that the validation reports the section as missing.
    resolved_content |= {
        kind: section for kind, section in sections.items() if section or kind in content
    }
    node = content.get("sensor_node")
    if isinstance(node, Mapping):
        resolved_content["sensor_node"] = _expand_all_names(node, sections)
    return ResolvedContent(resolved_content, resolver.origins, resolver.mistakes)


def _with_correct_table_names(
    content: TableContent,
) -> tuple[TableContent, list[FileMistake]]:
    """Correct misspelt names of the tables of defaults and templates, such as ``defaults`` for ``default``.

    If a misspelt name were not corrected, each value of the table would also be reported as missing.

    Returns:
        the content with correct names, and one mistake for each misspelt name.
    """
    corrected_content: dict[str, Any] = {}
    mistakes = []
    for key, value in content.items():
        right_name = key
        if key not in TEMPLATE_TABLES and (
            table_name := similar_name(key, TEMPLATE_TABLES, MIN_NAME_SIMILARITY)
        ):
            mistakes.append(FileMistake("unknown key", key, f"{table_name}?"))
            right_name = table_name
        other_value = corrected_content.get(right_name)
        if isinstance(value, Mapping) and isinstance(other_value, Mapping):
            value = {**other_value, **value}
        corrected_content[right_name] = value
    return corrected_content, mistakes


class _TemplateResolver:
    """Resolver that stores the content of one hand file and the sections that have been resolved so far."""

    def __init__(self, content: TableContent) -> None:
        """Store the content of the hand file whose defaults and templates are to be replaced."""
        self.content = content
        self.origins: KeyPathOrigins = {}
        self.mistakes: list[FileMistake] = []
        self.of_digits: dict[str, list[dict[str, Any]]] = {
            kind: [] for kind in TABLE_KINDS_IN_DIGIT
        }

    def check_tables(self) -> None:
        """Find mistakes in the defaults and templates of the file.

        Defaults and templates must be tables without the keys ``name`` and ``template``, which
        belong to a section itself.
        """
        default = self.content.get("default", {})
        if not isinstance(default, Mapping):
            self.mistakes.append(FileMistake(toml_spelling(default), "default", "a table"))
            default = {}
        for kind in default:
            if kind not in SECTION_KINDS:
                self.mistakes.append(
                    FileMistake(
                        "unknown key",
                        f"default.{kind}",
                        most_similar_valid_key(kind, [*SECTION_KINDS]),
                    )
                )
        layers = [(f"default.{kind}", values) for kind, values in default.items()]
        for key in TEMPLATE_KEYS.values():
            templates = self.content.get(key, {})
            if isinstance(templates, Mapping):
                layers += [(f"{key}.{name}", values) for name, values in templates.items()]
            else:
                layers.append((key, templates))
        for path, values in layers:
            if not isinstance(values, Mapping):
                self.mistakes.append(FileMistake(toml_spelling(values), path, "a table"))
                continue
            for key in {"name", "template"} & values.keys():
                self.mistakes.append(
                    FileMistake("unknown key", f"{path}.{key}", f"{key} in the section itself")
                )

    def entry(
        self, section_kind: str, section_layers: Sequence[ValueLayer], name: str | None = None
    ) -> dict[str, Any]:
        """Return one digit, tendon or motor with all of its values.

        Args:
            section_kind: kind of section.
            section_layers: layers of the section itself, without the layers of the default and the
                template.
            name: name of the section, or None if the layers contain the name.
        """
        layers = [*self.shared_layers(section_kind, section_layers), *section_layers]
        values, origins = _merge_layers(layers, MAX_MERGED_TABLE_DEPTH)
        values.pop("template", None)
        label = name or values.get("name")
        if name:
            values["name"] = name
        path = f"{section_kind}[{label}]" if name else section_layers[-1].path
        self.origins |= {f"{path}.{key}": origin for key, origin in origins.items()}
        if section_kind == "digit":
            self._resolve_digit(layers, values, path)
        return values

    def shared_layers(
        self, section_kind: str, section_layers: Sequence[ValueLayer]
    ) -> Iterator[ValueLayer]:
        """Yield the values that a section takes from the default of its kind, and from the template that it names."""
        default_section = self.content.get("default")
        default: TableContent = default_section if isinstance(default_section, Mapping) else {}
        for key, values in default.items():
            # A default whose kind is misspelt is used for the most similar kind. Without the
            # misspelt default, the validation would also report all its values as missing.
            is_misspelt = (
                key not in SECTION_KINDS
                and section_kind not in default
                and most_similar_valid_key(key, [*SECTION_KINDS]) == section_kind
            )
            if isinstance(values, Mapping) and (key == section_kind or is_misspelt):
                yield ValueLayer(_without_name_and_template(values), f"default.{key}")
        template_layers = [layer for layer in section_layers if "template" in layer.values]
        if not template_layers:
            return
        key = TEMPLATE_KEYS[section_kind]
        name = template_layers[-1].values["template"]
        templates = self.content.get(key)
        valid_names = [*templates] if isinstance(templates, Mapping) else []
        if not isinstance(name, str) or name not in valid_names:
            expected = (
                most_similar_valid_key(str(name), valid_names)
                if valid_names
                else f"the name of a table [{key}.NAME]"
            )
            self.mistakes.append(
                FileMistake(toml_spelling(name), f"{template_layers[-1].path}.template", expected)
            )
            # If a template does not exist, the template with the most similar name is used. Without
            # a template, the validation would also report all values of the template as missing.
            name = expected if expected in valid_names else next(iter(valid_names), None)
        if isinstance(templates, Mapping) and isinstance(templates.get(name), Mapping):
            yield ValueLayer(_without_name_and_template(templates[name]), f"{key}.{name}")

    def _resolve_digit(
        self, digit_layers: Sequence[ValueLayer], values: dict[str, Any], path: str
    ) -> None:
        """Move the tendons and motors of a digit to the tables of the hand, and write one value for each link."""
        digit = values.get("name")
        layers_by_kind = {
            kind: _template_layers_by_name(digit_layers, kind) for kind in TABLE_KINDS_IN_DIGIT
        }
        for kind in TABLE_KINDS_IN_DIGIT:
            template_value = values.get(kind)
            if not isinstance(template_value, Mapping):
                continue  # either the digit has no tendons or motors, or the later validation describes the mistake
            del values[kind]
            for name, table in template_value.items():
                location = self.origins[f"{path}.{kind}.{name}"]
                if isinstance(table, Mapping):
                    self.of_digits[kind].append(
                        self._tendon_or_motor_of_digit(
                            kind, digit, name, layers_by_kind[kind][name], layers_by_kind["motor"]
                        )
                    )
                else:
                    self.mistakes.append(FileMistake(toml_spelling(table), location, "a table"))
        links = values.get("link_length_m", [0.0])
        for key in KEYS_ACCEPTING_ONE_VALUE:
            value = values.get(key)
            if (
                isinstance(links, list | tuple)
                and isinstance(value, int | float)
                and not isinstance(value, bool)
            ):
                count = _expected_value_count(key, len(links), values.get("joint_type"))
                values[key] = [value] * count
                origin = self.origins[f"{path}.{key}"]
                self.origins |= {f"{path}.{key}[{i}]": origin for i in range(count)}

    def _tendon_or_motor_of_digit(
        self,
        section_kind: str,
        digit: Any,
        name: str,
        section_layers: list[ValueLayer],
        motors: TableContent,
    ) -> dict[str, Any]:
        """Return a tendon or motor of a digit.

        Full names replace the short names of the section, its motor and its joints.

        Args:
            section_kind: kind of section.
            digit: name of the digit.
            name: short name of the section.
            section_layers: layers of the section itself.
            motors: motors of the digit by short name.
        """
        full_name = f"{digit}_{name}"
        values = self.entry(section_kind, section_layers, full_name)
        path = f"{section_kind}[{full_name}]"
        self.origins[path] = section_layers[0].path
        for layer in section_layers:
            if "name" in layer.values:
                self.mistakes.append(
                    FileMistake(
                        "unknown key", f"{layer.path}.name", f"none: the name is {full_name}"
                    )
                )
        if section_kind == "tendon":
            if values.get("motor") in motors:
                values["motor"] = f"{digit}_{values['motor']}"
            for key in MOMENT_ARM_KEYS:
                self._write_full_joint_names(values, f"{path}.{key}", key, str(digit))
        return values

    def _write_full_joint_names(
        self, values: dict[str, Any], path: str, key: str, digit: str
    ) -> None:
        """Replace the short joint names in a table of a tendon by full joint names.

        Args:
            values: values of the tendon, modified in place.
            path: key path of the table.
            key: key of the table.
            digit: name of the digit.
        """
        arms = values.get(key)
        if not isinstance(arms, Mapping):
            return
        full_names = {
            joint: f"{digit}_{joint}" if SHORT_JOINT_PATTERN.fullmatch(joint) else joint
            for joint in arms
        }
        values[key] = {full_names[joint]: arm for joint, arm in arms.items()}
        self.origins |= {
            f"{path}.{full_names[joint]}": self.origins.get(f"{path}.{joint}", "") for joint in arms
        }


def _expected_value_count(key: str, link_count: int, joint_types: Any) -> int:
    """Return how many values the list of a key must have in a digit with the given joint types."""
    if key not in KEYS_PER_JOINT_TYPE:
        return link_count
    prismatic_count = (
        list(joint_types).count(PRISMATIC) if isinstance(joint_types, list | tuple) else 0
    )
    return prismatic_count if KEYS_PER_JOINT_TYPE[key] else max(link_count - prismatic_count, 0)


def join_missing_key_mistakes(
    mistakes: Iterable[FileMistake], content: TableContent
) -> list[FileMistake]:
    """Join the mistakes that report a key as missing in all sections of a kind.

    The joined mistake reports the key as missing in the default of the section kind.

    Args:
        mistakes: mistakes whose key paths belong to the resolved content.
        content: resolved content.
    """
    mistake_list = list(mistakes)
    missing_values = [
        KEY_PATH_PATTERN.fullmatch(mistake.where) if mistake.what == "missing" else None
        for mistake in mistake_list
    ]
    counts = Counter(match.groups() for match in missing_values if match)
    joined: dict[FileMistake, None] = {}
    for mistake, match in zip(mistake_list, missing_values, strict=True):
        if match and counts[match.groups()] == len(_list_of_tables(content.get(match[1]))) > 1:
            value_text, colon, meaning = mistake.right.partition(": ")
            expected = f"{value_text}, there or in each {match[1]}{colon}{meaning}"
            mistake = FileMistake("missing", f"default.{match[1]}.{match[2]}", expected)
        joined[mistake] = None
    return list(joined)


def _merge_layers(
    value_layers: Sequence[ValueLayer], table_depth: int
) -> tuple[dict[str, Any], KeyPathOrigins]:
    """Merge several layers of values for a section.

    Values of a later layer replace values of an earlier layer. Tables are merged key by key.

    Returns:
        The merged values. The second result is the key path of each value in the hand file, by the
        key path within the section.
    """
    values: dict[str, Any] = {}
    origins: KeyPathOrigins = {}
    for key in dict.fromkeys(key for layer in value_layers for key in layer.values):
        given_layers = [
            ValueLayer(layer.values[key], f"{layer.path}.{key}")
            for layer in value_layers
            if key in layer.values
        ]
        value, path = given_layers[-1]
        origins[key] = path
        if isinstance(value, Mapping) and table_depth > 0:
            value, origins_in_table = _merge_layers(
                [layer for layer in given_layers if isinstance(layer.values, Mapping)],
                table_depth - 1,
            )
            origins |= {f"{key}.{below}": origin for below, origin in origins_in_table.items()}
        values[key] = _copy_of_lists(value)
    return values, origins


def _copy_of_lists(value: Any) -> Any:
    """Return a copy of a list, because two sections must not share one list."""
    return [_copy_of_lists(entry) for entry in value] if isinstance(value, list) else value


def _template_layers_by_name(
    layers: Sequence[ValueLayer], kind: str
) -> dict[str, list[ValueLayer]]:
    """Return a list of ``ValueLayer`` for each tendon or motor in a digit, by the short name of the part."""
    layers_by_name: dict[str, list[ValueLayer]] = {}
    for layer in layers:
        tables = layer.values.get(kind)
        for name, table in tables.items() if isinstance(tables, Mapping) else ():
            if isinstance(table, Mapping):
                layers_by_name.setdefault(name, []).append(
                    ValueLayer(table, f"{layer.path}.{kind}.{name}")
                )
    return layers_by_name


def _expand_all_names(node: TableContent, sections: TableContent) -> dict[str, Any]:
    """Return the sensor node with all tendon or joint names in place of ``"all"``."""
    names = {
        "tendons": [tendon.get("name") for tendon in _list_of_tables(sections["tendon"])],
        "joints": [
            f"{digit.get('name')}_j{i + 1}"
            for digit in _list_of_tables(sections["digit"])
            if isinstance(digit.get("link_length_m"), list | tuple)
            for i in range(len(digit["link_length_m"]))
        ],
    }
    return dict(node) | {key: names[key] for key in names if node.get(key) == ALL_NAMES_KEYWORD}


def _without_name_and_template(values: TableContent) -> dict[str, Any]:
    """Return the values of a default or template, without the keys ``name`` and ``template``."""
    return {key: value for key, value in values.items() if key not in ("name", "template")}


def _is_list_of_tables(value: Any) -> bool:
    """Return True for a list that contains only tables, and for an empty list."""
    return isinstance(value, list | tuple) and all(isinstance(entry, Mapping) for entry in value)


def _list_of_tables(value: Any) -> list[TableContent]:
    """Return the value if it is a list of tables. If the value is not a list of tables, return an empty list."""
    return list(value) if _is_list_of_tables(value) else []


def _section_label(section: TableContent, position: int) -> str:
    """Return the text that identifies a section in key paths: its name, or the position of a section without a name."""
    name = section.get("name")
    return name if isinstance(name, str) and name else str(position)
