"""Shell completion of verbs and options, with argcomplete.

``eval "$(register-python-argcomplete handctl)"`` in a bash or zsh makes the shell call ``handctl``
with ``_ARGCOMPLETE`` in its environment, each time the user presses the Tab key.
"""

import os
from pathlib import Path
from typing import Any

from handctl.cli.parsing.parser import Parser

HANDS = Path(__file__).parents[2] / "hand" / "hands"
"""Folder of the packaged hands, as in ``hand.load``.

Importing ``hand.load`` would delay the completion.
"""


def is_completing() -> bool:
    """Return True if a shell asks for completions."""
    return "_ARGCOMPLETE" in os.environ


def print_completions(parser: Parser) -> None:
    """Print the completions for the shell, and end this process."""
    import argcomplete

    argcomplete.autocomplete(parser)


def hand_names(prefix: str, **context: Any) -> list[str]:
    """Return the packaged hands and the hand files that begin with a prefix."""
    files = [path for path in Path().glob("*.toml") if path.is_file()]
    return [name for name in (*sorted(path.stem for path in HANDS.glob("*.toml")), *map(str, files))
            if name.startswith(prefix)]  # fmt: skip
