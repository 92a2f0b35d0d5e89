"""Generate the blocks about files and requests from their pydantic models."""

from collections.abc import Iterable, Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError

from handctl.core.gains.gain_bounds import (
    COMMON_KEY_BY_FORCE,
    GAIN_SECTIONS,
    TENDON_SECTION,
    bounds_of_key,
    gain_bounds,
)
from handctl.core.gains.gains import Gains, TendonForces
from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.drives.protocol_registry import PROTOCOL_ENTRIES
from handctl.hand.description import Hand
from handctl.hand.file.key_descriptions import key_description
from handctl.programs.requests import CommandRequestBase, Request
from tools.reference.markdown import markdown_table, prose_markdown, quoted_code

KEY_MEANINGS = {
    "move.angle_deg": "Angle of each digit [deg].",
    "move.duration_s": "Duration of the motion [s].",
    "hold.tension_N": "Tension of each digit [N].",
    "hold.rate_N_per_s": "Rate of the tension [N/s].",
}
"""Meanings of the keys that have no description in a pydantic model."""
KEY_VALUES = {"hand.schema": "1 or 2"}
"""Valid values of keys for which a file may contain more values than the pydantic model permits.

The model describes the content of a file after all defaults and templates were applied.
"""
OPTIONAL_KEYS = ("hand.sensor_node",)
"""Keys that are optional in a file although the pydantic model requires these keys."""
SHORT_MESSAGES = {
    "a name of letters, digits and _ that begins with a letter": "a name",
    "a whole number from 1 to 1": "1",
}
"""Shorter forms of messages that pydantic validators print.

The page itself explains what a valid name is.
"""


def hand_file_sections() -> str:
    """Return a section for each table of a hand file, with a row for each key."""
    sections = ["## The file", _keys_table(Hand, "hand")]
    for name, field in Hand.model_fields.items():
        models = [
            inner_type
            for inner_type in _inner_types(field.annotation)
            if isinstance(inner_type, type) and issubclass(inner_type, BaseModel)
        ]
        for model in models:
            brackets = f"[[{name}]]" if get_origin(field.annotation) is tuple else f"[{name}]"
            sections += [
                f"## `{brackets}`",
                prose_markdown(model.__doc__),
                _keys_table(model, name),
            ]
    return "\n\n".join(sections)


def motor_option_sections() -> str:
    """Return a section for the options of each protocol, with a row for each option."""
    sections = []
    for name, traits in PROTOCOL_TRAITS.items():
        rows = [
            (quoted_code(key), option.value_text, option.meaning)
            for key, option in PROTOCOL_ENTRIES[name].options.items()
        ]
        sections.append(f'### `protocol = "{name}"`: {traits.title}')
        sections.append(
            markdown_table(("option", "value", "meaning"), rows)
            if rows
            else "This protocol has no options."
        )
    return "\n\n".join(sections)


def _keys_table(model: type[BaseModel], section: str) -> str:
    """Return a Markdown table of the keys of a model."""
    rows = [(quoted_code(field.alias or name), *_key_row(model, name, f"{section}.{field.alias or name}"))
            for name, field in model.model_fields.items()]  # fmt: skip
    return markdown_table(("key", "value", "required", "meaning"), rows)


def _key_row(model: type[BaseModel], name: str, key: str) -> tuple[str, str, str]:
    """Return three table cells about a key: its valid values, whether a file must contain it, and its meaning.

    Raises:
        KeyError: the key has neither a description in its model nor an entry in KEY_MEANINGS.
    """
    field = model.model_fields[name]
    required = "yes" if field.is_required() and key not in OPTIONAL_KEYS else "no"
    annotation = (
        Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
    )
    return (
        KEY_VALUES.get(key) or value_text(annotation),
        required,
        prose_markdown(key_description(model, name)) or KEY_MEANINGS[key],
    )


def _inner_types(annotation: Any) -> Iterator[Any]:
    """Yield all types within a type annotation."""
    arguments = get_args(annotation)
    if not arguments:
        yield annotation
    for type_argument in arguments:
        yield from _inner_types(type_argument)


def value_text(annotation: Any) -> str:
    """Return the valid values of a type annotation in words.

    A type annotation has no readable text about its range. This function therefore validates a
    wrong value, and takes the range from the error message.
    """
    origin = get_origin(annotation)
    arguments = [
        type_argument for type_argument in get_args(annotation) if type_argument is not NoneType
    ]
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "a table"
    if origin is tuple:
        return _list_text(arguments)
    if origin is UnionType or NoneType in get_args(annotation):
        return " or ".join(map(value_text, arguments))
    if origin is dict:
        return f"a table of {value_text(arguments[1])}"
    if origin is Annotated and (
        get_origin(arguments[0]) is tuple or NoneType in get_args(arguments[0])
    ):
        return value_text(arguments[0])
    return _expected_text(annotation)


def _list_text(arguments: list[Any]) -> str:
    """Return the valid values of a tuple in words."""
    inner_definition = value_text(arguments[0])
    if inner_definition == "a table":
        return "tables"
    count = "" if Ellipsis in arguments else f"{len(arguments)} values, "
    return (
        f"a list of lists, {inner_definition}"
        if get_origin(arguments[0]) is tuple
        else f"a list, {count}each {inner_definition}"
    )


def _expected_text(annotation: Any) -> str:
    """Return the description of the valid values of a type.

    The description comes from the error message that the validator of the type returns.
    """
    try:
        TypeAdapter(annotation).validate_python(object())
    except ValidationError as error:
        text = str(error.errors()[0].get("ctx", {}).get("right") or error.errors()[0]["msg"])
        return SHORT_MESSAGES.get(text, text)
    return "any value"


def gains_sections() -> str:
    """Return a section for each table of a gains file, with bounds, default and meaning of each key."""
    sections = []
    for section in GAIN_SECTIONS:
        model = Gains.model_fields[section].annotation
        keys = [bound for key, bound in gain_bounds().items() if key.startswith(f"{section}.")]
        change_time = "during a run" if keys[0].is_changeable_live else "before a run only"
        rows = (
            (quoted_code(b.key), f"{b.default:g}", str(b), prose_markdown(b.meaning)) for b in keys
        )
        sections += [
            f"## `[{section}]`",
            f"{prose_markdown(getattr(model, '__doc__', ''))}\n\nChanges: {change_time}.",
        ]
        sections.append(markdown_table(("gain", "default", "bounds", "meaning"), rows))
    sections += [
        f"## `[[{TENDON_SECTION}]]`",
        f"{prose_markdown(TendonForces.__doc__)}\n\nChanges: during a run.",
    ]
    forces = []
    for field, shared in COMMON_KEY_BY_FORCE.items():
        if bound := bounds_of_key(f"{TENDON_SECTION}.NAME.{field}"):
            forces.append(
                (
                    quoted_code(bound.key),
                    quoted_code(shared),
                    str(bound),
                    prose_markdown(bound.meaning),
                )
            )
    sections.append(markdown_table(("gain", "default", "bounds", "meaning"), forces))
    return "\n\n".join(sections)


def request_sections() -> str:
    """Return a section for each request, with a row for each field."""
    sections = []
    for model in get_args(Request):
        do = get_args(model.model_fields["do"].annotation)[0]
        rows = list(_field_rows(model, do))
        sections += [f"## `{do}`", prose_markdown(model.__doc__)]
        sections += [markdown_table(("field", "value", "default", "meaning"), rows)] if rows else []
    return "\n\n".join(sections)


def _field_rows(model: type[BaseModel], request_word: str) -> Iterable[tuple[str, str, str, str]]:
    """Yield a row for each field of a request, except the fields that all requests have."""
    schema = model.model_json_schema()["properties"]
    for name, field in model.model_fields.items():
        if name == "do" or name in CommandRequestBase.model_fields:
            continue
        default = "required" if field.is_required() else str(field.default).removesuffix(".0")
        meaning = (
            prose_markdown(key_description(model, name)) or KEY_MEANINGS[f"{request_word}.{name}"]
        )
        yield quoted_code(name), _bounds_text(schema[name]), default, meaning


def _bounds_text(schema: dict[str, Any]) -> str:
    """Return the valid values of a JSON schema in words."""
    if "enum" in schema:
        return " or ".join(quoted_code(value) for value in schema["enum"])
    if schema.get("type") == "array":
        return f"a list of at most {schema['maxItems']}, each {_bounds_text(schema['items'])}"
    if schema.get("type") == "object":
        return f"a table, each {_bounds_text(schema['additionalProperties'])}"
    limits = {
        "minimum": "at least",
        "exclusiveMinimum": "more than",
        "maximum": "at most",
        "exclusiveMaximum": "below",
    }
    texts = [f"{words} {schema[key]:g}" for key, words in limits.items() if key in schema]
    return ", ".join([f"a {schema.get('type', 'value')}", *texts])
