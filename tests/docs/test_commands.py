"""The command blocks of Start and Tutorials run as they stand, each page in a folder of its own.

A block with "not run" in its title needs hardware, root or a screen. A block that "stays open" runs beside the others.
"""

import os
import re
import select
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*(ROOT / "docs" / "start").glob("*.md"), *(ROOT / "docs" / "tutorials").glob("*.md")])
FENCE = re.compile(r"^( *)```(\w+)(?: title=\"([^\"]*)\")?\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
READY_S = 120.0
"""Longest time for a process to print its first line, with compilation [s]."""


class Block(NamedTuple):
    """A block of a page: language, title and text."""

    language: str
    title: str
    text: str


def blocks(path: Path) -> list[Block]:
    """Return the blocks of a page in order."""
    found = FENCE.finditer(path.read_text(encoding="utf-8"))
    return [
        Block(match[2], match[3] or "", re.sub(f"^{match[1]}", "", match[4], flags=re.MULTILINE)) for match in found
    ]


BLOCKS = {path.relative_to(ROOT / "docs").as_posix(): blocks(path) for path in PAGES}
RUN = {
    page: [block for block in parts if block.language in ("sh", "python", "toml") and "not run" not in block.title]
    for page, parts in BLOCKS.items()
}
"""Blocks of each page that are executed, or written to the file that their title names."""
LONG = ("start/first-hand.md", "tutorials/policy.md", "tutorials/tune-gains.md")
"""Pages of the nightly run. Each takes a minute, with commands that other pages have as well."""


def cases() -> Iterator[Any]:
    """Yield the pages with commands. Those with a process in real time have the marker of such tests."""
    for page, parts in RUN.items():
        live = any("stays open" in block.title for block in parts)
        if any(block.language == "sh" for block in parts):
            marks = [pytest.mark.realtime, pytest.mark.alone] if live else []
            if page in LONG:
                marks.append(pytest.mark.nightly)
            yield pytest.param(page, marks=marks)


@pytest.mark.parametrize("page", list(cases()))
def test_the_commands_of_a_page_run(page: str) -> None:
    folder, sockets = (Path(tempfile.mkdtemp(prefix="h-")) for _ in range(2))
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    environment = os.environ | {"PATH": path, "HANDCTL_RUN_DIR": str(sockets)}
    others: list[subprocess.Popen[str]] = []
    files = [block for block in RUN[page] if block.language in ("python", "toml")]
    for block in files:
        (folder / block.title).write_text(on_the_embedded_bus(block.text))
    try:
        for block in RUN[page]:
            if block.language != "sh":
                continue
            script = f"set -e\n{on_the_embedded_bus(block.text)}"
            words: dict[str, Any] = {"cwd": folder, "env": environment, "text": True}
            if "stays open" in block.title:
                command = f"exec {on_the_embedded_bus(block.text).strip()}"
                others.append(subprocess.Popen(["bash", "-c", command], stdout=subprocess.PIPE, **words))
                stdout = others[-1].stdout
                assert stdout
                assert select.select([stdout], [], [], READY_S)[0], block.text
                continue
            ran = subprocess.run(["bash", "-c", script], capture_output=True, timeout=280, check=False, **words)
            assert ran.returncode == 0, f"{block.text}\n{ran.stdout[-1000:]}\n{ran.stderr[-2000:]}"
            assert "Traceback" not in ran.stderr
    finally:
        for other in others:
            other.terminate()
            other.wait(30)
        for made in (folder, sockets):
            shutil.rmtree(made, ignore_errors=True)


def on_the_embedded_bus(text: str) -> str:
    """Return commands with the bus between processes in place of vcan, which not every kernel has."""
    return text.replace("socketcan:vcan0", "local:vcan0")


def test_every_block_has_a_known_kind() -> None:
    for page, parts in BLOCKS.items():
        for block in parts:
            assert block.language in ("sh", "python", "toml", "text"), page
            assert block.language not in ("python", "toml") or re.fullmatch(r"[\w-]+\.(py|toml)", block.title), page


def test_most_blocks_are_run() -> None:
    shell = [block for parts in BLOCKS.values() for block in parts if block.language == "sh"]
    assert sum("not run" in block.title for block in shell) < len(shell) / 3
