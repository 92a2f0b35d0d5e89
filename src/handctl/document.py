"""Documents: validated content of TOML files, for example of task, gains and calibration files.

The attributes of a loaded document cannot be changed. A mistake in a TOML file is reported in one
line with the file, the path of the key, the value and the expected value.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError

from handctl.errors import ConfigError
from handctl.hand.file.error_text import key_path, toml_spelling
from handctl.hand.hand_loading import read_toml
from handctl.printing import similar_name

EXPECTED_SEPARATOR = "; expected "
"""Text between the problem and the valid values in the error of a validator."""


class Document(BaseModel):
    """Base class of the data models of all TOML files.

    All models refuse unknown keys, infinite numbers, and a bool or a text in place of a number.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        strict=True,
        validate_by_name=True,
        validate_by_alias=True,
    )


DocumentT = TypeVar("DocumentT", bound=Document)
MAX_LISTED_KEYS = 12
"""Largest number of valid keys that a message lists."""


def load_document(path: Path, model: type[DocumentT]) -> DocumentT:
    """Read a TOML file, and validate the content.

    Raises:
        ConfigError: the file cannot be read, is not TOML, or has a wrong key or a wrong value.
    """
    return validate_content(read_toml(path), model, str(path))


def validate_content(
    content: Mapping[str, Any], model: type[DocumentT], source_name: str
) -> DocumentT:
    """Validate content that was parsed from TOML.

    The function converts the content to JSON, and lets pydantic validate the JSON text in strict
    mode. This validation accepts a list as a tuple, and 1 as a float, but refuses true as a number.

    Raises:
        ConfigError: a key or a value in the content is wrong.
    """
    try:
        return model.model_validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        raise _error_line(error, model, content, source_name) from None


def _error_line(
    error: ValidationError,
    model: type[BaseModel],
    file_content: Mapping[str, Any],
    source_name: str,
) -> ConfigError:
    """Return the most specific of the errors that pydantic has found in a document.

    If a document has both an unknown key and a missing key, the unknown key is reported, because a
    misspelt key causes both errors. If a document has no unknown key, the error at the deepest
    level of the document is reported. In a union of several models, the deepest error belongs to
    the model that the user meant.
    """
    error_details = error.errors(include_url=False)
    deepest_error = max(
        error_details, key=lambda d: len(_without_tags(file_content, d["loc"], d["type"]))
    )
    error_detail = next((d for d in error_details if d["type"] == "extra_forbidden"), deepest_error)
    location = _without_tags(file_content, error_detail["loc"], error_detail["type"])
    location_text = (
        f"{source_name}: {key_path(file_content, location)}" if location else source_name
    )
    if error_detail["type"] == "extra_forbidden":
        return ConfigError(
            "unknown key",
            location_text,
            _expected_key(str(location[-1]), model, error_detail["loc"][:-1]),
        )
    if error_detail["type"] == "missing":
        return ConfigError("missing", location_text, "this key")
    value = error_detail["input"]
    if error_detail["type"] == "union_tag_invalid":
        key = error_detail["ctx"]["discriminator"].strip("'")
        return ConfigError(
            toml_spelling(value[key]),
            f"{location_text}.{key}",
            "one of " + error_detail["ctx"]["expected_tags"],
        )
    expected = error_detail["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    # The message of a validator of a whole table also describes the mistake, because the table
    # itself does not show the mistake.
    problem_text, separator, right = expected.partition(EXPECTED_SEPARATOR)
    if separator:
        return ConfigError(problem_text, location_text, right)
    problem_text = "a table" if isinstance(value, Mapping) else toml_spelling(value)
    return ConfigError(problem_text, location_text, expected)


def _without_tags(
    file_content: Any, key_location: Sequence[str | int], kind: str
) -> tuple[str | int, ...]:
    """Return the location of an error without the names that pydantic adds for the models of a union.

    Each part of the returned location is a key or an index that the content of the file contains.
    If the error is a missing key, the last part of the location is the missing key.
    """
    path: list[str | int] = []
    for position, key_or_index in enumerate(key_location):
        is_missing_key = kind == "missing" and position == len(key_location) - 1
        is_known_part = isinstance(key_or_index, int) or (
            isinstance(file_content, Mapping) and key_or_index in file_content
        )
        if not is_known_part and not (is_missing_key and isinstance(file_content, Mapping)):
            continue
        path.append(key_or_index)
        try:
            file_content = file_content[key_or_index]
        except (KeyError, IndexError, TypeError):
            file_content = None
    return tuple(path)


def _expected_key(key: str, model: type[BaseModel], key_location: Sequence[str | int]) -> str:
    """Return the key that was probably meant, or all keys that are allowed in the same table."""
    valid_keys = sorted(_allowed_keys(model, key_location) or _allowed_keys(model, ()))
    similar_word = similar_name(key, valid_keys)
    if similar_word:
        return f"{similar_word}?"
    return (
        f"one of {', '.join(valid_keys)}"
        if len(valid_keys) <= MAX_LISTED_KEYS
        else "a documented key"
    )


def _allowed_keys(type_annotation: Any, key_location: Sequence[str | int]) -> set[str]:
    """Return the keys of the table at a location of a document.

    Args:
        type_annotation: type of the content, as annotated in the model of the document.
        key_location: location of the table as pydantic reports it, with the names of the models of
            unions.
    """
    if isinstance(type_annotation, type) and issubclass(type_annotation, BaseModel):
        fields = {
            field.alias or name: field for name, field in type_annotation.model_fields.items()
        }
        if not key_location:
            return set(fields)
        first_key, *remaining_keys = key_location
        if first_key in fields:
            return _allowed_keys(fields[str(first_key)].annotation, remaining_keys)
        return (
            _allowed_keys(type_annotation, remaining_keys)
            if _is_name_of_union_model(type_annotation, first_key)
            else set()
        )
    arguments = get_args(type_annotation)
    # A list or a table adds a part to the location of a key. A union or an annotated type adds no
    # part.
    is_container = get_origin(type_annotation) in (tuple, list, dict)
    remaining_location = key_location[1:] if is_container else key_location
    if is_container and not key_location:
        return set()
    return set[str]().union(
        *(_allowed_keys(argument, remaining_location) for argument in arguments)
    )


def _is_name_of_union_model(model: type[BaseModel], name: str | int) -> bool:
    """Return True if pydantic uses the given name in error locations for a model of a union.

    In an error location, pydantic names a model of a union by the tag or by the class name of the
    model.
    """
    tags = [get_args(field.annotation) for field in model.model_fields.values()]
    return name == model.__name__ or (name,) in tags
