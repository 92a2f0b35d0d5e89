"""Common parts of the command-line programs: errors of one line, and an orderly end."""

import argparse
import re
import signal
from collections.abc import Callable
from types import FrameType
from typing import NoReturn

from firmware_sim.description import SimulatorError


class CommandParser(argparse.ArgumentParser):
    """A parser that reports errors in one line."""

    def error(self, message: str) -> NoReturn:
        """Raise the error for the caller."""
        raise SimulatorError(f"{message}; --help shows how")


def check_words(words: list[str]) -> None:
    """Check for arguments that no program can use: NUL, line ends, and the end of the options as an option's value."""
    for word in words:
        if "\0" in word:
            raise SimulatorError("an argument with a NUL character; expected valid file names")
        if "\n" in word:
            raise SimulatorError(f"an argument with a line end: {word}; expected one line")
        if match := re.fullmatch(r"(--?[^=]+)=--", word):
            raise SimulatorError(f"{match[1]}: -- is not a value")


def check_time_scale(value: float) -> None:
    """Check that a pace is neither too slow to tick nor too fast for any machine."""
    if not 0.001 <= value <= 100.0:
        raise SimulatorError(f"--time-scale {value:g}: expected 0.001 to 100")


def until_signal(stop: Callable[[], None]) -> None:
    """Install ``stop`` as handler of SIGTERM and SIGINT."""

    def handle(number: int, frame: FrameType | None) -> None:
        stop()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, handle)
