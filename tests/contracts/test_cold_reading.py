"""Test the tool that selects random names and sentences for a reader who does not know the repository."""

import json
from pathlib import Path

import pytest

from tools.cold_reading import (
    names_in_file,
    print_score,
    sentences_in_file,
    sentences_of_text,
    write_sample,
)


def test_a_sample_has_equal_halves_and_depends_on_its_seed_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tools.cold_reading.OUR_FOLDERS", ("fuzz",))
    monkeypatch.setattr("tools.cold_reading.OTHER_PROJECTS", ("mcap", "pluggy"))
    for folder, seed in (("first", 3), ("same", 3), ("other", 4)):
        write_sample(tmp_path / folder, seed, 12)
    for sample_part in ("names", "sentences"):
        texts = [
            (tmp_path / folder / f"{sample_part}.txt").read_text()
            for folder in ("first", "same", "other")
        ]
        assert texts[0] == texts[1] != texts[2]
        rows = json.loads((tmp_path / "first" / "key.json").read_text())[sample_part]
        assert len({text for text, _, _ in rows}) == len(rows) == 24
        assert sum(project == "handctl" for _, project, _ in rows) == 12


def test_marked_lines_are_counted_for_each_half(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [["`a1b` (module)", "handctl", "a.py"], ["`c2d` (class)", "can", "c.py"]]
    (tmp_path / "key.json").write_text(json.dumps({"names": [*rows, rows[0]]}))
    print_score(tmp_path, "names", [1, 2])
    assert capsys.readouterr().out.splitlines()[0] == "handctl: 1 marked, other projects: 1"


def test_names_are_those_that_a_file_defines(tmp_path: Path) -> None:
    path = tmp_path / "bus_load.py"
    path.write_text(
        "LIMIT = 1\nclass Row:\n    width: int\n    def size(self, *, unit):\n        total = len(unit)\n"
        "def test_it(): pass\n"
    )
    assert names_in_file(path) == [
        "`LIMIT` (constant)", "`Row` (class)", "`bus_load` (module)", "`size` (function)", "`total` (variable)",
        "`unit` (argument of size())", "`width` (field of Row)",
    ]  # fmt: skip


def test_sentences_of_lists_and_code_are_left_out(tmp_path: Path) -> None:
    text = "A motor that rests\nat its target is not stuck. It is well.\n\n- a list of six words and more.\n"
    assert sentences_of_text(text) == ["A motor that rests at its target is not stuck."]
    path = tmp_path / "page.md"
    path.write_text(
        f"# A title of at least six words.\n\n```\n{text}```\n\n| A row of a table of words. |\n"
    )
    assert sentences_in_file(path) == []
