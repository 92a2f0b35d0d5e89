"""Read the command blocks of documentation pages, and execute their commands in an empty folder."""

import os
import re
import select
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

REPOSITORY_ROOT = Path(__file__).parents[2]
FENCE_PATTERN = re.compile(
    r"^( *)```(\w*)(?: title=\"([^\"]*)\")?\n(.*?)^ *```$", re.MULTILINE | re.DOTALL
)
READY_TIMEOUT_S = 120.0
"""Longest permitted time from the start of a process to its first printed line [s], including compilation."""

BLOCK_TIMEOUT_S = 600.0
"""Longest permitted time of all commands in a block together, on a busy machine [s]."""


class FencedBlock(NamedTuple):
    """A fenced block of a documentation page: its language, its title and its text."""

    language: str
    title: str
    text: str


def read_code_blocks(path: Path) -> list[FencedBlock]:
    """Return the fenced blocks of a documentation page, in their order on the page."""
    matches = FENCE_PATTERN.finditer(path.read_text(encoding="utf-8"))
    return [
        FencedBlock(
            match[2], match[3] or "", re.sub(f"^{match[1]}", "", match[4], flags=re.MULTILINE)
        )
        for match in matches
    ]


def is_executed(block: FencedBlock) -> bool:
    """Return True if a test executes the block, or writes the block to a file."""
    return (block.language == "sh" and "not run" not in block.title) or is_file_block(block)


def is_file_block(block: FencedBlock) -> bool:
    """Return True for a block that contains a Python program or a TOML file.

    The title of a block with a program or a TOML file is the name of the file.
    """
    return block.language in ("python", "toml") and bool(
        re.fullmatch(r"[\w-]+\.(py|toml)", block.title)
    )


def keeps_running(block: FencedBlock) -> bool:
    """Return True for a block whose command continues to run while later commands run."""
    return "stays open" in block.title


def run_code_blocks(
    code_blocks: Sequence[FencedBlock],
    write_files: Callable[[Path], None] | None = None,
    parallel_commands: Sequence[str] = (),
) -> None:
    """Execute the commands of a documentation page in an empty folder.

    Args:
        code_blocks: blocks of the page. The function writes the file blocks of the page to files
            before it executes commands.
        write_files: function that writes further files into the folder.
        parallel_commands: further commands, which run during the commands of the page.
    """
    folder, sockets = (Path(tempfile.mkdtemp(prefix="h-")) for _ in range(2))
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    environment = os.environ | {"PATH": path, "HANDCTL_RUN_DIR": str(sockets)}
    process_options: dict[str, Any] = {"cwd": folder, "env": environment, "text": True}
    background_processes: list[subprocess.Popen[str]] = []
    if write_files:
        write_files(folder)
    for block in filter(is_file_block, code_blocks):
        (folder / block.title).write_text(replace_socketcan_buses(block.text))
    try:
        for command in parallel_commands:
            start_in_background_shell(command, background_processes, process_options)
        for block in code_blocks:
            if block.language != "sh" or not is_executed(block):
                continue
            if keeps_running(block):
                start_in_background_shell(
                    replace_socketcan_buses(block.text), background_processes, process_options
                )
                continue
            script = f"set -e\n{replace_socketcan_buses(block.text)}"
            result = subprocess.run(
                ["bash", "-c", script],
                capture_output=True,
                timeout=BLOCK_TIMEOUT_S,
                check=False,
                **process_options,
            )
            assert result.returncode == 0, (
                f"{block.text}\n{result.stdout[-1000:]}\n{result.stderr[-2000:]}"
            )
            assert "Traceback" not in result.stderr
    finally:
        for background_process in background_processes:
            background_process.terminate()
            background_process.wait(30)
        for temporary_folder in (folder, sockets):
            shutil.rmtree(temporary_folder, ignore_errors=True)


def start_in_background_shell(
    command: str,
    background_processes: list["subprocess.Popen[str]"],
    process_options: dict[str, Any],
) -> None:
    """Start a command in the background, and wait until it prints its first line."""
    background_processes.append(
        subprocess.Popen(
            ["bash", "-c", f"exec {command.strip()}"], stdout=subprocess.PIPE, **process_options
        )
    )
    stdout = background_processes[-1].stdout
    assert stdout
    assert select.select([stdout], [], [], READY_TIMEOUT_S)[0], command


def replace_socketcan_buses(text: str) -> str:
    """Return command lines in which a local bus replaces each SocketCAN bus.

    The tests replace SocketCAN buses, because not every Linux kernel has SocketCAN.
    """
    return re.sub(r"socketcan:(v?can\d)", r"local:\1", text)
