"""Counted checks of a client program. This module needs only the standard library."""

import sys
import time
from collections.abc import Callable

WAIT_TIMEOUT_S = 20.0
PASSED_WORD, FAILED_WORD = "check passed:", "check failed:"
"""Beginnings of the lines that report a check."""


class CheckList:
    """Checks that a client program has made so far.

    Attributes:
        failed: names of the failed checks.
    """

    def __init__(self) -> None:
        self.failed: list[str] = []

    def check(self, name: str, passed: bool, seen: object = "") -> None:
        """Report a check in one line.

        Args:
            name: the property that is checked.
            passed: True if the simulated drive has the property.
            seen: the observed value, for a failed check.
        """
        if passed:
            print(PASSED_WORD, name, flush=True)
        else:
            self.failed.append(name)
            print(FAILED_WORD, name, f"({seen})", flush=True)

    def check_until(self, name: str, read: Callable[[], object], reached: object) -> None:
        """Report a check that passes as soon as a read value is the expected one.

        Args:
            name: the property that is checked.
            read: function that reads a value.
            reached: expected value, or a function that returns True for an expected value.
        """
        end_s = time.monotonic() + WAIT_TIMEOUT_S
        while True:
            value = read()
            passed = bool(reached(value)) if callable(reached) else value == reached
            if passed or time.monotonic() > end_s:
                self.check(name, passed, value)
                return
            time.sleep(0.02)

    def check_raises(self, name: str, action: Callable[[], object], text: str) -> None:
        """Report a check that passes if an action raises an error whose message contains a text."""
        try:
            action()
        except Exception as error:  # noqa: BLE001 - each client has errors of its own
            self.check(name, text in str(error), error)
        else:
            self.check(name, False, "no error")

    def end(self) -> None:
        """End the program, with exit status 1 if a check has failed."""
        sys.stdout.flush()
        sys.exit(1 if self.failed else 0)
