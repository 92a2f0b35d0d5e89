"""Test that the language check counts the words and phrases that its documentation describes.

The tests also check that the language check refuses limits that are higher than the previous
limits.
"""

import importlib.util
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

LANGUAGE_SCRIPT = Path(__file__).parents[2] / "tools" / "language.py"
EXAMPLE_MODULE = '''"""Do a thing; somebody wants it."""
import math  # a comment
told, x = 1, 2
told, x = x, told

class Wishes:
    """A rope."""

def seen(most):
    """What is seen."""

def measure():
    """Measure the tension [N]."""
'''


@pytest.fixture
def language_check() -> ModuleType:
    spec = importlib.util.spec_from_file_location("language", LANGUAGE_SCRIPT)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules["language"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def source_tree(tmp_path: Path) -> Path:
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "one.py").write_text(EXAMPLE_MODULE)
    (tmp_path / "src" / "two.py").write_text("class Wishes:\n    pass\n")
    (tmp_path / "README.md").write_text("**What happened:** What is so; `what` and ropes.\n")
    return tmp_path


def test_the_script_counts_names_docstrings_and_shape(
    language_check: ModuleType, source_tree: Path
) -> None:
    tally = language_check.count_all_folders(source_tree)["src"]
    count_by_kind = {count: tally.counts[count] for count in language_check.QUANTITY_PER_COUNT}
    assert count_by_kind == {
        "names": 5,  # the counted words are: told twice, most, Wishes twice
        "openers": 1,
        "what": 1,
        "semicolons": 1,
        "pronouns": 3,  # the counted pronouns are: somebody, it, what
        "riddles": 1,
        "ropes": 1,
        "tuples": 1,
        "long_lines": 0,
        "repeated_classes": 1,
    }
    assert tally.totals["docstrings"] == 2
    assert tally.totals["comments"] == 1
    assert tally.places["openers"] == ["src/one.py:9: begins with 'what'"]


def test_quoted_code_of_a_document_is_no_prose(
    language_check: ModuleType, source_tree: Path
) -> None:
    tally = language_check.count_all_folders(source_tree)["documents"]
    assert (tally.counts["what"], tally.counts["ropes"], tally.counts["semicolons"]) == (1, 1, 1)


def test_a_count_above_its_limit_is_reported_and_limits_are_only_lowered(
    language_check: ModuleType, source_tree: Path
) -> None:
    counts_before = language_check.count_all_folders(source_tree)
    limits = language_check.lowered_limits(counts_before, {})
    assert list(language_check.limit_excesses(counts_before, limits)) == []
    (source_tree / "src" / "two.py").write_text("class Wishes:\n    told = asked = heard = 1\n")
    counts_after = language_check.count_all_folders(source_tree)
    (line,) = (
        line for line in language_check.limit_excesses(counts_after, limits) if "names" in line
    )
    assert line.startswith("src: names ")
    assert (
        language_check.lowered_limits(counts_after, limits)["src"]["names"]
        == limits["src"]["names"]
    )
    (source_tree / "src" / "two.py").write_text("")
    assert (
        language_check.lowered_limits(language_check.count_all_folders(source_tree), limits)["src"][
            "names"
        ]
        < limits["src"]["names"]
    )


def test_limits_are_read_as_they_were_written(
    language_check: ModuleType, source_tree: Path
) -> None:
    limits = language_check.lowered_limits(language_check.count_all_folders(source_tree), {})
    assert tomllib.loads(language_check.to_toml(limits)) == limits
