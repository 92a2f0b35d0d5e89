"""Exit codes of all commands. docs/reference/exit-codes.md is generated from their docstrings."""

from enum import IntEnum


class ExitCode(IntEnum):
    """Exit code of a command."""

    DONE = 0
    FAILED = 1
    """The job failed: for example, a drive is missing or a fault ended the run."""
    BAD_INPUT = 2
    """A file or an argument is wrong. No bus was opened."""
    LOSSY_LOG = 3
    """A log was read only in part."""
    NOT_COMPARABLE = 4
    """Two logs, a log and a hand, or a log and this version of handctl do not belong together."""
    NOT_CHECKED = 5
    """No check of a drive failed, but at least one could not be made."""
    INTERNAL = 70
    """A bug in handctl. The drives were commanded to disable and confirmed it."""
    REMOVE_POWER = 71
    """A drive did not confirm that it is disabled, or no controller confirmed the request: remove power."""
    INTERRUPTED = 130
    """Ctrl-C while no hand was running.

    A running hand is relaxed and disarmed, and the exit code reports the result.
    """
    TERMINATED = 143
    """SIGTERM or SIGHUP while no hand was running. A running hand is handled as for Ctrl-C."""
