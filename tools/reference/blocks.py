"""Find the generated blocks in the pages, and replace them by new text.

A page of docs/ contains ``<!-- generated: NAME -->``, the block, and ``<!-- end of generated -->``.
"""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

from tools.reference import command_line, faults, files, python_api, topics

BLOCK_FUNCTIONS: dict[str, Callable[[], str]] = {
    "verbs": command_line.verb_sections,
    "verb-table": command_line.verb_table,
    "exit-codes": command_line.exit_codes,
    "python": python_api.exported_name_sections,
    "hand-file": files.hand_file_sections,
    "motor-options": files.motor_option_sections,
    "gains": files.gains_sections,
    "requests": files.request_sections,
    "topics": topics.topic_table,
    "message-types": topics.message_types,
    "telemetry": topics.telemetry_table,
    "fault-table": faults.fault_table_markdown,
    "fault-sections": faults.fault_sections,
    "fault-catalogue": faults.catalogue_markdown,
    "fault-times": faults.late_reactions_markdown,
    "hardware-tests": faults.hardware_checklist,
}
"""For the name of each block, the function that generates its text."""
BLOCK_PATTERN = re.compile(
    r"(<!-- generated: ([\w-]+) -->\n)(.*?)(<!-- end of generated -->)", re.DOTALL
)
"""Pattern of a block in a page, with the two marks around it."""


def pages_with_blocks(repository_folder: Path) -> Iterator[tuple[Path, str, str]]:
    """Yield the path, the present text and the newly generated text of each page that contains a block."""
    for path in sorted([repository_folder / "README.md", *repository_folder.glob("docs/**/*.md")]):
        text = path.read_text(encoding="utf-8")
        if BLOCK_PATTERN.search(text):
            yield path, text, filled_page(text)


def filled_page(text: str) -> str:
    """Return the text of a page in which newly generated blocks replace the old blocks.

    Raises:
        KeyError: the page names an unknown block.
    """
    return BLOCK_PATTERN.sub(
        lambda match: f"{match[1]}\n{BLOCK_FUNCTIONS[match[2]]().strip()}\n\n{match[4]}", text
    )


def stale_pages(repository_folder: Path) -> list[str]:
    """Return the pages whose blocks differ from the code."""
    return [
        path.relative_to(repository_folder).as_posix()
        for path, text, fresh_text in pages_with_blocks(repository_folder)
        if text != fresh_text
    ]


def written_pages(repository_folder: Path) -> list[str]:
    """Write the pages whose blocks differ from the code, and return their names."""
    names = []
    for path, text, fresh_text in pages_with_blocks(repository_folder):
        if text != fresh_text:
            path.write_text(fresh_text, encoding="utf-8")
            names.append(path.relative_to(repository_folder).as_posix())
    return names
