"""Errors that are reported to the user. Each is one line: the mistake, its place, and the expected value."""

from handctl.printing import one_line_message

REMOVE_POWER = "REMOVE POWER"
"""Marks a failure after which a motor may still have torque. Only the operator can remove this torque."""


class HandctlError(Exception):
    """An error with a one-line message: ``what; where; expected right``.

    The message is printable and of bounded length.

    Args:
        what: the mistake, with the wrong value.
        where: key path, node, or file and offset. It is empty without a place.
        right: the expected value. It is empty without a suggestion.
    """

    def __init__(self, what: str, where: str = "", right: str = "") -> None:
        self.what, self.where, self.right = what, where, right
        parts = [f"{where}: {what}" if where else what]
        if right:
            parts.append(f"expected {right}")
        super().__init__(one_line_message("; ".join(parts)))


class ConfigError(HandctlError):
    """Invalid hand, task, gains, calibration or trajectory file, or invalid command line."""


class BusError(HandctlError):
    """Bus that cannot be opened or is lost."""


class DriveError(HandctlError):
    """Motor drive or sensor node that is missing, refuses, or differs from the hand file."""


class PowerError(DriveError):
    """Drive that did not confirm that it is disabled. The operator must remove its power."""


class UnconfirmedError(PowerError, BusError):
    """Request without a confirmation of the controller. The state of the hand is unknown.

    Args:
        bus: bus of the controller.
        word: request, e.g. ``stop``.
        why: event that came instead of the confirmation.
    """

    def __init__(self, bus: str, word: str, why: str) -> None:
        super().__init__(f"no confirmation from the controller: switch the power off ({word}: {why})", f"bus {bus}")


class LogError(HandctlError):
    """Log that cannot be read or belongs to another hand."""


class IncomparableError(LogError):
    """Two logs, or a log and a hand, that cannot be compared."""
