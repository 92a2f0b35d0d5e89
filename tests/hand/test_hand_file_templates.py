"""Test schema 2 of hand files.

A file with defaults and templates gives the same hand as a file in which all values are written
out.
"""

import copy
from typing import Any

import pytest

from firmware_sim.description.hand_description import load_hand as simulated
from handctl.hand.description import Hand
from handctl.hand.file.error_text import FileMistake
from handctl.hand.file.templates import resolve_templates
from handctl.hand.hand_loading import (
    PACKAGED_HANDS_FOLDER,
    hand_content,
    hand_path,
    load_hand,
    packaged_hands,
    read_toml,
    validate_content,
)

IDENTITY_BY_HAND = {
    "jamia": "dfe326d335b4750c9691d04677693432890e51d12d456e868647810bddb4c49c",
    "jamia11": "879de7b39ebe29ed6f7c866c9bb0d4f94a6f97beb1d86836c60a6ca0b420694a",
    "jamia_bench": "1363c530f1eb4516b007634ba69ed61610e9ce4537fb2d76b345e61737af9f44",
}
"""Identities (hashes) of the packaged hands from the time when their files had schema 1.

Existing calibrations and logs refer to the identity of a hand.
"""
MAX_FILE_LINES = 120
"""Largest number of lines of a packaged hand file."""
MAX_FILE_LINES_BY_HAND_NAME = {"orca_like": 175}
"""Largest number of lines of larger packaged hand files. ``orca_like`` has 17 joints and three kinds of digits."""


def jamia_hand_content() -> dict[str, Any]:
    """Return the content of jamia.toml as it is packaged, with its defaults and templates."""
    return read_toml(hand_path("jamia"))


def build_valid_hand(content: dict[str, Any]) -> Hand:
    """Build a hand from a content, and check that the content has no mistakes."""
    hand, mistakes = validate_content(content)
    assert not mistakes
    assert hand
    return hand


@pytest.mark.parametrize("hand_name", IDENTITY_BY_HAND)
def test_the_packaged_hands_keep_their_identity(hand_name: str) -> None:
    assert load_hand(hand_name).identity == IDENTITY_BY_HAND[hand_name]


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_a_packaged_file_is_short(hand_name: str) -> None:
    assert len(
        (PACKAGED_HANDS_FOLDER / f"{hand_name}.toml").read_text("utf-8").splitlines()
    ) < MAX_FILE_LINES_BY_HAND_NAME.get(hand_name, MAX_FILE_LINES)


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_the_resolved_hand_is_a_file_of_schema_1_for_controller_and_simulator(
    hand_name: str, tmp_path: Any
) -> None:
    path = tmp_path / "flat.toml"
    path.write_text(load_hand(hand_name).to_toml())
    assert read_toml(path)["schema"] == 1
    assert load_hand(path).identity == load_hand(hand_name).identity
    assert simulated(str(path)) == simulated(hand_name)


def test_a_section_replaces_its_template_and_the_template_the_default() -> None:
    content = jamia_hand_content()
    content["default"]["digit"]["link_radius_m"] = 0.006
    content["digit_template"]["finger"]["link_radius_m"] = 0.005
    content["digit"][1]["link_radius_m"] = 0.003
    assert [digit.link_radius_m for digit in build_valid_hand(content).digit] == [
        0.005,
        0.003,
        0.005,
        0.006,
    ]


def test_tables_are_merged_key_by_key() -> None:
    content = jamia_hand_content()
    content["digit"][0]["tendon"] = {"tendon": {"knee_N": 150.0, "moment_arm_m": {"j3": 0.002}}}
    first_tendon, second_tendon, *_ = build_valid_hand(content).tendon
    assert first_tendon.moment_arm_m == {"index_j1": 0.003, "index_j2": 0.003, "index_j3": 0.002}
    assert (first_tendon.knee_N, second_tendon.knee_N) == (150.0, 200.0)


def test_tendons_and_motors_have_templates_too() -> None:
    content = jamia_hand_content()
    content["tendon_template"] = {"thin": {"rated_breaking_force_N": 300.0}}
    content["motor_template"] = {"slow": {"velocity_range_rad_s": 30.0}}
    content["digit_template"]["finger"]["tendon"]["tendon"]["template"] = "thin"
    content["digit"][0]["motor"]["motor"]["template"] = "slow"
    hand = build_valid_hand(content)
    assert [tendon.rated_breaking_force_N for tendon in hand.tendon] == [300.0, 300.0, 300.0, 620.0]
    assert [motor.velocity_range_rad_s for motor in hand.motor] == [30.0, 50.0, 50.0, 50.0]


def test_tendons_and_motors_may_have_their_own_sections() -> None:
    content = jamia_hand_content()
    thumb = content["digit"][3]
    del thumb["tendon"], thumb["motor"]
    arms = {"thumb_j1": 0.003, "thumb_j2": 0.003}
    content["tendon"] = [{"name": "thumb_tendon", "motor": "thumb_motor", "moment_arm_m": arms}]
    content["motor"] = [{"name": "thumb_motor", "node_id": 4}]
    assert build_valid_hand(content).identity == IDENTITY_BY_HAND["jamia"]


def test_one_number_holds_for_every_link() -> None:
    content = jamia_hand_content()
    content["digit"][0]["joint_max_deg"] = 90
    assert [digit.joint_max_deg for digit in build_valid_hand(content).digit[::3]] == [
        (90.0, 90.0, 90.0),
        (100.0, 100.0),
    ]


def test_the_key_all_means_every_tendon_and_joint() -> None:
    hand = load_hand("jamia11")
    assert (hand.sensor_node.tendons, hand.sensor_node.joints) == (hand.tendon_names, hand.joints)


def test_no_two_sections_share_a_list() -> None:
    content = hand_content("jamia")
    content["digit"][0]["link_mass_kg"][0] = 1.0
    content["digit"][0]["coupling"][0][0] = 2.0
    assert content["digit"][1] == {**hand_content("jamia")["digit"][1]}


def test_resolving_templates_does_not_change_its_argument() -> None:
    content = jamia_hand_content()
    original_content = copy.deepcopy(content)
    resolve_templates(content)
    assert content == original_content


def test_resolved_content_is_resolved_already() -> None:
    content = hand_content("jamia11")
    assert resolve_templates(content).content == content


def test_a_deeply_nested_table_is_reported_without_a_crash() -> None:
    content = jamia_hand_content()
    nested_table: dict[str, Any] = {}
    for _ in range(5000):
        nested_table = {"a": nested_table}
    content["default"]["tendon"]["a"] = nested_table
    content["digit_template"]["finger"]["tendon"]["tendon"]["a"] = nested_table
    assert [mistake.where for mistake in validate_content(content)[1]] == [
        "digit_template.finger.tendon.tendon.a",
        "default.tendon.a",
    ]


@pytest.mark.parametrize(
    ("table", "misspelt_name"),
    [("default", "defaults"), ("default", "deafult"), ("digit_template", "digit_templates")],
)
def test_a_misspelt_table_of_defaults_or_templates_is_one_mistake(
    table: str, misspelt_name: str
) -> None:
    content = jamia_hand_content()
    content[misspelt_name] = content.pop(table)
    _, mistakes = validate_content(content)
    assert mistakes == [FileMistake("unknown key", misspelt_name, f"{table}?")]


def test_a_misspelt_table_beside_the_right_one_is_one_mistake() -> None:
    content = jamia_hand_content()
    content["defaults"] = {"tendon": content["default"].pop("tendon")}
    _, mistakes = validate_content(content)
    assert mistakes == [FileMistake("unknown key", "defaults", "default?")]
