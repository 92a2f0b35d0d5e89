"""Test the descriptions of hand-file keys, which handctl reads from the source text of the pydantic models."""

from typing import ClassVar

import pytest
from pydantic import BaseModel, ConfigDict, Field

from handctl.hand.file.key_descriptions import (
    SchemaWithDescriptions,
    field_docstrings,
    key_description,
)


class ExampleKeys(BaseModel):
    length_m: float
    """Length, over
    two lines."""
    plain: int = 0


class DerivedExampleKeys(ExampleKeys):
    model_config = ConfigDict(populate_by_name=True)
    LIMIT: ClassVar[int] = 3
    "A string after what is no field."
    law: str = Field("pd", alias="kind")
    """Law."""


def test_docstrings_of_fields_belong_to_the_model_and_its_bases() -> None:
    assert field_docstrings(DerivedExampleKeys) == {
        "length_m": "Length, over\ntwo lines.",
        "law": "Law.",
    }
    assert key_description(DerivedExampleKeys, "plain") == ""


@pytest.mark.parametrize(("by_alias", "documented_key"), [(True, "kind"), (False, "law")])
def test_a_schema_has_the_descriptions_by_key(by_alias: bool, documented_key: str) -> None:
    properties = DerivedExampleKeys.model_json_schema(
        by_alias=by_alias, schema_generator=SchemaWithDescriptions
    )["properties"]
    assert properties[documented_key]["description"] == "Law."
    assert "description" not in properties["plain"]
