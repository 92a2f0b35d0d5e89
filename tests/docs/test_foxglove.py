"""Test that the layout file for Foxglove contains only topics and fields that a log has.

In the layout, the label of a value consists of the name and the unit of this value.
"""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

REPOSITORY_ROOT = Path(__file__).parents[2]
FOXGLOVE_LAYOUT = json.loads(
    (REPOSITORY_ROOT / "docs" / "how-to" / "foxglove-layout.json").read_text(encoding="utf-8")
)
LAYOUT_PANELS = FOXGLOVE_LAYOUT["configById"]
MESSAGE_PATH_PATTERN = re.compile(r"(/[a-z_/]+)\.([a-z]+)(?:\[(\d+)\])?")
PANEL_KINDS = {"3D", "Plot", "RosOut", "StateTransitions"}
"""Kinds of panels, with the names that Foxglove itself writes when it exports a layout."""


def panel_names(layout_node: Any) -> list[str]:
    """Return the names of all panels below a node of the layout tree."""
    return (
        [layout_node]
        if isinstance(layout_node, str)
        else [*panel_names(layout_node["first"]), *panel_names(layout_node["second"])]
    )


@pytest.fixture(scope="module")
def first_messages() -> dict[str, Any]:
    """Return the last message of each topic of a golden log."""
    message_by_topic: dict[str, Any] = {}
    with (REPOSITORY_ROOT / "logs" / "golden" / "jamia-grasp.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(topics_of_layout()):
            message_by_topic[channel.topic] = message
    return message_by_topic


def message_paths() -> list[tuple[str, str]]:
    """Return the message path and the label of each value that the Foxglove layout shows."""
    return [
        (path["value"], path["label"])
        for panel in LAYOUT_PANELS.values()
        for path in panel.get("paths", [])
    ]


def topics_of_layout() -> set[str]:
    """Return the topics that the panels of the Foxglove layout show, except the topics with transforms."""
    scene = LAYOUT_PANELS["3D!hand"]
    topics = {MESSAGE_PATH_PATTERN.fullmatch(value)[1] for value, _ in message_paths()}  # type: ignore[index]
    return (
        topics
        | {layer["topic"] for layer in scene["layers"].values()}
        | {LAYOUT_PANELS["RosOut!events"]["topicToRender"]}
    )


def test_every_panel_has_its_place() -> None:
    assert sorted(panel_names(FOXGLOVE_LAYOUT["layout"])) == sorted(LAYOUT_PANELS)
    assert {name.partition("!")[0] for name in LAYOUT_PANELS} == PANEL_KINDS


def test_every_topic_is_in_a_log(first_messages: dict[str, Any]) -> None:
    assert set(first_messages) == topics_of_layout()


def test_every_value_is_the_one_of_its_label(first_messages: dict[str, Any]) -> None:
    for value, label in message_paths():
        topic, field, entry = MESSAGE_PATH_PATTERN.fullmatch(value).groups()  # type: ignore[union-attr]
        message = first_messages[topic]
        if entry is None:
            assert isinstance(getattr(message, field), str), value
        else:
            float(getattr(message, field)[int(entry)])
            name = re.split(r"[ ,]", label)[0]
            assert message.name[int(entry)].removesuffix("_tendon") == name, value
            assert label.endswith("[rad]" if topic == "/joint_states" else "[N]")


def test_the_hand_is_drawn_in_a_frame_of_its_links(first_messages: dict[str, Any]) -> None:
    assert (
        f'link name="{LAYOUT_PANELS["3D!hand"]["followTf"]}"'
        in first_messages["/robot_description"].data
    )
