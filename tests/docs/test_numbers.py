"""Test that the results in the README and on the site agree with the output of ``handctl demo``.

Processors give slightly different results, so the test permits a difference of 15 % plus a rounding
error.
"""

import json
import re
from pathlib import Path

import pytest

from handctl.cli.main import main
from tools.figures.numbers import TABLE_PATTERN, rows_of_result
from tools.figures.runs import DEMO_COMMAND

REPOSITORY_ROOT = Path(__file__).parents[2]
PAGES_WITH_NUMBERS = [
    REPOSITORY_ROOT / "README.md",
    REPOSITORY_ROOT / "docs" / "start" / "ten-minutes.md",
]
NUMBER_PATTERN = re.compile(r"\d+(?:\.\d+)?")
RELATIVE_TOLERANCE, ROUNDING_TOLERANCE = 0.15, 0.051
"""Permitted relative difference of results between two processors, and permitted rounding error of printed results."""


def test_the_numbers_are_fresh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*DEMO_COMMAND, "--log", str(tmp_path / "demo.mcap")]) == 0
    computed_text = " ".join(
        f"{name} {value}" for name, value in rows_of_result(json.loads(capsys.readouterr().out))
    )
    for page in PAGES_WITH_NUMBERS:
        places = [match[2] for match in TABLE_PATTERN.finditer(page.read_text(encoding="utf-8"))]
        assert len(places) == 1, page
        written = " ".join(places[0].splitlines()[2:])
        pairs = zip(
            NUMBER_PATTERN.findall(written), NUMBER_PATTERN.findall(computed_text), strict=True
        )
        off = [
            (a, b)
            for a, b in pairs
            if abs(float(a) - float(b)) > RELATIVE_TOLERANCE * float(b) + ROUNDING_TOLERANCE
        ]
        assert off == [], f"{page.name}: run make figures NAMES=numbers"
