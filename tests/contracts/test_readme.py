"""Test that the README is short and agrees with the code.

The README states the limits of the project before it shows commands.
"""

import tomllib
from pathlib import Path

from handctl.drives.protocol_registry import PROTOCOL_ENTRIES
from handctl.session.exit_codes import ExitCode

README_TEXT = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
README_MAX_LINES = 150


def test_readme_is_short() -> None:
    assert len(README_TEXT.splitlines()) <= README_MAX_LINES


def test_the_limits_come_before_the_commands() -> None:
    assert README_TEXT.index("**Simulated only.**") < README_TEXT.index("make demo")
    firmware = "reference firmware with a schematic"
    for word in ("Nobody has run handctl on a real hand", "**Be the first**", firmware):
        assert word in README_TEXT, word


def test_the_code_that_needs_a_hand_is_named() -> None:
    assert f"**{int(ExitCode.REMOVE_POWER)}**" in README_TEXT
    assert "switch the power off" in README_TEXT


def test_every_protocol_is_named() -> None:
    names = {
        "mit": "MIT", "odrive": "ODrive", "cia402": "CiA 402", "cubemars": "CubeMars", "moteus": "moteus (CAN FD)",
        "robstride": "RobStride", "robstride_mit": "RobStride motors in MIT mode",
    }  # fmt: skip
    assert [
        protocol
        for protocol in PROTOCOL_ENTRIES
        if names.get(protocol, protocol) not in README_TEXT
    ] == []


def test_every_extra_is_named() -> None:
    project = tomllib.loads(
        (Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8")
    )["project"]
    table = README_TEXT.split("| extra |")[1].split("\n\n")[0]
    assert [extra for extra in project["optional-dependencies"] if f"`{extra}`" not in table] == []
