"""Test that the command blocks of the README, the How-to pages and the page about tasks run as they are written.

A simulated hand runs beside each command block that needs a hand.

A reader executes the commands of the pages with own files and hands. The tests write packaged files
and hands under the names in the commands.
"""

import re
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from handctl.hand.hand_loading import hand_path
from tests.docs.code_blocks import (
    REPOSITORY_ROOT,
    FencedBlock,
    is_executed,
    is_file_block,
    keeps_running,
    read_code_blocks,
    run_code_blocks,
)

DOCS_FOLDER = REPOSITORY_ROOT / "docs"
PAGES_TESTED_ELSEWHERE = {"how-to/lerobot.md": "tests/lerobot/test_environment.py"}
"""Pages whose commands need further packages, each with the test file that runs these commands."""
BLOCKS_BY_PAGE = {
    path.relative_to(DOCS_FOLDER).as_posix(): read_code_blocks(path)
    for path in (
        *sorted((DOCS_FOLDER / "how-to").glob("*.md")),
        DOCS_FOLDER / "reference" / "tasks.md",
    )
    if path.relative_to(DOCS_FOLDER).as_posix() not in PAGES_TESTED_ELSEWHERE
}
EXECUTED_BLOCKS_BY_PAGE = {
    page: [block for block in blocks if is_executed(block)]
    for page, blocks in BLOCKS_BY_PAGE.items()
}
PAGES_WITH_SHORT_COMMANDS = ("how-to/logs.md", "how-to/other-tools.md")
"""Pages whose commands run in ordinary test runs.

The commands of pages that are not in this list run in nightly test runs, because each page takes
from ten seconds to minutes.
"""
SIMULATED_HAND_COMMAND = "handctl sim --hand jamia --bus local:lab --time-scale 0.5"
SIMULATOR_COMMANDS = {
    "how-to/bring-up.md": ("handctl sim --hand mine.toml --bus local:can0",),
    "how-to/drive-modes.md": (
        "python -m firmware_sim drive mit --ids 1 --bus local:can0",
        "python -m firmware_sim drive odrive --ids 3 --bus local:can1",
    ),
}
"""Commands that start simulators in place of the hardware that the pages use."""
CONFIRMED_COMMAND_BY_PAGE = {"how-to/drive-modes.md": ("handctl jog ", "handctl jog --yes ")}
"""Commands on the pages that ask for a confirmation before they move a motor.

The test replaces each of these commands by a command with the option ``--yes``, which gives the
confirmation.
"""
STIFFER_GAINS = "schema = 1\n\n[motion]\nforce_N = 16.0\n\n[tension]\nintegral_per_s = 4.0\n"
REALTIME_MARKS = [pytest.mark.realtime, pytest.mark.alone, pytest.mark.nightly]


def prepare_folder(golden_log: str, work_folder: Path) -> None:
    """Write the files that a reader of the pages would have: a log, a hand file, a task and gains."""
    (work_folder / "logs").mkdir()
    for name in ("RUN.mcap", "run.mcap", "logs/RUN.mcap"):
        shutil.copy(REPOSITORY_ROOT / "logs" / "golden" / f"{golden_log}.mcap", work_folder / name)
    shutil.copy(hand_path("jamia"), work_folder / "mine.toml")
    shutil.copy(
        REPOSITORY_ROOT / "src" / "handctl" / "tasks" / "grasp.toml", work_folder / "mine-task.toml"
    )
    (work_folder / "stiffer.toml").write_text(STIFFER_GAINS, encoding="utf-8")


def file_writer_for_page(page: str) -> Callable[[Path], None]:
    """Return the function that writes the files that a page needs.

    The page how-to/why-a-run-ended.md needs a log that contains a fault.
    """
    return partial(
        prepare_folder, "jamia-fault" if page == "how-to/why-a-run-ended.md" else "jamia-grasp"
    )


def page_test_cases() -> Iterator[Any]:
    """Yield one test case of pytest for each page that contains commands."""
    for page, blocks in EXECUTED_BLOCKS_BY_PAGE.items():
        if any(block.language == "sh" and not keeps_running(block) for block in blocks):
            is_realtime = page in SIMULATOR_COMMANDS or any(map(keeps_running, blocks))
            yield pytest.param(
                page,
                marks=REALTIME_MARKS
                if is_realtime
                else []
                if page in PAGES_WITH_SHORT_COMMANDS
                else [pytest.mark.nightly],
            )


@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", list(page_test_cases()))
def test_the_commands_of_a_page_run(page: str) -> None:
    command, confirmed_command = CONFIRMED_COMMAND_BY_PAGE.get(page, ("", ""))
    blocks = [
        block._replace(text=block.text.replace(command, confirmed_command)) if command else block
        for block in EXECUTED_BLOCKS_BY_PAGE[page]
    ]
    run_code_blocks(blocks, file_writer_for_page(page), SIMULATOR_COMMANDS.get(page, ()))


@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", [
    pytest.param(page, marks=REALTIME_MARKS)
    for page, blocks in EXECUTED_BLOCKS_BY_PAGE.items() if any(block.language == "python" for block in blocks)
])  # fmt: skip
def test_the_programs_of_a_page_run(page: str) -> None:
    programs = [block for block in EXECUTED_BLOCKS_BY_PAGE[page] if block.language == "python"]
    command_blocks = [FencedBlock("sh", "", f"python {block.title}\n") for block in programs]
    run_code_blocks(
        [*programs, *command_blocks], file_writer_for_page(page), (SIMULATED_HAND_COMMAND,)
    )


@pytest.mark.realtime
@pytest.mark.alone
@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_the_commands_of_the_readme_run() -> None:
    text = (
        (REPOSITORY_ROOT / "README.md")
        .read_text(encoding="utf-8")
        .partition("## Four uses")[2]
        .partition("\n## ")[0]
    )
    lines = re.findall(r"^handctl [^#\n]+", text, re.MULTILINE)
    simulators = [line.strip() for line in lines if line.startswith("handctl sim")]
    assert len(simulators) == 1
    assert len(lines) == 6
    commands = [FencedBlock("sh", "", line) for line in lines if line.strip() not in simulators]
    # Use a smaller time scale, as the README recommends for a slow machine. The machine that runs
    # this test is slow while other tests run.
    run_code_blocks(
        commands, partial(prepare_folder, "jamia-grasp"), [f"{simulators[0]} --time-scale 0.3"]
    )


def test_every_command_has_a_kind() -> None:
    for page, blocks in BLOCKS_BY_PAGE.items():
        for block in blocks:
            plain = block.language in ("", "text")
            assert not plain or not re.search(
                r"^(handctl|python -m firmware_sim) ", block.text, re.MULTILINE
            ), page
            assert (
                block.language != "python"
                or is_file_block(block)
                or "handctl.connect" not in block.text
            ), page
