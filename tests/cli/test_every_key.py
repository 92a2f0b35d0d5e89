"""Test every key of every input file with every kind of bad value.

For each bad value, the command prints one error line, exits with code 2, and opens no bus.

An ordinary test run covers a sample of all pairs of key and value. A nightly test run covers all
pairs of key and value.
"""

import os
import re
import tomllib

import pytest

from handctl.cli.main import main
from handctl.core.gains.gains import Gains
from handctl.hand.file.toml_text import toml_text
from handctl.hand.hand_loading import PACKAGED_HANDS_FOLDER, hand_content, load_hand
from tests.hand.test_hand_file_refusals import (
    content_leaves,
    content_with_value,
    is_number,
    key_path_text,
)

ABSENT_BUS = "local:does-not-exist"
SAMPLE_STEP = 1 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 199


class UnrepresentableNumber(float):
    """Number that is valid in a TOML file, but too large for a float."""

    def __repr__(self):
        return "1e400"


INVALID_NUMBERS = {
    "nan": float("nan"),
    "inf": float("inf"),
    "1e400": UnrepresentableNumber("inf"),
    "true": True,
    "text": "12",
    "list": [[1.0]],
}
"""Values that are forbidden for every number in an input file."""
NUMBER_CHANGE_BY_NAME = {
    "-0.0": lambda x: -0.0,
    "negative": lambda x: -abs(x),
    "x1000": lambda x: 1000 * x,
    "/1000": lambda x: x / 1000,
}
"""Changes after which a number is possibly still within the limits of its key.

If handctl refuses a changed number, the error line names the key of the number.
"""
KEY_MISTAKES = ("missing", "renamed", "twice")


def gains_content():
    return Gains().model_dump(by_alias=True)


def calibration_content():
    hand = load_hand("jamia")
    tendon = {"tare_N": 0.1, "zero_rad": 1.0, "answer_N": 3.0, "crosstalk_N": 0.1}
    tendons = {name: dict(tendon) for name in hand.tendon_names}
    head = {
        "schema": 1,
        "hand": hand.name,
        "identity": hand.identity,
        "made": "2026-01-01T00:00:00+00:00",
    }
    return {**head, "tendon": tendons}


def task_content(task_name):
    return tomllib.loads(
        (PACKAGED_HANDS_FOLDER.parents[1] / "tasks" / f"{task_name}.toml").read_text()
    )


def trajectory_content():
    return {
        "schema": 1,
        "name": "t",
        "time_s": [0.0, 1.0, 2.0],
        "angle_deg": {"index": [0.0, 20.0, 10.0]},
    }


def packaged_hand_content(hand_name):
    return hand_content(hand_name)


VALID_INPUT_FILES = {
    "jamia": (packaged_hand_content("jamia"), ("--hand",)),
    "jamia11": (packaged_hand_content("jamia11"), ("--hand",)),
    "gains": (gains_content(), ("--gains",)),
    "calibration": (calibration_content(), ("--calibration",)),
    "grasp": (task_content("grasp"), ("--task",)),
    "pinch-joints": (task_content("pinch-joints"), ("--hand", "jamia11", "--task")),
    "trajectory": (trajectory_content(), ("--trajectory",)),
}
"""For each kind of input file: a valid content, and the words of `handctl run` that precede the name of the file."""


def toml_text_of(file_content):
    """Return the content of a file as TOML text, with dotted headers for nested tables."""
    plain = {key: value for key, value in file_content.items() if not isinstance(value, dict)}
    lines = [toml_text(plain)]
    for key, value in file_content.items():
        if isinstance(value, dict):
            lines += _table_lines(key, value)
    return "\n".join(lines)


def _table_lines(table_name, table_content):
    yield f"[{table_name}]"
    yield toml_text(
        {key: value for key, value in table_content.items() if not isinstance(value, dict)}
    )
    for key, value in table_content.items():
        if isinstance(value, dict):
            yield from _table_lines(f"{table_name}.{key}", value)


def content_without_key(file_content, key_path, renamed_value=None):
    """Return a copy of a file's content in which one key is missing.

    If ``renamed_value`` is given, the copy has an additional key with the value ``renamed_value``.
    The name of the additional key is the name of the missing key with the suffix ``_x``.
    """
    file_content = content_with_value(file_content, key_path, None)
    parent = file_content
    for key in key_path[:-1]:
        parent = parent[key]
    del parent[key_path[-1]]
    if renamed_value is not None:
        parent[key_path[-1] + "_x"] = renamed_value
    return file_content


def mistake_cases():
    for name, (content, _) in VALID_INPUT_FILES.items():
        for path, value in content_leaves(content):
            if is_number(value):
                yield from (
                    (name, path, kind) for kind in (*INVALID_NUMBERS, *NUMBER_CHANGE_BY_NAME)
                )
            if isinstance(path[-1], str):
                yield from ((name, path, kind) for kind in KEY_MISTAKES)


def text_with_repeated_key(text, key):
    """Return TOML text in which one key and its value occur twice.

    The second occurrence is on the line after the first occurrence, or in the same inline table.
    """
    entry = re.search(rf"(?<![\w-]){re.escape(key)} = (\[[^\]]*\]|[^,}}\n]*[^,}}\s])", text)
    separator = "\n" if text[: entry.start()].rpartition("\n")[2] == "" else ", "
    return text[: entry.end()] + separator + entry.group() + text[entry.end() :]


def text_with_mistake(file_content, key_path, mistake_kind):
    """Return the content as TOML text with one mistake.

    ``mistake_kind`` is the kind of the mistake, and ``key_path`` is the key at which the mistake is
    made.
    """
    if mistake_kind in KEY_MISTAKES:
        original_value = file_content
        for key in key_path:
            original_value = original_value[key]
        if mistake_kind == "twice":
            return text_with_repeated_key(toml_text_of(file_content), str(key_path[-1]))
        return toml_text_of(
            content_without_key(
                file_content, key_path, original_value if mistake_kind == "renamed" else None
            )
        )
    original_value = file_content
    for key in key_path:
        original_value = original_value[key]
    return toml_text_of(
        content_with_value(
            file_content,
            key_path,
            INVALID_NUMBERS[mistake_kind]
            if mistake_kind in INVALID_NUMBERS
            else NUMBER_CHANGE_BY_NAME[mistake_kind](original_value),
        )
    )


class BusOpenedError(Exception):
    """Error that a test raises when the tested command opens a bus."""


@pytest.fixture(autouse=True)
def refuse_to_open_buses(monkeypatch):
    def raise_bus_opened_error(*words, **options):
        raise BusOpenedError

    for name in ("open_bus", "Mailbox"):
        monkeypatch.setattr(f"handctl.session.run.{name}", raise_bus_opened_error)


def refusal_of_file(capsys, file_option, file_name):
    """Return the error line of `run` for a file, or an empty text if `run` accepts the file.

    `run` opens the bus only if it accepts the file. ``refuse_to_open_buses`` makes `run` raise a
    ``BusOpenedError`` when `run` opens the bus.
    """
    task_options = [] if {"--task", "--trajectory"} & {*file_option} else ["--task", "grasp"]
    try:
        code = main(["run", "--bus", ABSENT_BUS, *file_option, file_name, *task_options])
    except BusOpenedError:
        capsys.readouterr()
        return ""
    out, err = capsys.readouterr()
    assert (code, out) == (2, "")
    assert err.startswith("handctl: ")
    assert err.count("\n") == 1, err
    return err


ALL_MISTAKE_CASES = list(mistake_cases())


@pytest.mark.parametrize("content_name", VALID_INPUT_FILES)
def test_unchanged_hand_file_is_accepted(work_folder, capsys, content_name):
    content, option = VALID_INPUT_FILES[content_name]
    (work_folder / "file.toml").write_text(toml_text_of(content))
    assert refusal_of_file(capsys, option, "file.toml") == ""


@pytest.mark.parametrize(
    ("content_name", "key_path", "mistake_kind"),
    ALL_MISTAKE_CASES[::SAMPLE_STEP],
    ids=lambda x: str(x) if isinstance(x, str) else None,
)
def test_every_wrong_key_is_refused(work_folder, capsys, content_name, key_path, mistake_kind):
    content, option = VALID_INPUT_FILES[content_name]
    (work_folder / "file.toml").write_text(text_with_mistake(content, key_path, mistake_kind))
    line = refusal_of_file(capsys, option, "file.toml")
    if mistake_kind == "twice":
        assert "file.toml" in line
        assert "TOML" in line
    elif mistake_kind in INVALID_NUMBERS or mistake_kind == "renamed":
        assert "file.toml: " in line, "the message names the file"
        if mistake_kind == "renamed":
            content, key_path = content_without_key(content, key_path), key_path[:-1]
        assert key_path_text(content, key_path) in line
        assert "expected" in line
    elif line.startswith(("handctl: grasp: phase", "handctl: gains: filter: no controller")):
        # Each value is in its range, but the hand is too small for the angles of the task, or no
        # filter can be designed for hand and gains. In these cases, the error line names the task
        # or the gains.
        assert option in (("--hand",), ("--gains",))
        assert "expected" in line
    elif line:
        assert "file.toml" in line
        assert any(key in line for key in key_path if isinstance(key, str))
