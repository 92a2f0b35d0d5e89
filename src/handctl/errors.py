"""The errors that reach a person: each says what, where, and what would be right, in one line."""

from handctl.printing import message

REMOVE_POWER = "REMOVE POWER"
"""In a failure: torque may be left, and only a person can end it."""


class HandctlError(Exception):
    """An error with a one-line message: ``what; where; expected right``.

    The message is printable and of bounded length, whatever its parts quote.

    Args:
        what: what is wrong, with the offending value.
        where: key path, node, file and offset; empty if there is no better place than the message.
        right: what would be right; empty if nothing can be suggested.
    """

    def __init__(self, what: str, where: str = "", right: str = "") -> None:
        self.what, self.where, self.right = what, where, right
        parts = [f"{where}: {what}" if where else what]
        if right:
            parts.append(f"expected {right}")
        super().__init__(message("; ".join(parts)))


class ConfigError(HandctlError):
    """A hand, task, gains, calibration or trajectory file, or a command line, that cannot be used."""


class BusError(HandctlError):
    """A bus that cannot be opened or that is gone."""


class DriveError(HandctlError):
    """A motor drive or sensor node that is missing, refuses, or is not what the hand file says."""


class PowerError(DriveError):
    """A drive that did not confirm that it is disabled: somebody must remove its power."""


class UnconfirmedError(PowerError, BusError):
    """A request that no controller has confirmed: nobody knows what the hand does.

    Args:
        bus: of the controller.
        word: what was asked, e.g. ``stop``.
        why: what came instead of a confirmation.
    """

    def __init__(self, bus: str, word: str, why: str) -> None:
        super().__init__(f"nobody has confirmed: switch the power off ({word}: {why})", f"bus {bus}")


class LogError(HandctlError):
    """A log that cannot be read, or that does not belong to this hand."""


class IncomparableError(LogError):
    """Two logs, or a log and a hand, that do not belong together."""
