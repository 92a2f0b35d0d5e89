"""The parser of command lines: what argparse says about foreign words is printable and of bounded length."""

import argparse
import re
from collections.abc import Sequence
from typing import NoReturn

from handctl.errors import ConfigError
from handctl.printing import message as one_line

END_AS_VALUE = re.compile(r"(--?[^=]+)=--")
"""An option whose value is the word that ends the options: argparse removes it and fails without a word."""


class Parser(argparse.ArgumentParser):
    """A parser, and the kind of its subparsers."""

    def error(self, message: str) -> NoReturn:
        """Print the usage and the error, and exit with 2."""
        super().error(one_line(message))


def check_words(words: Sequence[str]) -> None:
    """Refuse words that no verb can use.

    Raises:
        ConfigError: a word contains NUL, or the value of an option is ``--``.
    """
    if any("\0" in word for word in words):
        raise ConfigError("a word with a NUL in it", "the command line", "names as files can have them")
    for word in words:
        if match := END_AS_VALUE.fullmatch(word):
            raise ConfigError("-- is no value", match[1], "a value")
