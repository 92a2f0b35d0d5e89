"""Print the result of each check of a client program, and collect the failed checks.

The module ``check_list`` needs only the standard library.
"""

import sys
import time
from collections.abc import Callable

WAIT_TIMEOUT_S = 20.0
PASSED_WORD, FAILED_WORD = "check passed:", "check failed:"
"""Beginnings of the output lines that report a passed and a failed check."""


class CheckList:
    """List of the checks that a client program has made so far.

    Attributes:
        failed: names of the failed checks.
    """

    def __init__(self) -> None:
        self.failed: list[str] = []

    def check(self, check_name: str, has_passed: bool, observed_value: object = "") -> None:
        """Print the result of a check in one line.

        Args:
            check_name: the property that is checked.
            has_passed: True if the simulated drive has the property.
            observed_value: the observed value, which the line of a failed check shows.
        """
        if has_passed:
            print(PASSED_WORD, check_name, flush=True)
        else:
            self.failed.append(check_name)
            print(FAILED_WORD, check_name, f"({observed_value})", flush=True)

    def check_eventually(
        self, check_name: str, read_value: Callable[[], object], expected_value: object
    ) -> None:
        """Read a value repeatedly, and report the check as passed as soon as the value is the expected one.

        Args:
            check_name: the property that is checked.
            read_value: function that reads a value.
            expected_value: expected value, or a function that returns True for an expected value.
        """
        end_s = time.monotonic() + WAIT_TIMEOUT_S
        while True:
            value = read_value()
            passed = (
                bool(expected_value(value)) if callable(expected_value) else value == expected_value
            )
            if passed or time.monotonic() > end_s:
                self.check(check_name, passed, value)
                return
            time.sleep(0.02)

    def check_raises(
        self, check_name: str, action: Callable[[], object], expected_text: str
    ) -> None:
        """Execute an action, and report the check as passed if the action raises an error with a given text."""
        try:
            action()
        except Exception as error:  # noqa: BLE001 - each client has errors of its own
            self.check(check_name, expected_text in str(error), error)
        else:
            self.check(check_name, False, "no error")

    def end(self) -> None:
        """End the program, with exit status 1 if a check has failed."""
        sys.stdout.flush()
        sys.exit(1 if self.failed else 0)
