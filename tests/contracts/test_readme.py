"""The README agrees with the code."""

import re
from pathlib import Path

from handctl.cli.main import VERBS
from handctl.safety.faults.markdown import fault_table
from handctl.session.exit_codes import Exit

README = (Path(__file__).parents[2] / "README.md").read_text()


def test_the_fault_table_is_the_code_s() -> None:
    assert fault_table() in README


def test_every_verb_is_named() -> None:
    table = README.split("## Verbs")[1].split("## On real hardware")[0]
    assert [verb for verb in VERBS if f"`{verb}`" not in table] == []


def test_every_exit_code_is_named() -> None:
    codes = README.split("Exit codes:")[1].split("\n\n")[0]
    named = {int(word) for word in re.findall(r"(?<!\d)(\d+)(?= )", codes.replace("\n", " "))}
    assert {int(code) for code in Exit} <= named
