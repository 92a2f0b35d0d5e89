"""Test that the settings and the documents name only files that exist."""

import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
CHECKED_FOLDERS_PATTERN = "benchmarks|docs|examples|firmware_sim|fuzz|logs|src|tests|tools"
PATH_PATTERN = re.compile(rf"(?<![\w/.-])(?:{CHECKED_FOLDERS_PATTERN})/[\w/.*-]*[\w*]")
"""Pattern of a file path in a text. The path can contain the wildcard of a shell."""
PLACEHOLDER_PATTERN = re.compile(r"[A-Z]{3,}|[.]{3}|RUN")
"""Pattern of a placeholder in a file path: a word in capital letters, such as NAME, or three dots."""
DOCUMENTS = [
    REPOSITORY / "pyproject.toml",
    REPOSITORY / "Makefile",
    *REPOSITORY.glob("*.md"),
    *(REPOSITORY / "docs").rglob("*.md"),
]
HISTORY_DOCUMENT = "CHANGELOG.md"
"""Document that also names files that existed only in earlier versions."""


def missing_paths(document_text: str) -> list[str]:
    """Return the paths of Python files that a text names, but that do not exist."""
    paths = sorted(set(PATH_PATTERN.findall(document_text)))
    checked_paths = [p for p in paths if p.endswith(".py") and not PLACEHOLDER_PATTERN.search(p)]
    return [path for path in checked_paths if not any(REPOSITORY.glob(path))]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_named_file_exists(document: Path) -> None:
    """Reproduce a defect: the settings of the mutation tests named two files that had been renamed."""
    if document.name != HISTORY_DOCUMENT:
        assert missing_paths(document.read_text()) == []


def test_a_missing_file_is_found() -> None:
    text = "`src/handctl/errors.py`, tests/safety/*.py, tests/nothing.py, tests/drives/NAME.py"
    assert missing_paths(text) == ["tests/nothing.py"]
