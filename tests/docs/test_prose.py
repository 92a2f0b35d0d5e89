"""Test that paragraphs of the documents are short, and that the terms of the glossary are in alphabetical order."""

import re
from pathlib import Path

import pytest

REPOSITORY_ROOT = Path(__file__).parents[2]
PROSE_DOCUMENTS = [
    REPOSITORY_ROOT / "README.md",
    REPOSITORY_ROOT / "SECURITY.md",
    REPOSITORY_ROOT / "CONTRIBUTING.md",
    *sorted((REPOSITORY_ROOT / "docs").rglob("*.md")),
]
MAX_SENTENCES = 5
"""Largest permitted number of sentences in a paragraph."""
FENCE_PATTERN = re.compile(r"^ *```.*?^ *```$", re.MULTILINE | re.DOTALL)
NON_PROSE_PREFIXES = ("|", "#", "<!--", "    ")


def paragraphs_of(document_text: str) -> list[str]:
    """Return the paragraphs of a document without code and tables.

    Each entry of a list in the document counts as a paragraph.
    """
    text_without_quotes = re.sub(
        r"^> ?", "", FENCE_PATTERN.sub("", document_text), flags=re.MULTILINE
    )
    blocks = re.split(r"\n\s*\n", text_without_quotes)
    prose_blocks = [
        block for block in blocks if not block.lstrip("\n").startswith(NON_PROSE_PREFIXES)
    ]
    return [entry for block in prose_blocks for entry in re.split(r"\n(?=\s*(?:- |\d+\. ))", block)]


def sentence_count(paragraph: str) -> int:
    """Count the sentences of a paragraph.

    A full stop in code or in an abbreviation does not end a sentence.
    """
    plain_text = re.sub(r"\b(?:e\.g|i\.e|Eq|Fig|Sec)\.", "", re.sub(r"`[^`]*`", "x", paragraph))
    return len(re.findall(r"[.!?](?=\s|$|\*|\))", plain_text))


@pytest.mark.parametrize(
    "path", PROSE_DOCUMENTS, ids=lambda path: path.relative_to(REPOSITORY_ROOT).as_posix()
)
def test_no_paragraph_is_long(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert [
        paragraph[:60]
        for paragraph in paragraphs_of(text)
        if sentence_count(paragraph) > MAX_SENTENCES
    ] == []


@pytest.mark.parametrize(
    "path", PROSE_DOCUMENTS, ids=lambda path: path.relative_to(REPOSITORY_ROOT).as_posix()
)
def test_a_second_paragraph_of_a_list_entry_is_indented_by_four(path: Path) -> None:
    # If the text of a list entry is indented by fewer than four spaces, the site ends the list.
    # After an early end of the list, the site shows the marks of later list entries as text.
    text = FENCE_PATTERN.sub("", path.read_text(encoding="utf-8"))
    assert re.findall(r"\n\n {1,3}\S.*", text) == []


@pytest.mark.parametrize(
    "path", PROSE_DOCUMENTS, ids=lambda path: path.relative_to(REPOSITORY_ROOT).as_posix()
)
def test_no_line_begins_with_a_number_that_ends_a_sentence(path: Path) -> None:
    # The site shows a line that begins like "126. The identifiers" as a list entry. A real list in
    # a document begins with the number 1.
    text = FENCE_PATTERN.sub("", path.read_text(encoding="utf-8"))
    numbers = [int(number) for number in re.findall(r"^ *(\d+)\. ", text, re.MULTILINE)]
    assert [b for a, b in zip([0, *numbers], numbers, strict=False) if b not in (1, a + 1)] == []


@pytest.mark.parametrize(
    "path", PROSE_DOCUMENTS, ids=lambda path: path.relative_to(REPOSITORY_ROOT).as_posix()
)
def test_no_code_has_a_bar_behind_a_backslash(path: Path) -> None:
    # In a table, the site would show the backslash of an escaped bar. The site and GitHub both show
    # `<code>A&#124;B</code>` correctly.
    text = FENCE_PATTERN.sub("", path.read_text(encoding="utf-8"))
    assert re.findall(r"`[^`\n]*\\\|[^`\n]*`", text) == []


def test_six_sentences_are_counted() -> None:
    assert sentence_count("A `b.c. d.` is. One (two). *Three.* Four? Five! Six.") == 6


def test_the_glossary_is_in_order_and_has_no_term_twice() -> None:
    rows = re.findall(
        r"^\| ([^|]+) \|",
        (REPOSITORY_ROOT / "docs" / "glossary.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    sort_keys = [
        re.sub(r"[^a-z]", "", term.lower()) for term in rows if term not in ("term", "---")
    ]
    assert len(set(sort_keys)) == len(sort_keys)
    assert sort_keys == sorted(sort_keys)
