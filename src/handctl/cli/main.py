# PYTHON_ARGCOMPLETE_OK: for completions, a shell with global completion calls only programs that
# contain this mark
"""Entry point of the command line, and the table of all commands.

In this module, the word *verb* means the name of a command, such as ``run``.

The module ``arguments`` of a folder declares the arguments of all commands in the folder. The code
of a command is in the module with the name of the command.

To print a help text, or an error in the arguments, handctl imports only the module ``arguments``.
Because few modules are imported, help texts and errors appear fast.
"""

import errno
import gc
import importlib
import os
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import Any, NamedTuple

from handctl.blas_kernels import configure_openblas
from handctl.cli.console.process_termination import (
    TerminationRequested,
    install_excepthook,
    terminate_on_signals,
)
from handctl.cli.console.standard_streams import (
    discard_output,
    flush_stdout,
    has_printed_json,
    open_standard_streams,
)
from handctl.cli.console.verbosity import apply_verbosity, is_verbose, print_detail
from handctl.cli.parsing.completion import is_shell_completion, print_completions
from handctl.cli.parsing.optional_packages import optional_packages
from handctl.cli.parsing.parser import VerbParser, check_command_line, did_you_mean
from handctl.errors import (
    ConfigError,
    HandctlError,
    IncomparableError,
    LogError,
    NoSimulatorError,
    PowerError,
)
from handctl.extras import missing_extra, require_extra
from handctl.printing import escaped_streams, one_line_message, printable_text
from handctl.session.exit_codes import ExitCode

ERROR_EXIT_CODES: tuple[tuple[type[BaseException], ExitCode, str], ...] = (
    (IncomparableError, ExitCode.NOT_COMPARABLE, ""),
    (ConfigError, ExitCode.BAD_INPUT, ""),
    (LogError, ExitCode.BAD_INPUT, ""),
    (PowerError, ExitCode.REMOVE_POWER, ""),
    (HandctlError, ExitCode.FAILED, ""),
    (TerminationRequested, ExitCode.TERMINATED, "ended by a signal"),
    (KeyboardInterrupt, ExitCode.INTERRUPTED, "interrupted"),
)
"""Exit code of each kind of error, and the text of an error without a message.

The first kind in the list that matches an error is used, so a base class must come after its
subclasses.
"""


class VerbGroup(NamedTuple):
    """Group of commands with the same purpose.

    Attributes:
        title: common purpose of the commands, printed as a heading in the help text.
        verbs: one line of help for each command, by the name of the command.
    """

    title: str
    verbs: dict[str, str]


VERB_GROUPS = {
    "runs": VerbGroup(
        "run a hand, real or simulated",
        {
            "demo": "close a simulated hand on an object, and print a summary",
            "run": "run a task on a hand",
            "stop": "relax and disarm a running hand",
            "clear": "clear latched faults of a running hand",
            "commission": "tare the load cells, zero the motors, and check the sign of each tendon",
            "jog": "move one digit by tension or angle",
            "sim": "start a simulated hand on a bus",
        },
    ),
    "logs": VerbGroup(
        "use the log of a run",
        {
            "view": "show a log in Rerun, or draw a picture of it",
            "replay": "repeat a log in the controller, on the hand, or with other limits",
            "log": "describe, check, compare, recover or export a log",
            "report": "write one self-contained HTML page of a run",
        },
    ),
    "checks": VerbGroup(
        "check a hand, its buses and this machine",
        {
            "config": "show or check a hand and its files",
            "bus": "plan the load of the buses of a hand, check buses, or watch the readings on them",
            "scan": "find the drives on a bus without motion",
            "conformance": "check that a real drive behaves as handctl requires",
            "doctor": "check this machine: priority, buses, viewer, disk space",
        },
    ),
    "tuning": VerbGroup(
        "identify and tune a hand",
        {
            "identify": "measure stiffness, friction, springs and inertia of a hand",
            "gains": "show, compare, apply, roll back or change gains",
            "tune": "design gains, search them in simulation, verify them on the hand",
        },
    ),
    "studies": VerbGroup(
        "inject faults, reproduce the paper",
        {
            "fault": "inject single faults into a simulated hand, or run the whole fault campaign",
            "paper": "reproduce the source paper and list its errors",
        },
    ),
}
"""Groups of commands, by the folder that contains the modules of the group."""
VERB_HELP = {name: text for group in VERB_GROUPS.values() for name, text in group.verbs.items()}
"""One line of help for each command, by the name of the command."""
VERBS_BY_FOLDER = {folder: tuple(group.verbs) for folder, group in VERB_GROUPS.items()}
"""Names of the commands in each group, by the folder that contains the modules of the group."""
RECORDING_VERBS = ("run", "commission", "demo")
"""Commands that record a run, unless ``--dry-run`` is given."""
VERBOSITY_OPTIONS = {"-v", "--verbose", "-q", "--quiet"}
"""Options that are allowed both before and after the name of the command."""

HELP_EPILOG = """exit codes:
  0 done, 1 failed, 2 bad input, 3 lossy log, 4 not comparable, 5 not checked,
  70 internal error, 71 remove power, 130 interrupted, 143 terminated (where no hand ran)
help on a verb:
  handctl VERB --help
completion in a shell:
  eval "$(register-python-argcomplete handctl)"
example:
  handctl demo --lockstep"""

FILE_NAME_ERRNOS = {
    errno.ENOENT, errno.EEXIST, errno.ENOTDIR, errno.EISDIR, errno.ENOTEMPTY, errno.ENAMETOOLONG, errno.ELOOP,
}  # fmt: skip
"""Error numbers of file errors that a wrong file name causes.

All other file errors count as failures of the machine.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``handctl`` with a command line.

    If an error occurs, print a message with a single line, and return an exit code.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    if argv is None:
        if is_shell_completion():
            print_completions(parser_of_all_verbs())
        install_excepthook()
    configure_openblas()
    # handctl's models use no plugins of pydantic. A search for plugins reads the metadata of all
    # installed packages, which would make each command 20 ms slower.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    open_standard_streams()
    with escaped_streams():
        return _run_and_report_errors(words)


def _run_and_report_errors(command_words: list[str]) -> int:
    """Run a command line. If there is an error, print the error. Return the exit code.

    With ``--json``, an error is also printed as JSON.
    """
    token = has_printed_json.set(False)
    try:
        with terminate_on_signals():
            check_command_line(command_words)
            code = _run_command_line(command_words)
            flush_stdout()
            return code
    except BrokenPipeError:
        discard_output()
        return ExitCode.DONE
    except (HandctlError, OSError, TerminationRequested, KeyboardInterrupt) as error:
        if isinstance(error, PowerError) and error.__cause__:
            # the error is caused by a bug in handctl
            traceback.print_exception(error.__cause__)
        text, exit_code = _error_text_and_exit_code(error)
        # even if a stream cannot be written, the exit code reports the error
        with suppress(OSError):
            print(f"handctl: {one_line_message(text)}", file=sys.stderr)
        with suppress(OSError):
            _print_json_error(command_words, text, exit_code)
        return exit_code
    finally:
        has_printed_json.reset(token)


def _print_json_error(command_words: Sequence[str], text: str, exit_code: ExitCode) -> None:
    """Print an error as JSON, if the command line contains ``--json``.

    If the command has already printed JSON, nothing is printed, because standard output contains a
    single JSON value for each command.
    """
    if "--json" not in command_words or has_printed_json.get():
        return
    # This import loads pydantic, which a help text does not need.
    from handctl.cli.console.options import print_json

    print_json({"error": text, "exit_code": exit_code})
    sys.stdout.flush()


def _error_text_and_exit_code(error: BaseException) -> tuple[str, ExitCode]:
    """Return the message of an error, and the exit code of a command that ends with the error."""
    if isinstance(error, OSError):
        has_no_file_name = (
            "the working folder: " if error.errno == errno.ENOENT else ""
        )  # the current folder was deleted
        location = f"{error.filename}: " if error.filename else has_no_file_name
        is_bad_name = error.errno in FILE_NAME_ERRNOS
        return (
            f"{location}{error.strerror or error}",
            ExitCode.BAD_INPUT if is_bad_name else ExitCode.FAILED,
        )
    exit_code, default_text = next(
        (code, text) for kind, code, text in ERROR_EXIT_CODES if isinstance(error, kind)
    )
    return str(error) or default_text, exit_code


def _run_command_line(command_words: list[str]) -> int:
    """Run a command line, and return the exit code.

    The function does not catch the exceptions that the command raises.
    """
    while (
        command_words[1:]
        and command_words[0] in VERBOSITY_OPTIONS
        and command_words[1] in VERB_HELP.keys() | VERBOSITY_OPTIONS
    ):
        command_words = (
            [command_words[1], command_words[0], *command_words[2:]]
            if command_words[1] in VERB_HELP
            else command_words[1:]
        )
    if command_words and command_words[0] in VERB_HELP:
        return _run_verb(command_words[0], command_words[1:])
    parser = VerbParser(
        prog="handctl",
        usage="handctl VERB ... [--help]",
        description="Controller and data logger for tendon-driven robot hands.",
        epilog=f"{_verb_table()}{HELP_EPILOG}",
    )
    parser.add_argument("--version", action="store_true", help="print the version")
    if command_words and not command_words[0].startswith("-"):
        problem_text = f"unknown verb {printable_text(command_words[0])!r}{did_you_mean(command_words[0], VERB_HELP)}"
        raise ConfigError(problem_text, "the command line", "one that handctl --help lists")
    args = parser.parse_args(command_words)
    if args.version:
        print(_version_text())
        return ExitCode.DONE
    parser.print_help()
    return ExitCode.DONE


def _verb_table() -> str:
    """Return the part of the help text that lists the commands of each group."""
    lines: list[str] = []
    for group in VERB_GROUPS.values():
        lines.append(f"{group.title}:")
        lines += [*(f"  {name:<12}{text}" for name, text in group.verbs.items()), ""]
    return "\n".join([*lines, ""])


def _version_text() -> str:
    """Return the version of handctl."""
    from importlib.metadata import version

    return version("handctl")


def _folder_of_verb(name: str) -> str:
    """Return the folder that contains the module of a command."""
    return next(folder for folder, verbs in VERBS_BY_FOLDER.items() if name in verbs)


def _import_arguments(name: str) -> Any:
    """Import the module that declares the arguments of a command."""
    return importlib.import_module(f"handctl.cli.{_folder_of_verb(name)}.arguments")


def verb_parser(name: str) -> VerbParser:
    """Return the argument parser of a command."""
    text = VERB_HELP[name]
    example = _import_arguments(name).COMMAND_EXAMPLES[name]
    parser = VerbParser(
        prog=f"handctl {name}",
        description=f"{text[0].upper()}{text[1:]}.",
        epilog=example.help_epilog(),
    )
    getattr(_import_arguments(name), name)(parser)
    return parser


def parser_of_all_verbs() -> VerbParser:
    """Return one argument parser for all commands. Shell completion uses this parser."""
    parser = VerbParser(prog="handctl")
    parser.add_argument("--version", action="store_true")
    verbs = parser.add_subparsers()
    for name, text in VERB_HELP.items():
        getattr(_import_arguments(name), name)(verbs.add_parser(name, help=text))
    return parser


def _run_verb(name: str, command_words: list[str]) -> int:
    """Run one command, and return the exit code."""
    args = verb_parser(name).parse_args(command_words)
    with apply_verbosity(args):
        require_extra(name, *optional_packages(name, args))
        start_s = time.monotonic()
        if is_verbose():
            options = ", ".join(
                f"{key} = {value}" for key, value in sorted(vars(args).items()) if key != "verbose"
            )
            print_detail(f"handctl {_version_text()} {name}: {options}")
        try:
            with (
                _start_recorder_early()
                if name in RECORDING_VERBS and not args.dry_run
                else nullcontext()
            ):
                code: int = _import_verb(name).run(args)
        except NoSimulatorError as error:
            from handctl.cli.console.buses import (
                simulator_command,
            )  # this import loads pydantic, which a help text does not need

            raise NoSimulatorError(error.bus, error.reason, simulator_command(args)) from None
        except ModuleNotFoundError as error:
            if (missing_package := missing_extra(name, error)) is None:
                raise
            raise missing_package from None
        print_detail(
            f"handctl {name}: exit code {int(code)} after {time.monotonic() - start_s:.2f} s"
        )
    return code


def _start_recorder_early() -> AbstractContextManager[None]:
    """Start the recorder process early.

    While the recorder process imports its modules, this process imports the modules of the command.
    """
    from handctl.log.write.recorder_start import (
        prestarted_recorder_process,
    )  # a command that records no run does not need the module subprocess

    return prestarted_recorder_process()


def _import_verb(name: str) -> Any:
    """Import and return the module of a command."""
    module = f"handctl.cli.{_folder_of_verb(name)}.{name}"
    if module in sys.modules:
        return sys.modules[module]
    with _pause_garbage_collection():
        return importlib.import_module(module)


@contextmanager
def _pause_garbage_collection() -> Iterator[None]:
    """Disable garbage collection during a block that imports modules.

    Imports create many objects that are never freed. At the end of the block, ``gc.freeze``
    excludes these objects from later collections.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if enabled:
            gc.enable()
