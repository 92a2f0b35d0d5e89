"""Test that the command blocks run as they are written, on all pages of the sections Start and Tutorials.

For each page, the test executes the command blocks in an empty folder.

The test does not execute a block with "not run" in its title, because this block needs hardware,
root rights or a screen. A command block with "stays open" in its title continues to run while later
blocks of the page run.
"""

from collections.abc import Iterator
from typing import Any

import pytest

from tests.docs.code_blocks import (
    REPOSITORY_ROOT,
    is_executed,
    is_file_block,
    keeps_running,
    read_code_blocks,
    run_code_blocks,
)

PAGE_FILES = sorted(
    [
        *(REPOSITORY_ROOT / "docs" / "start").glob("*.md"),
        *(REPOSITORY_ROOT / "docs" / "tutorials").glob("*.md"),
    ]
)
BLOCKS_BY_PAGE = {
    path.relative_to(REPOSITORY_ROOT / "docs").as_posix(): read_code_blocks(path)
    for path in PAGE_FILES
}
EXECUTED_BLOCKS_BY_PAGE = {
    page: [block for block in blocks if is_executed(block)]
    for page, blocks in BLOCKS_BY_PAGE.items()
}
"""Blocks of each page that a test executes, or whose text the test writes to a file.

The title of a block that is written to a file is the name of the file.
"""
PAGES_WITH_LONG_COMMANDS = ("start/first-hand.md", "tutorials/policy.md", "tutorials/tune-gains.md")
"""Pages whose commands run only in nightly test runs.

The commands of each page in ``PAGES_WITH_LONG_COMMANDS`` take a minute. Ordinary test runs execute
the same commands on other pages.
"""


def page_test_cases() -> Iterator[Any]:
    """Yield a test case for each page that contains commands.

    Each test case has pytest markers, such as the marker of tests that need a real clock.

    A page that starts a process in real time gets the marker for tests on the real clock.
    """
    for page, blocks in EXECUTED_BLOCKS_BY_PAGE.items():
        if any(block.language == "sh" for block in blocks):
            marks = (
                [pytest.mark.realtime, pytest.mark.alone] if any(map(keeps_running, blocks)) else []
            )
            if page in PAGES_WITH_LONG_COMMANDS:
                marks.append(pytest.mark.nightly)
            yield pytest.param(page, marks=marks)


@pytest.mark.parametrize("page", list(page_test_cases()))
def test_the_commands_of_a_page_run(page: str) -> None:
    run_code_blocks(EXECUTED_BLOCKS_BY_PAGE[page])


def test_every_block_has_a_known_kind() -> None:
    for page, blocks in BLOCKS_BY_PAGE.items():
        for block in blocks:
            assert block.language in ("sh", "python", "toml", "text"), page
            assert block.language not in ("python", "toml") or is_file_block(block), page


def test_most_blocks_are_run() -> None:
    shell_blocks = [
        block for blocks in BLOCKS_BY_PAGE.values() for block in blocks if block.language == "sh"
    ]
    assert sum("not run" in block.title for block in shell_blocks) < len(shell_blocks) / 3
