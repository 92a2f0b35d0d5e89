"""Errors that handctl reports to the user.

Each error message is one line with the mistake, the location of the mistake and the expected value.
"""

from handctl.printing import one_line_message

REMOVE_POWER = "REMOVE POWER"
"""Text that marks a failure after which a motor possibly still has torque.

Only the operator can remove the torque of a motor after such a failure.
"""


class HandctlError(Exception):
    """Error whose message is one line of the form ``what; where; expected right``.

    The message is printable and of bounded length.

    Args:
        what: the mistake, together with the wrong value.
        where: location of the mistake: the path of a key, the name of a node, or a file and an
            offset. The text is empty if the mistake has no particular location.
        right: the expected value. The text is empty if no value can be suggested.
    """

    def __init__(self, what: str, where: str = "", right: str = "") -> None:
        """Join the three texts to the one-line message of the error."""
        self.what, self.where, self.right = what, where, right
        message_parts = [f"{where}: {what}" if where else what]
        if right:
            message_parts.append(f"expected {right}")
        super().__init__(one_line_message("; ".join(message_parts)))


class ConfigError(HandctlError):
    """Error for an invalid hand, task, gains, calibration or trajectory file, or for an invalid command line."""


class BusError(HandctlError):
    """Error for a bus that cannot be opened or is lost."""


class NoSimulatorError(BusError):
    """Error for a local bus on which no simulator runs.

    Args:
        bus: specification of the bus.
        reason: reason why the bus cannot be opened.
        command: command that starts a suitable simulator. The text is empty if the hand is unknown.
    """

    def __init__(self, bus: str, reason: str, command: str = "") -> None:
        """Build the message of the error. The message contains the command that starts a simulator."""
        self.bus, self.reason = bus, reason
        start = command or f"handctl sim --bus {bus}"
        super().__init__(
            f"no simulator serves this bus: {reason}", bus, f"a simulator there; type: {start}"
        )


class DriveError(HandctlError):
    """Error for a motor drive or sensor node that does not answer, refuses a command, or differs from the hand file."""


class PowerError(DriveError):
    """Error for a drive that did not confirm that it is disabled.

    The operator must switch off the power of the drive.
    """


class UnconfirmedError(PowerError, BusError):
    """Error for a request that the controller has not confirmed.

    If a request is not confirmed, the state of the hand is unknown.

    Args:
        bus: bus of the controller.
        request_name: name of the request, e.g. ``stop``.
        reason: event that occurred instead of the confirmation.
    """

    def __init__(self, bus: str, request_name: str, reason: str) -> None:
        """Build the message of the error. The message tells the operator to switch the power off."""
        super().__init__(
            f"no confirmation from the controller: switch the power off ({request_name}: {reason})",
            f"bus {bus}",
        )


class LogError(HandctlError):
    """Error for a log that cannot be read or belongs to another hand."""


class IncomparableError(LogError):
    """Error for two logs that cannot be compared, or for a log that does not fit a hand or this version of handctl."""
