"""Test that a reader finds the answer to a frequent question after few clicks and few words.

A reader takes two minutes for 400 words. With the last click, a reader opens a page, or jumps to a
heading of a page. The test counts the words from there to the answer. A reader reads fewer
words than the test counts, because readers skip rows of a table.
"""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

REPOSITORY_ROOT = Path(__file__).parents[2]
DOCS_FOLDER = REPOSITORY_ROOT / "docs"
LOOKUPS_PAGE = DOCS_FOLDER / "evidence" / "lookups.md"
MOST_CLICKS, MOST_WORDS, TOLERANCE_WORDS = 3, 400, 50
"""Largest permitted number of clicks to an answer, and largest permitted number of words above the answer.

``TOLERANCE_WORDS`` limits the difference between the counted words and the number of words that the
evidence page states.
"""
ANSWER_BY_QUESTION = {
    "How do I stop the hand?": ("index.md", "", r"press Ctrl-C, or run `handctl stop"),
    "How do I stop it when a program hangs?": ("how-to/stop.md", "a-program-hangs", r"`handctl stop --bus BUS`, or"),
    "Which adapter do I buy?": ("how-to/adapters.md", "", r"\*\*Which adapter to buy\.\*\*"),
    "What does N04 mean?": ("reference/faults.md", "n04-an-encoder-is-stuck", r"\*\*What happened:\*\*"),
    "How does a log come to Foxglove?": ("how-to/other-tools.md", "foxglove", r"Open the file in Foxglove"),
    "What shape has `/tendon_states`?": ("reference/topics.md", "states-of-tendons-joints-and-motors",
                                        r"`/tendon_states` is a "),
    "How do I add a motor type?": ("how-to/adding-a-drive.md", "add-a-motor-type", r"\| Damiao \|"),
    "Why did my run end?": ("how-to/why-a-run-ended.md", "", r"\*\*The terminal\.\*\*"),
}  # fmt: skip
"""For each frequent question: the page, the anchor of a heading, and the beginning of the answer."""


def section_lines(page: str, heading_anchor: str) -> str:
    """Return the lines of a page from a heading to the end of the page.

    If ``heading_anchor`` is empty, return all lines of the page.
    """
    text = (DOCS_FOLDER / page).read_text(encoding="utf-8")
    for match in re.finditer(r"^#+ (.*)$", text, re.MULTILINE):
        heading_text = re.sub(r"[^\w\s-]", "", match[1]).strip().lower()
        if heading_anchor and re.sub(r"[\s-]+", "-", heading_text) == heading_anchor:
            return text[match.start() :]
    assert not heading_anchor, f"{page} has no heading {heading_anchor}"
    return text


def word_count_before_answer(page: str, heading_anchor: str, answer_pattern: str) -> int:
    """Return the number of words from a heading to an answer, or from the start of the page if no heading is given."""
    text = section_lines(page, heading_anchor)
    match = re.search(answer_pattern, text)
    assert match, f"{page}: no {answer_pattern}"
    return len(re.findall(r"[^\W_][\w.-]*", text[: match.start()]))


def click_count(page: str, heading_anchor: str) -> int:
    """Return the number of clicks from the front page of the site to a heading.

    A reader opens a page with one click on a link, or with two clicks on a tab and an entry of the
    navigation. To go to a heading, the reader needs one more click in the table of contents.
    """
    if page == "index.md":
        return 0
    front_page = (DOCS_FOLDER / "index.md").read_text(encoding="utf-8")
    navigation = yaml.safe_load((REPOSITORY_ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    assert page in navigation_pages(navigation)
    return (1 if f"({page})" in front_page else 2) + bool(heading_anchor)


def navigation_pages(navigation_entry: Any) -> list[str]:
    """Return all pages in a part of the site's navigation."""
    if isinstance(navigation_entry, str):
        return [navigation_entry]
    values = navigation_entry.values() if isinstance(navigation_entry, dict) else navigation_entry
    return [page for value in values for page in navigation_pages(value)]


@pytest.mark.parametrize("question", ANSWER_BY_QUESTION)
def test_an_answer_is_found_soon(question: str) -> None:
    page, anchor, answer = ANSWER_BY_QUESTION[question]
    assert click_count(page, anchor) <= MOST_CLICKS
    assert word_count_before_answer(page, anchor, answer) <= MOST_WORDS


def test_the_page_has_these_numbers() -> None:
    rows = re.findall(
        r"^\| (.*\?) \| .* \| (\d+) \| (\d+) \| .* \|$",
        LOOKUPS_PAGE.read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    expected_rows = [(q, str(click_count(page, anchor)), str(word_count_before_answer(page, anchor, answer)))
                     for q, (page, anchor, answer) in ANSWER_BY_QUESTION.items()]  # fmt: skip
    assert [row[:2] for row in rows] == [row[:2] for row in expected_rows]
    wrong_word_counts = [
        row
        for row, expected_row in zip(rows, expected_rows, strict=True)
        if abs(int(row[2]) - int(expected_row[2])) > TOLERANCE_WORDS
    ]
    assert wrong_word_counts == []
