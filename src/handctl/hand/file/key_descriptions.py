"""Descriptions of the keys in hand files and gains files.

The descriptions are the docstrings after the fields of the pydantic models.

pydantic can store the docstrings in the fields of a model (``use_attribute_docstrings``). With the
option ``use_attribute_docstrings``, every process would parse the source code of every model.
Instead of pydantic, this module parses the source code, and only when a description is needed.
"""

import ast
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import pairwise
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema


def key_description(model: type[BaseModel], field_name: str) -> str:
    """Return the description of a field, or an empty text if the field has no description.

    Args:
        model: model to which the field belongs.
        field_name: name of the attribute, which can differ from the key in the file.
    """
    return field_docstrings(model).get(field_name, "")


@cache
def field_docstrings(model: type[BaseModel]) -> Mapping[str, str]:
    """Return the docstrings of the fields of a model and its base classes, by the name of the attribute."""
    docstring_by_field: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if issubclass(base, BaseModel) and base is not BaseModel:
            docstring_by_field |= _docstrings_in(base)
    return {name: text for name, text in docstring_by_field.items() if name in model.model_fields}


def _docstrings_in(model: type[BaseModel]) -> dict[str, str]:
    """Return the docstrings of the attributes of a class.

    Return an empty dictionary if the source code of the class cannot be found.
    """
    try:
        source = inspect.getsource(model)
    except OSError:
        return {}
    (definition,) = ast.parse(textwrap.dedent(source)).body
    assert isinstance(definition, ast.ClassDef)
    return dict(_documented_attributes(definition.body))


def _documented_attributes(class_body: list[ast.stmt]) -> Iterator[tuple[str, str]]:
    """Yield the name and the docstring of each attribute that has a docstring."""
    for statement, following in pairwise(class_body):
        match statement, following:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(
                value=ast.Constant(value=str(text))
            ):
                yield name, inspect.cleandoc(text)


class SchemaWithDescriptions(GenerateJsonSchema):
    """Generator of a JSON Schema that contains the description of each key."""

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """Return the JSON Schema of a model."""
        result = super().model_schema(schema)
        model: type[BaseModel] = schema["cls"]
        properties: dict[str, Any] = result.get("properties", {})
        for name, text in field_docstrings(model).items():
            key = (model.model_fields[name].alias or name) if self.by_alias else name
            if key in properties:
                properties[key]["description"] = text
        return result
