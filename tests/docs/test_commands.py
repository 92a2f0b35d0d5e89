"""The command blocks of Start and Tutorials run as they stand, each page in a folder of its own.

A block with "not run" in its title needs hardware, root or a screen. A block that "stays open" runs beside the others.
"""

from collections.abc import Iterator
from typing import Any

import pytest

from tests.docs.command_blocks import ROOT, blocks, is_file, is_run, run_blocks, stays_open

PAGES = sorted([*(ROOT / "docs" / "start").glob("*.md"), *(ROOT / "docs" / "tutorials").glob("*.md")])
BLOCKS = {path.relative_to(ROOT / "docs").as_posix(): blocks(path) for path in PAGES}
RUN = {page: [block for block in parts if is_run(block)] for page, parts in BLOCKS.items()}
"""Blocks of each page that are executed, or written to the file that their title names."""
LONG = ("start/first-hand.md", "tutorials/policy.md", "tutorials/tune-gains.md")
"""Pages of the nightly run.

Each page takes a minute, and has commands that other pages have as well.
"""


def cases() -> Iterator[Any]:
    """Yield the pages with commands.

    Pages with a process in real time have the marker of such tests.
    """
    for page, parts in RUN.items():
        if any(block.language == "sh" for block in parts):
            marks = [pytest.mark.realtime, pytest.mark.alone] if any(map(stays_open, parts)) else []
            if page in LONG:
                marks.append(pytest.mark.nightly)
            yield pytest.param(page, marks=marks)


@pytest.mark.parametrize("page", list(cases()))
def test_the_commands_of_a_page_run(page: str) -> None:
    run_blocks(RUN[page])


def test_every_block_has_a_known_kind() -> None:
    for page, parts in BLOCKS.items():
        for block in parts:
            assert block.language in ("sh", "python", "toml", "text"), page
            assert block.language not in ("python", "toml") or is_file(block), page


def test_most_blocks_are_run() -> None:
    shell = [block for parts in BLOCKS.values() for block in parts if block.language == "sh"]
    assert sum("not run" in block.title for block in shell) < len(shell) / 3
