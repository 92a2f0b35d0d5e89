"""The parser of command lines: what argparse says about foreign words is printable and of bounded length."""

import argparse
import re
from collections.abc import Sequence
from typing import NoReturn

from handctl.errors import ConfigError
from handctl.printing import printable

END_AS_VALUE = re.compile(r"(--?[^=]+)=--")
"""An option whose value is the word that ends the options: argparse removes it and fails without a word."""


class Parser(argparse.ArgumentParser):
    """A parser, and the kind of its subparsers."""

    def error(self, message: str) -> NoReturn:
        """Refuse the command line in one line.

        Raises:
            ConfigError: always.
        """
        where = self.prog.removeprefix("handctl").strip() or "the command line"
        told = "expected" in message or "choose from" in message
        raise ConfigError(message, where, "" if told else f"what {self.prog} --help lists")


def check_words(words: Sequence[str]) -> None:
    """Refuse words that no verb can use.

    Raises:
        ConfigError: a word contains NUL or a line end, or the value of an option is ``--``.
    """
    for mark, name in (("\0", "a NUL"), ("\n", "a line end")):
        for word in words:
            if mark in word:
                what = f"a word with {name} in it: {printable(word)}"
                raise ConfigError(what, "the command line", "words without it")
    for word in words:
        if match := END_AS_VALUE.fullmatch(word):
            raise ConfigError("-- is no value", match[1], "a value")
