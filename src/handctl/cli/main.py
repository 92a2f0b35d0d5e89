"""The command line: a table of verbs. What one takes is in ``arguments`` of its folder, what it does in its own module.

Only the arguments are imported for help and for mistakes, so that they come at once.
"""

import argparse
import errno
import importlib
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress

from handctl.cli.console.ended import Terminated, ended_by_signals, give_bugs_a_code
from handctl.cli.console.needs import optional_packages
from handctl.cli.console.parser import Parser, check_words
from handctl.cli.console.streams import flush, give_up_output, make_usable
from handctl.errors import ConfigError, HandctlError, IncomparableError, LogError, PowerError
from handctl.extras import missing_extra, require
from handctl.printing import escaped_streams, message
from handctl.session.exit_codes import Exit

VERBS = {
    "demo": "close a simulated hand on an object and look at the run",
    "run": "carry out a task on a hand",
    "stop": "relax and disarm a running hand",
    "clear": "clear latched faults of a running hand",
    "commission": "tare, zero, and prove each tendon's sign",
    "jog": "move one digit or tendon by hand",
    "view": "look at a log in Rerun, or make a picture of it",
    "replay": "a log through the controller, on the hand, or past other limits",
    "log": "say what is in a log, check, compare, export or repair it",
    "report": "one self-contained HTML page of a run",
    "sim": "start a simulated hand on a bus",
    "fault": "inject faults into a simulated hand, or try the whole matrix",
    "config": "show a hand and where each value comes from, or check files",
    "identify": "find out what a hand is made of: stiffness, friction, springs, inertia",
    "gains": "which gains a hand uses and why; other ones, the way back, live changes",
    "paper": "reproduce the source paper, with what is wrong in it",
    "bus": "plan the load of a hand's buses, or look at buses and say what to mend",
    "scan": "find the drives on a bus without moving anything",
    "conformance": "check the contract of one drive on the drive itself",
    "tune": "gains by design, by search on the twin, verified on the hand",
    "doctor": "check this machine: priority, buses, viewer",
}
"""Each verb and what a person wants with it."""
FOLDERS = {
    "runs": ("demo", "run", "stop", "clear", "commission", "jog", "sim"),
    "logs": ("view", "replay", "log", "report"),
    "checks": ("config", "bus", "scan", "conformance", "doctor"),
    "tuning": ("identify", "gains", "tune"),
    "studies": ("fault", "paper"),
}
"""Where each verb has its module."""

EPILOG = """exit codes: 0 done, 1 failed, 2 bad input, 3 lossy log, 4 not comparable, 70 internal error, 71 remove power
            130 interrupted, 143 terminated (where no hand ran)
first steps: handctl demo        help on a verb: handctl VERB --help"""

WRONG_NAME = {
    errno.ENOENT, errno.EEXIST, errno.ENOTDIR, errno.EISDIR, errno.ENOTEMPTY, errno.ENAMETOOLONG, errno.ELOOP,
}  # fmt: skip
"""Where a person gave a name that cannot be; every other failure of a file is the machine's."""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of ``handctl``; what goes wrong becomes one line and an exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    if argv is None:
        give_bugs_a_code()
    make_usable()
    with escaped_streams():
        return _ended(words)


def _ended(words: list[str]) -> int:
    """Carry out a command line; its exit code, also of what goes wrong."""
    try:
        with ended_by_signals():
            check_words(words)
            code = _done(words)
            flush()
            return code
    except IncomparableError as error:
        return _say(error, Exit.NOT_COMPARABLE)
    except (ConfigError, LogError) as error:
        return _say(error, Exit.BAD_INPUT)
    except ModuleNotFoundError as error:
        missing = missing_extra(words[0], error)
        if missing is None:
            raise
        return _say(missing, Exit.BAD_INPUT)
    except PowerError as error:
        if error.__cause__:  # a bug in handctl
            traceback.print_exception(error.__cause__)
        return _say(error, Exit.REMOVE_POWER)
    except HandctlError as error:
        return _say(error, Exit.FAILED)
    except BrokenPipeError:
        give_up_output()
        return Exit.DONE
    except OSError as error:
        nameless = "the working folder: " if error.errno == errno.ENOENT else ""  # it has been taken away
        where = f"{error.filename}: " if error.filename else nameless
        text = f"{where}{error.strerror or error}"
        return _say(text, Exit.BAD_INPUT if error.errno in WRONG_NAME else Exit.FAILED)
    except Terminated as error:
        return _say(str(error) or "ended by a signal", Exit.TERMINATED)
    except KeyboardInterrupt as error:
        return _say(str(error) or "interrupted", Exit.INTERRUPTED)


def _done(words: list[str]) -> int:
    """The exit code of what was asked for."""
    if words and words[0] in VERBS:
        return _verb(words[0], words[1:])
    parser = Parser(
        prog="handctl",
        description="Controller and data logger for tendon-driven robot hands.",
        epilog="verbs:\n" + "".join(f"  {name:<12}{text}\n" for name, text in VERBS.items()) + "\n" + EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="print the version")
    parser.add_argument("verb", nargs="?", choices=list(VERBS), metavar="VERB", help="what to do, see below")
    args = parser.parse_args(words)
    if args.version:
        from importlib.metadata import version

        print(version("handctl"))
        return Exit.DONE
    parser.print_help()
    return Exit.DONE


def _folder(name: str) -> str:
    """Return the folder in which a verb has its module."""
    return next(folder for folder, verbs in FOLDERS.items() if name in verbs)


def _verb(name: str, words: list[str]) -> int:
    """Run one verb."""
    folder = f"handctl.cli.{_folder(name)}"
    arguments = importlib.import_module(f"{folder}.arguments")
    parser = Parser(
        prog=f"handctl {name}",
        description=VERBS[name][0].upper() + VERBS[name][1:] + ".",
        epilog=f"example:\n  {arguments.EXAMPLES[name]}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    getattr(arguments, name)(parser)
    args = parser.parse_args(words)
    require(name, *optional_packages(name, args))
    code: int = importlib.import_module(f"{folder}.{name}").run(args)
    return code


def _say(error: HandctlError | str, code: Exit) -> int:
    with suppress(OSError):  # the code tells, too
        print(f"handctl: {message(str(error))}", file=sys.stderr)
    return code
