"""Test the hands that handctl reads from valid hand files, and the error lines for invalid hand files."""

import copy
import re
from pathlib import Path

import numpy as np
import pytest

from handctl.errors import ConfigError
from handctl.hand.hand_loading import (
    PACKAGED_HANDS_FOLDER,
    hand_content,
    hand_from_content,
    load_hand,
    packaged_hands,
)

CONTENT_BY_HAND_NAME = {name: hand_content(name) for name in packaged_hands()}


@pytest.fixture(params=packaged_hands())
def hand(request):
    """Return a packaged hand. A test with this fixture runs once for each packaged hand."""
    return load_hand(request.param)


def content_with_value(hand_content_tree, key_path, new_value):
    """Return a copy of a hand's content with one value replaced."""
    hand_content_tree = copy.deepcopy(hand_content_tree)
    node = hand_content_tree
    for key in key_path[:-1]:
        node = node[key]
    node[key_path[-1]] = new_value
    return hand_content_tree


PACKAGED_HAND_NAMES = "jamia, jamia11, jamia_bench, n_plus_1, orca_like, t42"


def test_packaged_hands_are_listed():
    assert packaged_hands() == ("jamia", "jamia11", "jamia_bench", "n_plus_1", "orca_like", "t42")


def test_resolved_text_reads_back_as_the_same_hand(hand, tmp_path):
    path = tmp_path / "copy.toml"
    path.write_text(hand.to_toml())
    repeated_hand = load_hand(path)
    assert repeated_hand == hand
    assert repeated_hand.identity == hand.identity
    assert repeated_hand.to_toml() == hand.to_toml()


def test_options_and_awkward_text_survive(tmp_path):
    content = copy.deepcopy(CONTENT_BY_HAND_NAME["jamia"])
    content["description"] = 'a "quoted" \\ tab\t line\nµ \x7f'
    content["motor"][0]["options"] = {"reply_id": 0x55, "fd": True, "gain": 1e-7, "odd key": "ü"}
    hand = hand_from_content(content, "x")
    path = tmp_path / "copy.toml"
    path.write_text(hand.to_toml(), encoding="utf-8")
    assert load_hand(path) == hand
    assert load_hand(path).motor[0].options == content["motor"][0]["options"]


def test_identity_is_of_the_content_and_not_of_its_spelling(hand):
    plain = CONTENT_BY_HAND_NAME[hand.name]
    assert hand_from_content(dict(reversed(plain.items())), "x").identity == hand.identity
    whole_content = content_with_value(
        plain, ("tendon", 0, "knee_N"), int(plain["tendon"][0]["knee_N"])
    )
    assert hand_from_content(whole_content, "x").identity == hand.identity
    assert re.fullmatch(r"[0-9a-f]{64}", hand.identity)
    identities = {
        hand_from_content(content_with_value(plain, path, value * 1.0001), "x").identity
        for path, value in changeable_numbers(plain)
    }
    assert len(identities | {hand.identity}) == 1 + len(list(changeable_numbers(plain)))


def test_limits_of_streams_do_not_change_the_identity(hand, tmp_path):
    """Reproduce a defect: a hand lost its calibration when the hand file changed the limits of streamed targets.

    In addition, the log of a hand with default limits of streamed targets did not contain these
    limits.
    """
    slow_hand = hand_from_content(
        CONTENT_BY_HAND_NAME[hand.name] | {"stream": {"speed_deg_s": 200.0}}, "x"
    )
    assert slow_hand.stream != hand.stream
    assert slow_hand.identity == hand.identity
    for original_hand in (slow_hand, hand):
        path = tmp_path / "copy.toml"
        path.write_text(original_hand.to_toml())
        assert "speed_deg_s" in original_hand.to_toml()
        assert load_hand(path).stream == original_hand.stream


def changeable_numbers(content):
    """Yield the path and the value of those numbers in a hand's content that a test changes slightly.

    The hand stays valid when one of the yielded numbers changes.
    """
    for key in ("stiffness_N_per_m", "damping_N_s_per_m", "friction_coefficient", "tension_max_N"):
        yield ("tendon", 0, key), content["tendon"][0][key]
    for i in range(2):
        yield ("digit", 1, "link_mass_kg", i), content["digit"][1]["link_mass_kg"][i]


DIGITS_AND_JOINT_COUNT_BY_HAND = {
    "t42": (("left", "right"), 4),
    "n_plus_1": (("index", "middle", "thumb"), 8),
    "orca_like": (("wrist", "index", "middle", "ring", "pinky", "thumb"), 17),
}
"""Names of the digits and number of joints of packaged hands other than jamia hands."""


def test_links_and_joints_have_names_and_places(hand):
    first_digit, last_digit = hand.digit[0], hand.digit[-1]
    assert hand.joints[0] == f"{first_digit.name}_j1"
    assert hand.joints[-1] == f"{last_digit.name}_j{len(last_digit.link_length_m)}"
    digits, joints = DIGITS_AND_JOINT_COUNT_BY_HAND.get(
        hand.name, (("index", "middle", "ring", "thumb"), 11)
    )
    assert hand.digit_names == digits
    assert hand.moment_arms.shape == (len(hand.tendon_names), joints)
    for tendon, row in zip(hand.tendon, hand.moment_arms, strict=True):
        assert {hand.joints[j]: row[j] for j in np.flatnonzero(row)} == tendon.moment_arm_m
        assert hand.motor_of_tendon(tendon.name).name == tendon.motor
    for name in hand.digit_names:
        assert hand.joints[hand.digit_joints[name]] == hand.digit_named(name).joints
        assert all(
            tendon.startswith(name) for tendon in hand.tendon_names[hand.digit_tendons[name]]
        )
    assert [hand.motor_names[i] for i in hand.motor_index] == [
        tendon.motor for tendon in hand.tendon
    ]


def test_a_hand_cannot_be_changed(hand):
    with pytest.raises(ValueError, match="read-only"):
        hand.moment_arms[0, 0] = 1.0
    with pytest.raises(ValueError, match="frozen"):
        hand.name = "other"
    with pytest.raises(ValueError, match="frozen"):
        hand.digit[0].link_radius_m = 1.0


def test_sensor_frames(hand):
    has_eleven_joints = hand.name in ("jamia11", "n_plus_1")
    encoders = {
        "jamia11": (0x1B0, 0x1B1, 0x1B2),
        "n_plus_1": (0x1B0, 0x1B1),
        "orca_like": (0x1B0, 0x1B1, 0x1B2, 0x1B3),
    }
    cells = (
        () if hand.name == "orca_like" else (0x1A0, 0x1A1, 0x1A2) if has_eleven_joints else (0x1A0,)
    )
    assert hand.sensor_node.tension_ids == cells
    assert hand.sensor_node.joint_ids == encoders.get(hand.name, ())


def test_several_buses_may_use_the_same_node_ids():
    content = copy.deepcopy(CONTENT_BY_HAND_NAME["jamia"])
    content["bus"].append({"name": "second", "bitrate": 1_000_000})
    content["motor"][1].update(bus="second", node_id=1)
    assert hand_from_content(content, "x").motor[1].node_id == 1


@pytest.mark.parametrize(
    ("hand_name", "expected_message"),
    [
        (
            "jamai",
            f"jamai: no such hand or file; expected jamia? or one of {PACKAGED_HAND_NAMES}, or the path of a hand file",
        ),
        (
            "no/such.toml",
            f"no/such.toml: no such hand or file; expected one of {PACKAGED_HAND_NAMES}, or the path of a hand file",
        ),
    ],
)
def test_missing_hand_file_is_refused(hand_name, expected_message):
    with pytest.raises(ConfigError) as caught:
        load_hand(hand_name)
    assert str(caught.value) == expected_message


@pytest.mark.parametrize(
    ("file_bytes", "expected_message"),
    [
        (b"schema = ", "not TOML: "),
        (b"schema = 1\nschema = 1", "not TOML: "),
        (b"\xff\xfe", "byte 0 is not UTF-8"),
        (b"a = " + b"[" * 100_000, "not TOML: "),
        (b"", "schema: the file is empty; expected schema = 2 and the sections of a hand"),
    ],
)
def test_invalid_hand_file_is_refused(tmp_path, file_bytes, expected_message):
    path = tmp_path / "hand.toml"
    path.write_bytes(file_bytes)
    with pytest.raises(ConfigError) as caught:
        load_hand(path)
    assert expected_message in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_file_cut_short_anywhere_is_refused(tmp_path):
    text = (PACKAGED_HANDS_FOLDER / "jamia.toml").read_bytes()
    path = tmp_path / "hand.toml"
    last_key_offset = text.rindex(b"watchdog_ms")
    for end in range(0, last_key_offset, 97):
        path.write_bytes(text[:end])
        with pytest.raises(ConfigError) as caught:
            load_hand(path)
        assert "\n" not in str(caught.value)


def test_a_directory_is_no_hand(tmp_path):
    with pytest.raises(ConfigError, match="no such hand or file"):
        load_hand(Path(tmp_path))


def test_a_copy_with_other_buses_has_their_names() -> None:
    """Reproduce a defect: a copy of a hand with changed fields still had the cached properties of the original hand.

    One of the cached properties of a hand is the list of bus names.
    """
    hand = load_hand("jamia")
    assert hand.bus_names == ("main",)
    hand_with_renamed_bus = hand.model_copy(
        update={"bus": (hand.bus[0].model_copy(update={"name": "left"}),)}
    )
    assert hand_with_renamed_bus.bus_names == ("left",)
    assert hand.bus_names == ("main",)
