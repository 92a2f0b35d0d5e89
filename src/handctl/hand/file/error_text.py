"""Messages about mistakes in a hand file or a gains file.

A message about a mistake contains the key path, the invalid value, and a valid value.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticCustomError

from handctl.errors import ConfigError
from handctl.hand.file.key_descriptions import key_description
from handctl.hand.file.quantity_types import UNMEASURED_PLACEHOLDER, CheckedType
from handctl.printing import similar_name


class FileMistake(NamedTuple):
    """One mistake in a file.

    Attributes:
        what: the mistake, together with the invalid value.
        where: key path of the invalid value.
        right: example of a valid value.
    """

    what: str
    where: str
    right: str

    def error(self, source_name: str) -> ConfigError:
        """Return an exception that reports the mistake.

        The error message is a single line that contains the name of the file.
        """
        return ConfigError(self.what, f"{source_name}: {self.where}", self.right)


SECTION_PATTERN = re.compile(r"(\w+)\[([^\]]*)\](.*)", re.DOTALL)
"""Pattern of a key path in a named section.

The pattern has groups for the kind of the section, the name of the section, and the rest of the key
path.
"""
EXPECTED_BY_ERROR_TYPE = {
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "too_short": "at least {min_length} values",
    "too_long": "at most {max_length} values",
}
"""Names of TOML types that are valid, by the type of a structural error of pydantic.

An error of any other type contains a valid value in its entry ``right``.
"""


def validation_mistakes(
    error: ValidationError, model: type[BaseModel], content: Mapping[str, Any]
) -> list[FileMistake]:
    """Return one mistake for each validation error of pydantic.

    The mistakes about unknown keys are first in the list, because pydantic reports a misspelt key
    twice: as an unknown key, and as a missing key.

    Args:
        error: error raised by pydantic.
        model: pydantic model of the file, for the names of valid keys.
        content: content of the file that pydantic validated, for the names of list entries.
    """
    error_details = error.errors(include_url=False)
    parent_locations = {
        error_detail["loc"][:depth]
        for error_detail in error_details
        for depth in range(1, len(error_detail["loc"]))
    }
    # If pydantic refuses an entry of a list, it also reports that the list has too few entries.
    error_details = [
        error_detail
        for error_detail in error_details
        if error_detail["type"] != "too_short" or error_detail["loc"] not in parent_locations
    ]
    unknown_details = [
        error_detail for error_detail in error_details if error_detail["type"] == "extra_forbidden"
    ]
    unknown_key_mistakes = [
        _unknown_key_mistake(error_detail["loc"], model, content)
        for error_detail in unknown_details
    ]
    misspelt_keys = {
        (error_detail["loc"][:-1], mistake.right)
        for error_detail, mistake in zip(unknown_details, unknown_key_mistakes, strict=True)
    }
    for error_detail in error_details:
        key_location = error_detail["loc"]
        where = key_path(content, key_location)
        if error_detail["type"] == "missing":
            if (key_location[:-1], key_location[-1]) not in misspelt_keys:
                unknown_key_mistakes.append(
                    FileMistake("missing", where, _meaning_of_missing_key(key_location, model))
                )
        elif error_detail["type"] != "extra_forbidden":
            context = {"right": error_detail["msg"], **error_detail.get("ctx", {})}
            expected = EXPECTED_BY_ERROR_TYPE.get(error_detail["type"], "{right}").format(**context)
            if error_detail["input"] == UNMEASURED_PLACEHOLDER:
                expected += _field_meaning(_field_of_key(key_location, model))
            unknown_key_mistakes.append(
                FileMistake(toml_spelling(error_detail["input"]), where, expected)
            )
    return unknown_key_mistakes


SECTIONS_ALLOWED_IN_DIGITS = ("tendon", "motor")
"""Kinds of section that are also allowed as tables within a digit."""


def _meaning_of_missing_key(key_location: Sequence[str | int], model: type[BaseModel]) -> str:
    """Return a text that describes the value of a key, for the error message about a file without this key.

    The text says which form the section or value must have, such as "a list", and adds the first
    sentence of the key's description.
    """
    field = _field_of_key(key_location, model)
    if field is None:
        return "a value"
    annotation = field.model.model_fields[field.name].annotation
    expected_form = valid_value_text(annotation, field.model.model_fields[field.name].metadata)
    if len(key_location) == 1 and _models_in_annotation(annotation):
        name = key_location[0]
        is_section_list = not isinstance(annotation, type)
        expected_form = f"[[{name}]] sections" if is_section_list else f"a section [{name}]"
        expected_form += (
            f", or {name}.NAME in each digit" if name in SECTIONS_ALLOWED_IN_DIGITS else ""
        )
    return expected_form + _field_meaning(field)


def valid_value_text(annotation: Any, metadata: Sequence[Any]) -> str:
    """Return the description of the valid values of a key, such as "a number from 0 to 1 m".

    Args:
        annotation: type annotation of the key.
        metadata: metadata of an annotated type. The metadata of a number or a text contains its
            check.
    """
    for validation in metadata:
        if isinstance(validation, CheckedType):
            try:
                validation.check(None)
            except PydanticCustomError as error:
                return str((error.context or {}).get("right", "a value"))
    if get_origin(annotation) is tuple:
        entry_types = [
            entry_type for entry_type in get_args(annotation) if entry_type is not Ellipsis
        ]
        entry_text = valid_value_text(entry_types[0], getattr(entry_types[0], "__metadata__", ()))
        is_fixed = Ellipsis not in get_args(annotation)
        count_text = f"a list of {len(entry_types)} entries" if is_fixed else "a list"
        return f"{count_text}, each {entry_text}"
    return "a value"


class _ModelField(NamedTuple):
    """Field of a pydantic model, given by the model and the name of the attribute."""

    model: type[BaseModel]
    name: str


def _field_meaning(field: _ModelField | None) -> str:
    """Return a colon and the first sentence of a key's description.

    Return an empty text if the key has no description.
    """
    text = first_sentence(key_description(*field)) if field else ""
    return f": {text}" if text else ""


def first_sentence(description: str) -> str:
    """Return the first sentence of a description as one line, without the full stop at the end."""
    return " ".join(
        re.split(r"\.\s", description, maxsplit=1)[0].rstrip(".").replace("``", "").split()
    )


def _field_of_key(key_location: Sequence[str | int], model: type[BaseModel]) -> _ModelField | None:
    """Return the field of a pydantic model that belongs to a key of the file.

    Return None if the key has no field, for example for an entry of a list.
    """
    *tables, key = key_location
    for table_or_index in tables:
        if isinstance(table_or_index, str):
            models = (
                _models_in_annotation(model.model_fields[table_or_index].annotation)
                if table_or_index in model.model_fields
                else []
            )
            if not models:
                return None
            model = models[0]
    fields = model.model_fields.items()
    return next(
        (_ModelField(model, name) for name, field in fields if key in (name, field.alias)), None
    )


def _unknown_key_mistake(
    key_location: Sequence[str | int], model: type[BaseModel], content: Mapping[str, Any]
) -> FileMistake:
    """Return the mistake for an unknown key.

    The returned ``FileMistake`` proposes the valid key that is most similar to the unknown key.
    """
    if key_location[0] == "motor" and key_location[-1] == "mode":
        return FileMistake(
            "a hand commands torques",
            key_path(content, key_location),
            "no mode; one drive: handctl jog --mode",
        )
    similar_key = most_similar_valid_key(
        str(key_location[-1]), _valid_keys_of_table(model, key_location[:-1])
    )
    return FileMistake("unknown key", key_path(content, key_location), similar_key)


def with_paths_in_hand_file(
    mistakes: Iterable[FileMistake], origin_of_path: Mapping[str, str]
) -> list[FileMistake]:
    """Return the mistakes with their key paths in the hand file.

    The given key paths belong to the resolved content, in which values have replaced all defaults
    and templates. Many sections can use the same value of a default or a template. If a value in
    the hand file causes several mistakes, only the first mistake is returned.

    Args:
        mistakes: mistakes whose key paths belong to the resolved content of the hand file.
        origin_of_path: key path in the hand file, for each key path in the resolved content.
    """
    located_mistakes: dict[FileMistake | str, FileMistake] = {}
    for mistake in mistakes:
        path_in_file = _path_in_file(mistake.where, origin_of_path)
        is_shared = path_in_file != mistake.where and mistake.what != "missing"
        mistake_at_location = mistake._replace(where=path_in_file)
        located_mistakes.setdefault(
            path_in_file if is_shared else mistake_at_location, mistake_at_location
        )
    return list(located_mistakes.values())


def group_mistakes(mistakes: Iterable[FileMistake]) -> list[FileMistake]:
    """Join mistakes that differ only in the section name of their key path.

    In the returned list, a joined mistake has the place of the first of its original mistakes. The
    key path of a joined mistake names at most three sections: ``tendon[a, b and 4 more].knee_N``.
    """
    names: dict[FileMistake, list[str]] = {}
    for mistake in mistakes:
        section = SECTION_PATTERN.fullmatch(mistake.where)
        mistake_pattern = (
            mistake._replace(where=f"{section[1]}[{{}}]{section[3]}") if section else mistake
        )
        names.setdefault(mistake_pattern, []).append(section[2] if section else "")
    return [
        mistake_pattern._replace(
            where=mistake_pattern.where.replace("{}", shortened_list(matching_names))
        )
        for mistake_pattern, matching_names in names.items()
    ]


def shortened_list(section_names: Sequence[str]) -> str:
    """Join names to a text with commas.

    If there are more than three names, the text contains the first two names and the number of the
    other names.
    """
    return (
        ", ".join(section_names)
        if len(section_names) <= 3
        else f"{', '.join(section_names[:2])} and {len(section_names) - 2} more"
    )


def lines_by_text(name_text_pairs: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Return one line for each distinct text. A line has the form "names: text".

    The texts keep the order in which they first occur in ``name_text_pairs``.

    Args:
        name_text_pairs: pairs of a name and its text.
    """
    names: dict[str, list[str]] = {}
    for name, text in name_text_pairs:
        names.setdefault(text, []).append(name)
    return tuple(f"{shortened_list(names[text])}: {text}" for text in names)


def _path_in_file(path: str, origin_of_path: Mapping[str, str]) -> str:
    """Convert a key path of a hand file's resolved content to the key path in the hand file.

    Some prefixes of the key path are keys of ``origin_of_path``. The function replaces the longest
    of these prefixes. The rest of the key path is unchanged.
    """
    known_path = path
    while known_path:
        if known_path in origin_of_path:
            return origin_of_path[known_path] + path[len(known_path) :]
        known_path = (
            known_path[: max(known_path.rfind("."), known_path.rfind("["))]
            if re.search(r"[.\[]", known_path)
            else ""
        )
    return path


def key_path(content: Any, key_location: Sequence[str | int]) -> str:
    """Return a readable key path such as ``digit[index].link_mass_kg[1]``, in which list entries have names."""
    path = ""
    for key_or_index in key_location:
        try:
            content = content[key_or_index]
        except (KeyError, IndexError, TypeError):
            content = None
        if isinstance(key_or_index, int):
            name = content.get("name") if isinstance(content, Mapping) else None
            path += f"[{name if isinstance(name, str) and name else key_or_index}]"
        else:
            path += f".{key_or_index}" if path else key_or_index
    return path


def toml_spelling(value: Any) -> str:
    """Return a value as TOML text, shortened if the text is long."""
    text = (
        str(value).lower()
        if isinstance(value, bool)
        else f'"{value}"'
        if isinstance(value, str)
        else repr(value)
    )
    return text if len(text) <= 60 else text[:57] + "..."


def _valid_keys_of_table(model: type[BaseModel], key_location: Sequence[str | int]) -> list[str]:
    """Return the valid keys of the table at a location in a file."""
    for key_or_index in key_location:
        if isinstance(key_or_index, str):
            model = next(
                m for m in _models_in_annotation(model.model_fields[key_or_index].annotation)
            )
    return [field.alias or name for name, field in model.model_fields.items()]


def _models_in_annotation(type_annotation: Any) -> list[type[BaseModel]]:
    """Return the pydantic models that a type annotation such as ``tuple[Digit, ...]`` contains."""
    if isinstance(type_annotation, type) and issubclass(type_annotation, BaseModel):
        return [type_annotation]
    return [
        model
        for inner_annotation in getattr(type_annotation, "__args__", ())
        for model in _models_in_annotation(inner_annotation)
    ]


def most_similar_valid_key(key: str, valid_keys: list[str]) -> str:
    """Return the valid key that is most similar to a key.

    If no valid key is similar, return all valid keys.
    """
    return similar_name(key, valid_keys) or "one of " + ", ".join(valid_keys)
