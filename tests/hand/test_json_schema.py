"""Test the JSON Schema that editors read.

The generated JSON Schema equals the packaged schema file, accepts valid hand files, and refuses
wrong values.
"""

import copy
import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest

import handctl
from handctl.cli.main import main
from handctl.hand.file.json_schema import hand_schema
from handctl.hand.hand_loading import (
    PACKAGED_HANDS_FOLDER,
    hand_path,
    load_hand,
    packaged_hands,
    parse_toml,
    read_toml,
)

PACKAGED_SCHEMA_FILE = Path(handctl.__file__).parent / "hand" / "hand.schema.json"
SCHEMA_VALIDATOR = jsonschema.Draft7Validator(hand_schema())


def with_lists_for_tuples(content: dict[str, Any]) -> Any:
    """Return a hand's content with lists in place of tuples."""
    return json.loads(json.dumps(content))


def jamia11_content_with_value(key_path: tuple[Any, ...], new_value: Any) -> dict[str, Any]:
    """Return the content of jamia11 with one value replaced."""
    content = copy.deepcopy(read_toml(hand_path("jamia11")))
    node: Any = content
    for key in key_path[:-1]:
        node = node[key]
    node[key_path[-1]] = new_value
    return content


def test_the_packaged_file_is_fresh() -> None:
    text = "stale; run python -m tools.reference"
    assert json.loads(PACKAGED_SCHEMA_FILE.read_text("utf-8")) == hand_schema(), text


def test_json_schema_is_valid() -> None:
    jsonschema.Draft7Validator.check_schema(hand_schema())


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_good_files_of_both_schemas_suit_it(hand_name: str) -> None:
    path = hand_path(hand_name)
    SCHEMA_VALIDATOR.validate(read_toml(path))
    SCHEMA_VALIDATOR.validate(
        with_lists_for_tuples(parse_toml(load_hand(hand_name).to_toml(), "resolved"))
    )
    first_line = path.read_text("utf-8").splitlines()[0]
    assert (
        PACKAGED_HANDS_FOLDER / first_line.removeprefix("#:schema ")
    ).resolve() == PACKAGED_SCHEMA_FILE.resolve()


WRONG_VALUES = {
    "a value in millimetres": (("digit_template", "finger", "link_length_m", 0), 30),
    "a value in millimetres for all links": (("default", "digit", "link_com_m"), 15),
    "an unknown key of a default": (("default", "tendon", "kneeN"), 200.0),
    "an unknown kind of default": (("default", "motors"), {}),
    "an unknown key of a tendon within a digit": (
        ("digit_template", "finger", "tendon", "t1", "colour"),
        1,
    ),
    "a node number out of range": (("digit", 0, "motor", "m1", "node_id"), 128),
    "a direction": (("default", "motor", "direction"), 0),
    "a fractional watchdog": (("default", "motor", "watchdog_ms"), 2.5),
    "a name with a blank": (("digit", 0, "name"), "index finger"),
    "a word for all load cells": (("sensor_node", "tendons"), "every"),
    "three numbers of gravity": (("mount", "gravity_m_s2"), [0.0, -9.81]),
    "the schema of tomorrow": (("schema",), 3),
    "no name": (("digit", 0), {"template": "finger"}),
}


@pytest.mark.parametrize(
    ("key_path", "wrong_value"), WRONG_VALUES.values(), ids=WRONG_VALUES.keys()
)
def test_json_schema_rejects_mistakes(key_path: tuple[Any, ...], wrong_value: Any) -> None:
    assert not SCHEMA_VALIDATOR.is_valid(jamia11_content_with_value(key_path, wrong_value))


def test_every_key_has_a_description() -> None:
    schema = hand_schema()
    for name, definition in schema["definitions"].items():
        for key, value in definition["properties"].items():
            assert value.get("description") or "$ref" in value, f"{name}.{key}"


def test_config_schema_prints_or_writes_the_schema(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["config", "schema"]) == 0
    assert json.loads(capsys.readouterr().out) == hand_schema()
    assert main(["config", "schema", "--output", "hand.schema.json"]) == 0
    assert "#:schema hand.schema.json" in capsys.readouterr().out
    assert json.loads((tmp_path / "hand.schema.json").read_text()) == hand_schema()
    assert main(["config", "schema", "--output", "hand.schema.json"]) == 2
