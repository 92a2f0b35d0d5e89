"""Shell completion of commands and options, with the package argcomplete.

The shell command ``eval "$(register-python-argcomplete handctl)"`` prepares bash or zsh. When the
user of a prepared shell presses the Tab key, the shell calls ``handctl`` with the environment
variable ``_ARGCOMPLETE``.
"""

import os
from pathlib import Path
from typing import Any

from handctl.cli.parsing.parser import VerbParser

HANDS_FOLDER = Path(__file__).parents[2] / "hand" / "hands"
"""Folder of the packaged hands, as in ``hand.hand_loading``.

The path is repeated here, because an import of ``hand.hand_loading`` would delay the completion.
"""


def is_shell_completion() -> bool:
    """Return True if a shell has called this program to get completions."""
    return "_ARGCOMPLETE" in os.environ


def print_completions(parser: VerbParser) -> None:
    """Print the possible completions of a command line for the shell, and end this process."""
    import argcomplete

    argcomplete.autocomplete(parser)


def hand_names(prefix: str, **context: Any) -> list[str]:
    """Return the names that begin with a prefix: names of packaged hands, and of TOML files in the present folder."""
    files = [path for path in Path().glob("*.toml") if path.is_file()]
    return [name for name in (*sorted(path.stem for path in HANDS_FOLDER.glob("*.toml")), *map(str, files))
            if name.startswith(prefix)]  # fmt: skip
