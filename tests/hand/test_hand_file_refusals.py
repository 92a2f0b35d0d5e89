"""Every mistake in a hand file gives one error line with the key, the wrong value and the expected value."""

import copy
import math
import re

import pytest
from _pytest.mark.structures import ParameterSet

from handctl.errors import ConfigError
from handctl.hand.digit import DigitModel
from handctl.hand.formats.urdf import urdf_text
from handctl.hand.hand_loading import hand_content, hand_from_content, packaged_hands
from tests.conftest import NIGHTLY

CONTENT_BY_HAND_NAME = {name: hand_content(name) for name in packaged_hands()}
SIGNED_KEY_PATTERN = re.compile(
    r"gravity|mount_|joint_m(in|ax)_deg|moment_arm|zero_rad|coupling|direction"
)
OPTIONAL_KEYS = {"coupling"}


def content_leaves(content_node, node_path=()):
    """Yield the key path and the value of each number, text and flag in a hand's content. Skip tables and lists."""
    entries = (
        content_node.items()
        if isinstance(content_node, dict)
        else enumerate(content_node)
        if isinstance(content_node, list)
        else None
    )
    if entries is None:
        yield node_path, content_node
        return
    for key, value in entries:
        yield from content_leaves(value, (*node_path, key))


def content_tables(content_node, node_path=()):
    """Yield the path and the content of each table whose keys the schema defines."""
    if isinstance(content_node, dict):
        yield node_path, content_node
    for key, value in (
        content_node.items() if isinstance(content_node, dict) else enumerate(content_node)
    ):
        if isinstance(value, dict | list) and key != "moment_arm_m":
            yield from content_tables(value, (*node_path, key))


def is_number(leaf_value):
    return isinstance(leaf_value, int | float) and not isinstance(leaf_value, bool)


def content_with_value(original_content, key_path, new_value):
    """Return a copy of a hand's content with one value replaced."""
    original_content = copy.deepcopy(original_content)
    node = original_content
    for key in key_path[:-1]:
        node = node[key]
    node[key_path[-1]] = new_value
    return original_content


def key_path_text(hand_content_tree, key_path):
    """Return a key path of a hand file as an error message would write it."""
    text, node = "", hand_content_tree
    for key in key_path:
        node = node[key]
        if isinstance(key, int):
            text += f"[{node.get('name', key) if isinstance(node, dict) else key}]"
        else:
            text += f".{key}" if text else key
    return text


HANDS_WITH_PLANAR_DIGITS = tuple(name for name in packaged_hands() if name != "orca_like")
"""Packaged hands with planar digits on the palm.

The hand file ``orca_like`` has the same keys as the other hand files, and additional keys for joint
axes and inertias.
"""


def first_case_per_key(cases: list[ParameterSet]) -> list[ParameterSet]:
    """Return one test case for each key of a hand file.

    The same key occurs in several hands and in several entries of a list. For each key, the
    function returns only the first test case in ``cases``. In a nightly test run, the function
    returns all test cases.
    """
    case_by_key = {re.sub(r"^\w+-|\[[^]]*\]", "", str(case.id)): case for case in reversed(cases)}
    return cases if NIGHTLY else list(case_by_key.values())


NUMBER_CASES = [
    pytest.param(
        CONTENT_BY_HAND_NAME[name],
        path,
        value,
        id=f"{name}-{key_path_text(CONTENT_BY_HAND_NAME[name], path)}",
    )
    for name in HANDS_WITH_PLANAR_DIGITS
    for path, value in content_leaves(CONTENT_BY_HAND_NAME[name])
    if is_number(value)
    and path != ("schema",)
    and not (len(path) > 1 and isinstance(path[1], int) and path[1] in (1, 2))
]
"""Numeric values of the packaged hand files.

The list leaves out the values of the middle and ring finger, because they repeat values of the
index finger.
"""
SAMPLED_NUMBER_CASES = first_case_per_key(NUMBER_CASES)


@pytest.mark.parametrize(("content", "key_path", "wrong_number"), SAMPLED_NUMBER_CASES)
def test_invalid_number_in_a_hand_file_is_refused(
    refusal_of_content, content, key_path, wrong_number
):
    wrong_values = [
        (math.nan, "nan"),
        (math.inf, "inf"),
        (-math.inf, "-inf"),
        (True, "true"),
        ("12", '"12"'),
        ([1.0], "[1.0]"),
    ]
    if wrong_number != 0 and not SIGNED_KEY_PATTERN.search(str(key_path)):
        wrong_values.append((-wrong_number, str(-wrong_number)))
    for wrong_value, shown_text in wrong_values:
        line = refusal_of_content(content_with_value(content, key_path, wrong_value))
        assert line.startswith(f"my/hand.toml: {key_path_text(content, key_path)}: {shown_text};")


@pytest.mark.parametrize(("content", "key_path", "wrong_number"), SAMPLED_NUMBER_CASES)
def test_no_number_may_be_absurdly_large(refusal_of_content, content, key_path, wrong_number):
    for absurd in (1e9, 10**400):
        assert f"my/hand.toml: {key_path_text(content, key_path)}: " in refusal_of_content(
            content_with_value(content, key_path, absurd)
        )


@pytest.mark.parametrize("hand_name", HANDS_WITH_PLANAR_DIGITS)
def test_a_missing_key_is_refused(refusal_of_content, hand_name):
    for path, table in content_tables(CONTENT_BY_HAND_NAME[hand_name]):
        for key in table:
            if (
                key in ("schema", "sensor_node", "joints") or "mesh" in key
            ):  # these keys are optional
                continue
            has_encoders = bool(table.get("joints"))
            if key in ("joint_decimation", "joint_noise_rad") and not has_encoders:
                continue  # without joint encoders, their keys are optional
            content = content_with_value(CONTENT_BY_HAND_NAME[hand_name], (*path, key), None)
            node = content
            for key_or_index in path:
                node = node[key_or_index]
            del node[key]
            line = refusal_of_content(content)
            key_text = key_path_text(content, path)
            if key in OPTIONAL_KEYS:
                assert "index_tendon" in line or f"{key_text}.{key}: its tendons" in line
            else:
                assert line.startswith(
                    f"my/hand.toml: {key_text}{'.' if key_text else ''}{key}: missing;"
                )


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_an_unknown_key_is_refused(refusal_of_content, hand_name):
    for path, _ in content_tables(CONTENT_BY_HAND_NAME[hand_name]):
        line = refusal_of_content(
            content_with_value(CONTENT_BY_HAND_NAME[hand_name], (*path, "colour"), 1.0)
        )
        key_text = key_path_text(CONTENT_BY_HAND_NAME[hand_name], path)
        assert line.startswith(
            f"my/hand.toml: {key_text}{'.' if key_text else ''}colour: unknown key; expected one of "
        )


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_a_misspelt_key_is_reported_with_the_right_one(refusal_of_content, hand_name):
    for path, table in content_tables(CONTENT_BY_HAND_NAME[hand_name]):
        for key in table:
            if key == "schema" and path == ():
                continue
            content = content_with_value(
                CONTENT_BY_HAND_NAME[hand_name], (*path, key + "s"), table[key]
            )
            node = content
            for key_or_index in path:
                node = node[key_or_index]
            del node[key]
            line = refusal_of_content(content)
            assert f"{key}s: unknown key; expected {key}" in line


def test_random_change_is_read_or_refused_in_one_line():
    """A wrong value of any type, at any place in a hand file, gives a usable hand or one error line."""
    content = CONTENT_BY_HAND_NAME["jamia"]
    for path, _ in [*content_leaves(content), *content_tables(content)]:
        if len(path) > 1 and path[1] in (1, 2):
            continue
        for odd in ("", "x\ny", 0, -1, 1.5, False, [], {}, [[]], [{}], {"name": 3}, [None], 2**70):
            for depth in range(1, len(path) + 1):
                assert is_usable_or_refused(content_with_value(content, path[:depth], odd))


def is_usable_or_refused(content):
    """Return True if a content gives a usable hand, or if handctl refuses the content with one error line."""
    try:
        hand = hand_from_content(content, "f")
    except ConfigError as error:
        return "\n" not in str(error)
    digits = [DigitModel.from_hand(hand, name) for name in hand.digit_names]
    return len(hand.identity) == 64 and len(digits) > 0 and urdf_text(hand).startswith("<robot")
