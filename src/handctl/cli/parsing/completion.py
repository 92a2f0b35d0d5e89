"""Completion of verbs and options in a shell, by argcomplete.

``eval "$(register-python-argcomplete handctl)"`` in a bash or zsh makes the shell call ``handctl`` with
``_ARGCOMPLETE`` in its environment, each time that the user presses the tabulator key.
"""

import os
from pathlib import Path
from typing import Any

from handctl.cli.parsing.parser import Parser

HANDS = Path(__file__).parents[2] / "hand" / "hands"
"""Packaged hands, as ``hand.load`` finds them. Its import would take longer than a user waits for a completion."""


def is_completing() -> bool:
    """Return whether a shell asks for completions."""
    return "_ARGCOMPLETE" in os.environ


def complete(parser: Parser) -> None:
    """Answer the shell, and end this process."""
    import argcomplete

    argcomplete.autocomplete(parser)


def hand_names(prefix: str, **context: Any) -> list[str]:
    """Return the packaged hands and the hand files that begin with a prefix."""
    files = [path for path in Path().glob("*.toml") if path.is_file()]
    return [name for name in (*sorted(path.stem for path in HANDS.glob("*.toml")), *map(str, files))
            if name.startswith(prefix)]  # fmt: skip
