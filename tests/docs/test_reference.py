"""Test that the generated blocks of the documentation pages agree with the code.

The command ``python -m tools.reference`` writes these blocks into the documentation pages.
"""

import re
from pathlib import Path

import pytest

from handctl.cli.main import VERB_HELP
from tools.reference.blocks import BLOCK_FUNCTIONS, BLOCK_PATTERN, filled_page, pages_with_blocks
from tools.reference.topics import packaged_hand_topics

REPOSITORY_ROOT = Path(__file__).parents[2]
GENERATED_PAGES = {
    path.relative_to(REPOSITORY_ROOT).as_posix(): (text, expected_text)
    for path, text, expected_text in pages_with_blocks(REPOSITORY_ROOT)
}


@pytest.mark.parametrize("page", GENERATED_PAGES)
def test_no_page_is_stale(page: str) -> None:
    text, expected_text = GENERATED_PAGES[page]
    assert text == expected_text, f"{page} is stale; run python -m tools.reference"


def test_every_block_has_a_page() -> None:
    written = {
        match[2] for text, _ in GENERATED_PAGES.values() for match in BLOCK_PATTERN.finditer(text)
    }
    assert written == set(BLOCK_FUNCTIONS)


def test_a_changed_block_is_stale() -> None:
    text = "<!-- generated: exit-codes -->\n\n| 0 | fine |\n\n<!-- end of generated -->\n"
    assert "| 71 | `REMOVE_POWER` |" in filled_page(text)
    assert filled_page(filled_page(text)) == filled_page(text)


def test_every_verb_has_a_section_with_its_example() -> None:
    page = GENERATED_PAGES["docs/reference/verbs.md"][0]
    for verb in VERB_HELP:
        section = page.split(f"\n### handctl {verb}\n")[1].split("\n### ")[0]
        assert "example:\n" in section, verb


def test_every_topic_of_a_log_has_a_row() -> None:
    page = GENERATED_PAGES["docs/reference/topics.md"][0]
    for topic, (kind, _) in packaged_hand_topics().items():
        assert re.search(rf"^\| `{re.escape(topic)}` \| \[?`{kind}`", page, re.MULTILINE), topic
