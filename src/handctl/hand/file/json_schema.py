"""JSON Schema of hand files, for completion and checks in editors.

``handctl config schema`` prints the schema.
"""

import json
from copy import deepcopy
from typing import Any

from handctl.hand.description import Hand
from handctl.hand.file.key_descriptions import SchemaWithDescriptions
from handctl.hand.file.templates import (
    ALL_NAMES_KEYWORD,
    KEYS_ACCEPTING_ONE_VALUE,
    SCHEMA_WITH_TEMPLATES,
    SCHEMA_WITHOUT_TEMPLATES,
    SECTION_KINDS,
    TABLE_KINDS_IN_DIGIT,
    TEMPLATE_KEYS,
)

SCHEMA_DRAFT = "http://json-schema.org/draft-07/schema#"
"""Identifier of the JSON Schema version 7, which TOML editors support."""
SECTION_DEFINITIONS = {"digit": "Digit", "tendon": "Tendon", "motor": "Motor"}
"""Name of the schema's definition for each kind of section."""
VALUE_DEFINITIONS = {kind: f"{name}Values" for kind, name in SECTION_DEFINITIONS.items()}
"""Name of the schema's definition for values in a default, a template, or a table within a digit, by section kind."""


def hand_schema() -> dict[str, Any]:
    """Return the JSON Schema of hand files with the format version ``schema = 2``.

    Hand files with ``schema = 1`` also satisfy the JSON Schema.

    In the JSON Schema, every key of a digit, tendon or motor is optional, because a default or
    template can contain the value. ``handctl config check`` reports missing keys.
    """
    schema = Hand.model_json_schema(by_alias=True, schema_generator=SchemaWithDescriptions)
    definitions = schema["definitions"] = schema.pop("$defs")
    for kind, name in SECTION_DEFINITIONS.items():
        definition = definitions[name]
        if kind == "digit":
            _add_short_forms_of_digit(definition)
        definition["properties"]["template"] = {
            "type": "string",
            "description": f"Name of a table [{TEMPLATE_KEYS[kind]}.NAME] with values that this section does not have.",
        }
        definition["required"] = ["name"]
        values = deepcopy(definition)
        del values["required"], values["properties"]["name"]
        values["title"] = VALUE_DEFINITIONS[kind]
        definitions[VALUE_DEFINITIONS[kind]] = values
    node = definitions["SensorNode"]["properties"]
    for key in ("tendons", "joints"):
        node[key] = {
            "description": node[key].pop("description"),
            "anyOf": [{"const": ALL_NAMES_KEYWORD}, node[key]],
        }
    properties = schema["properties"]
    properties["schema"] = {
        "enum": [SCHEMA_WITH_TEMPLATES, SCHEMA_WITHOUT_TEMPLATES],
        "description": "Version of the format.",
    }
    properties["default"] = {
        "type": "object",
        "description": "Values of all digits, tendons or motors that do not have their own.",
        "properties": {kind: _schema_reference(VALUE_DEFINITIONS[kind]) for kind in SECTION_KINDS},
        "additionalProperties": False,
    }
    for kind, key in TEMPLATE_KEYS.items():
        properties[key] = _table_array_schema(
            kind, f"Values of each {kind} that names the template."
        )
    optional_sections = (*TABLE_KINDS_IN_DIGIT, "sensor_node")
    schema["required"] = [key for key in schema["required"] if key not in optional_sections]
    return {
        "$schema": SCHEMA_DRAFT,
        **_convert_to_draft_7(schema),
        "title": "Hand file of handctl",
    }


def hand_schema_text() -> str:
    """Return the text of the JSON Schema of hand files."""
    return json.dumps(hand_schema(), indent=1, sort_keys=True) + "\n"


def _add_short_forms_of_digit(digit_schema: dict[str, Any]) -> None:
    """Add the short forms of hand-file schema 2 to the JSON Schema of a digit.

    In a short form, the digit contains its tendons and motors, or a single number stands for a
    list. Hand files of schema 1 must not contain short forms.
    """
    properties = digit_schema["properties"]
    for kind in TABLE_KINDS_IN_DIGIT:
        properties[kind] = _table_array_schema(
            kind, f"Each {kind} of this digit, named DIGIT_NAME."
        )
    for key in KEYS_ACCEPTING_ONE_VALUE:
        list_schema = properties[key]
        element_schema = next(
            subschema["items"]
            for subschema in (list_schema, *list_schema.get("anyOf", ()))
            if "items" in subschema
        )
        properties[key] = {
            "anyOf": [element_schema, {"type": "array", "items": element_schema}],
            "description": list_schema["description"],
        }


def _table_array_schema(section_kind: str, description: str) -> dict[str, Any]:
    """Return the JSON Schema of a table of named tables of one kind."""
    return {
        "type": "object",
        "description": description,
        "additionalProperties": _schema_reference(VALUE_DEFINITIONS[section_kind]),
    }


def _schema_reference(name: str) -> dict[str, Any]:
    """Return a reference to a definition of the JSON Schema."""
    return {"$ref": f"#/definitions/{name}"}


def _convert_to_draft_7(schema_node: Any) -> Any:
    """Convert a JSON Schema to the keywords of draft 7.

    Titles that only repeat a key are removed from the schema.
    """
    if isinstance(schema_node, list):
        return [_convert_to_draft_7(entry) for entry in schema_node]
    if not isinstance(schema_node, dict):
        return schema_node
    if "prefixItems" in schema_node:
        schema_node = {**schema_node, "items": schema_node["prefixItems"]}
        del schema_node["prefixItems"]
    if isinstance(schema_node.get("$ref"), str):
        # In draft 7, a reference makes all other keywords of the same object ineffective.
        schema_node = {"$ref": schema_node["$ref"].replace("#/$defs/", "#/definitions/")}
    return {
        key: value.replace("``", "`")
        if key == "description" and isinstance(value, str)
        else _convert_to_draft_7(value)
        for key, value in schema_node.items()
        if key != "title" or not isinstance(value, str) or value.endswith("Values")
    }
