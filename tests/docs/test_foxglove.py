"""The layout for Foxglove names only topics and fields that a log has.

It labels each value with the value's name and unit.
"""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

ROOT = Path(__file__).parents[2]
LAYOUT = json.loads((ROOT / "docs" / "how-to" / "foxglove-layout.json").read_text(encoding="utf-8"))
PANELS = LAYOUT["configById"]
PATH = re.compile(r"(/[a-z_/]+)\.([a-z]+)(?:\[(\d+)\])?")
KINDS = {"3D", "Plot", "RosOut", "StateTransitions"}
"""Kinds of Foxglove panels, with their names in a layout that Foxglove exports."""


def leaves(node: Any) -> list[str]:
    """Return the names of all panels in a part of the layout."""
    return [node] if isinstance(node, str) else [*leaves(node["first"]), *leaves(node["second"])]


@pytest.fixture(scope="module")
def messages() -> dict[str, Any]:
    """Return the last message of each topic of a golden log."""
    found: dict[str, Any] = {}
    with (ROOT / "logs" / "golden" / "jamia-grasp.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(topics_of_layout()):
            found[channel.topic] = message
    return found


def paths() -> list[tuple[str, str]]:
    """Return the path and the label of each value in the layout."""
    return [
        (path["value"], path["label"])
        for panel in PANELS.values()
        for path in panel.get("paths", [])
    ]


def topics_of_layout() -> set[str]:
    """Return the topics that the panels show, except those of transforms."""
    scene = PANELS["3D!hand"]
    topics = {PATH.fullmatch(value)[1] for value, _ in paths()}  # type: ignore[index]
    return (
        topics
        | {layer["topic"] for layer in scene["layers"].values()}
        | {PANELS["RosOut!events"]["topicToRender"]}
    )


def test_every_panel_has_its_place() -> None:
    assert sorted(leaves(LAYOUT["layout"])) == sorted(PANELS)
    assert {name.partition("!")[0] for name in PANELS} == KINDS


def test_every_topic_is_in_a_log(messages: dict[str, Any]) -> None:
    assert set(messages) == topics_of_layout()


def test_every_value_is_the_one_of_its_label(messages: dict[str, Any]) -> None:
    for value, label in paths():
        topic, field, entry = PATH.fullmatch(value).groups()  # type: ignore[union-attr]
        message = messages[topic]
        if entry is None:
            assert isinstance(getattr(message, field), str), value
        else:
            float(getattr(message, field)[int(entry)])
            name = re.split(r"[ ,]", label)[0]
            assert message.name[int(entry)].removesuffix("_tendon") == name, value
            assert label.endswith("[rad]" if topic == "/joint_states" else "[N]")


def test_the_hand_is_drawn_in_a_frame_of_its_links(messages: dict[str, Any]) -> None:
    assert f'link name="{PANELS["3D!hand"]["followTf"]}"' in messages["/robot_description"].data
