"""Exit codes of every verb; the README's table is the same."""

from enum import IntEnum


class Exit(IntEnum):
    """What a verb's exit code means."""

    DONE = 0
    FAILED = 1
    """The job could not be done: a drive is missing, a fault ended the run."""
    BAD_INPUT = 2
    """A file or an argument is wrong; no bus was opened."""
    LOSSY_LOG = 3
    """A log was read, but not all of it."""
    NOT_COMPARABLE = 4
    """Two logs, or a log and a hand, that do not belong together."""
    INTERNAL = 70
    """A bug in handctl; the drives were told to let go, and said that they did."""
    REMOVE_POWER = 71
    """A drive did not confirm that it is disabled: remove power."""
    INTERRUPTED = 130
    """Ctrl-C, where no hand ran; a hand that runs is relaxed and disarmed, and the code says how that went."""
    TERMINATED = 143
    """SIGTERM or SIGHUP, likewise."""
