"""Test the errors for documents with mistakes, such as hand files.

For each kind of mistake, the test compares the complete error line with the expected line.
"""

import datetime
from typing import Annotated, Any, Literal

import pytest
from pydantic import Field, field_validator

from handctl.document import Document, validate_content
from handctl.errors import ConfigError


class ExampleMoveStep(Document):
    """Step of an example plan: a move with a speed."""

    kind: Literal["move"]
    speed_deg_s: float = Field(gt=0)


class ExampleHoldStep(Document):
    """Step of an example plan, with a tension to hold. The step can contain a spare step of the kind *move*."""

    kind: Literal["hold"]
    tension_N: float
    spare: ExampleMoveStep | None = None


class PartSection(Document):
    """Part of an example plan."""

    name: str
    size_m: float = 1.0


class ExamplePlanDocument(Document):
    """Example document that has a field of each kind."""

    name: str
    part: tuple[PartSection, ...] = ()
    made: str = ""
    step: tuple[Annotated[ExampleMoveStep | ExampleHoldStep, Field(discriminator="kind")], ...] = ()
    point: dict[str, float] = Field(default_factory=dict)
    either: ExampleMoveStep | float = 1.0

    @field_validator("name")
    @classmethod
    def _check_name(cls, plan_name: str) -> str:
        if plan_name == "none":
            raise ValueError("a better name")
        return plan_name


MOVE_CONTENT = {"kind": "move", "speed_deg_s": 1.0}
LINE_BY_MISTAKE: dict[str, tuple[dict[str, Any], str]] = {
    "missing": ({}, "name: missing; expected this key"),
    "missing below": ({"name": "a", "step": [{"kind": "move"}]}, "step[0].speed_deg_s: missing; expected this key"),
    "unknown": ({"name": "a", "nome": 1}, "nome: unknown key; expected name?"),
    "unknown, like two": ({"name": "a", "nade": 1}, "nade: unknown key; expected name?"),
    "unknown, like none": (
        {"name": "a", "xyzzy": 1},
        "xyzzy: unknown key; expected one of either, made, name, part, point, step",
    ),
    "unknown and missing": ({"nme": "a"}, "nme: unknown key; expected name?"),
    "unknown below": (
        {"name": "a", "step": [MOVE_CONTENT, MOVE_CONTENT | {"speed": 3}]},
        "step[1].speed: unknown key; expected speed_deg_s?",
    ),
    # The wrong key of this test case is a valid key of another kind of step. Earlier defect: the
    # error line suggested exactly the key that it refused.
    "unknown in this alternative": (
        {"name": "a", "step": [MOVE_CONTENT | {"tension_N": 1.0}]},
        "step[0].tension_N: unknown key; expected one of kind, speed_deg_s",
    ),
    "unknown in a table of this alternative": (
        {"name": "a", "step": [{"kind": "hold", "tension_N": 1.0, "spare": MOVE_CONTENT | {"tension_N": 1.0}}]},
        "step[0].spare.tension_N: unknown key; expected one of kind, speed_deg_s",
    ),
    "unknown in an alternative without tag": (
        {"name": "a", "either": MOVE_CONTENT | {"sped_deg_s": 1.0}},
        "either.sped_deg_s: unknown key; expected speed_deg_s?",
    ),
    "wrong": ({"name": 3}, "name: 3; expected a valid string"),
    "a table": ({"name": {"a": 1}}, "name: a table; expected a valid string"),
    "a list": ({"name": [1, 2]}, "name: [1, 2]; expected a valid string"),
    "too small": (
        {"name": "a", "step": [MOVE_CONTENT | {"speed_deg_s": -1.5}]},
        "step[0].speed_deg_s: -1.5; expected greater than 0",
    ),
    "refused by its model": ({"name": "none"}, 'name: "none"; expected a better name'),
    "no such alternative": (
        {"name": "a", "step": [{"kind": "jump"}]},
        "step[0].kind: \"jump\"; expected one of 'move', 'hold'",
    ),
    "missing in an alternative by its tag": (
        {"name": "a", "step": [{"kind": "hold", "tension_N": 1.0, "spare": {"kind": "move"}}]},
        "step[0].spare.speed_deg_s: missing; expected this key",
    ),
    "the alternative that was meant": (
        {"name": "a", "either": {"kind": "move", "speed_deg_s": 0}},
        "either.speed_deg_s: 0; expected greater than 0",
    ),
    "in what has a name": (
        {"name": "a", "part": [{"name": "b"}, {"name": "c", "size_m": "big"}]},
        'part[c].size_m: "big"; expected a valid number',
    ),
    "a key of a table": ({"name": "a", "point": {"x y": "b"}}, 'point.x y: "b"; expected a valid number'),
}  # fmt: skip


@pytest.mark.parametrize(
    ("document_content", "expected_message"), LINE_BY_MISTAKE.values(), ids=LINE_BY_MISTAKE.keys()
)
def test_a_mistake_is_a_line(document_content: dict[str, Any], expected_message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        validate_content(document_content, ExamplePlanDocument, "plan.toml")
    assert str(caught.value) == f"plan.toml: {expected_message}"


def test_document_without_a_table_is_refused() -> None:
    with pytest.raises(ConfigError) as caught:
        validate_content([], ExamplePlanDocument, "plan.toml")  # type: ignore[arg-type]
    assert str(caught.value).startswith("plan.toml: []; expected ")


def test_a_date_of_toml_is_taken_as_it_is_written() -> None:
    creation_time = datetime.datetime(2026, 1, 2, 3, 4, 5, tzinfo=datetime.UTC)
    assert (
        validate_content(
            {"name": "a", "made": creation_time}, ExamplePlanDocument, "plan.toml"
        ).made
        == "2026-01-02 03:04:05+00:00"
    )
