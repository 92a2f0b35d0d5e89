"""Functions for all programs of the simulator: error lines, checks of arguments, and signal handlers."""

import argparse
import re
import signal
from collections.abc import Callable
from types import FrameType
from typing import NoReturn

from firmware_sim.description.hand_description import SimulatorError


class CommandParser(argparse.ArgumentParser):
    """A parser for command lines. Each error message of the parser has a single line."""

    def error(self, message: str) -> NoReturn:
        """Raise a SimulatorError for a usage error, because ``argparse.ArgumentParser.error`` would end the program."""
        raise SimulatorError(f"{message}; --help shows how")


def check_words(words: list[str]) -> None:
    """Refuse arguments that no program can use: arguments with NUL or a line end, and options with the value ``--``."""
    for word in words:
        if "\0" in word:
            raise SimulatorError("an argument with a NUL character; expected valid file names")
        if "\n" in word:
            raise SimulatorError(f"an argument with a line end: {word}; expected one line")
        if match := re.fullmatch(r"(--?[^=]+)=--", word):
            raise SimulatorError(f"{match[1]}: -- is not a value")


def check_time_scale(value: float) -> None:
    """Check that the ratio of simulated time to wall time lies between 0.001 and 100."""
    if not 0.001 <= value <= 100.0:
        raise SimulatorError(f"--time-scale {value:g}: expected 0.001 to 100")


def stop_on_signal(stop_program: Callable[[], None]) -> None:
    """Install ``stop_program`` as the handler of the signals SIGTERM and SIGINT."""

    def handle_signal(number: int, frame: FrameType | None) -> None:
        stop_program()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, handle_signal)
