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
        tables = [match[2] for match in TABLE_PATTERN.finditer(page.read_text(encoding="utf-8"))]
        assert len(tables) == 1, page
        written_text = " ".join(tables[0].splitlines()[2:])
        number_pairs = zip(
            NUMBER_PATTERN.findall(written_text), NUMBER_PATTERN.findall(computed_text), strict=True
        )
        wrong_pairs = [
            (written_number, computed_number)
            for written_number, computed_number in number_pairs
            if abs(float(written_number) - float(computed_number))
            > RELATIVE_TOLERANCE * float(computed_number) + ROUNDING_TOLERANCE
        ]
        assert wrong_pairs == [], f"{page.name}: run make figures NAMES=numbers"
