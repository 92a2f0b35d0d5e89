"""Parser of command lines.

Each error message of the parser is a single line with a suggested correction. Each help text ends
with an example. Error messages of argparse can contain words from the command line. The parser
escapes and shortens the messages of argparse before it prints them.
"""

import argparse
import re
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, NoReturn

from handctl.cli.parsing.renamed_options import new_option_name
from handctl.errors import ConfigError
from handctl.printing import MAX_WORD_CHARACTERS, printable_text, similar_name

DOUBLE_DASH_AS_VALUE = re.compile(r"(--?[^=]+)=--")
"""Pattern for an option with the value ``--``. argparse would remove this value and fail without a message."""
INVALID_CHOICE = re.compile(
    r"invalid choice: '(?P<word>.*)' \(choose from (?P<choices>.*)\)", re.DOTALL
)
"""Pattern of the message that argparse gives for a word that is not among the allowed choices."""

SIMULATED_HAND = "handctl sim --hand jamia --bus local:demo"
RUN_COMMAND_EXAMPLE = "handctl run --hand jamia --bus local:demo"


class CommandExample(NamedTuple):
    """Example of a command line for a help text. A user can copy the example into a shell.

    Attributes:
        command_line: the command line of the example.
        parallel_commands: commands that must run in other terminals at the same time.
    """

    command_line: str
    parallel_commands: tuple[str, ...] = ()

    def help_epilog(self) -> str:
        """Return the last lines of a help text, which contain the example.

        The last line of the text is the command line of the example.
        """
        parallel_text = (
            ["in other terminals:", *(f"  {command}" for command in self.parallel_commands)]
            if self.parallel_commands
            else []
        )
        return "\n".join([*parallel_text, "example:", f"  {self.command_line}"])


class HelpFormatter(argparse.HelpFormatter):
    """Formatter of help texts.

    The formatter wraps paragraphs to the width of the terminal, and leaves indented lines
    unchanged.
    """

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        lines = (
            line if line.startswith(" ") else textwrap.fill(line, width)
            for line in text.splitlines()
        )
        return "\n".join(lines)


class VerbParser(argparse.ArgumentParser):
    """Argument parser that has the options of every command.

    Parsers of subcommands are also of the class VerbParser.
    """

    def __init__(self, **keywords: Any) -> None:
        """Create a parser with ``--verbose`` and ``--quiet``.

        The keyword arguments are the same as those of ``ArgumentParser``.
        """
        super().__init__(**{"formatter_class": HelpFormatter} | keywords)
        # The options ``--verbose`` and ``--quiet`` have no default value. With a default value, the
        # parser of a subcommand would reset an option that the user has written before the
        # subcommand.
        verbosity_group = self.add_mutually_exclusive_group()
        add_argument = verbosity_group.add_argument
        text = "print more detail on standard error"
        add_argument("-v", "--verbose", action="store_true", default=argparse.SUPPRESS, help=text)
        add_argument(
            "-q",
            "--quiet",
            action="store_true",
            default=argparse.SUPPRESS,
            help="print only results and errors",
        )
        self._has_sub_verbs = False

    def add_subparsers(self, **keywords: Any) -> Any:
        """Add subcommands to this parser.

        The options of a subcommand are known only to the parser of this subcommand.
        """
        self._has_sub_verbs = True
        return super().add_subparsers(**keywords)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse a command line.

        If an option is unknown or was renamed, raise an error that suggests the right option.

        Raises:
            ConfigError: an option is unknown or was renamed.
        """
        for word in _option_names(args or ()):
            if new_word := new_option_name(self._verb_names(), word):
                raise ConfigError(f"{word} has been renamed", self._verb_names(), new_word)
            # The check for unknown options comes before all other checks. With another order,
            # argparse would report a missing argument when the user misspells the name of an
            # argument.
            if not (
                self._has_sub_verbs
                or any(option.startswith(word) for option in self._option_string_actions)
            ):
                self._raise_unknown_argument(word)
        parsed, unparsed_words = super().parse_known_args(args, namespace)
        if unparsed_words:
            self._raise_unknown_argument(unparsed_words[0])
        return parsed, unparsed_words

    def _raise_unknown_argument(self, word: str) -> NoReturn:
        """Raise an error for a word of the command line that belongs to no argument."""
        option = word.partition("=")[0]
        kind = "option" if word.startswith("-") else "argument"
        suggestion = did_you_mean(option, self._option_string_actions) if kind == "option" else ""
        raise ConfigError(
            f"unknown {kind} {_quote_word(option)}{suggestion}",
            self._error_location(),
            self._list_choices(),
        )

    def error(self, message: str) -> NoReturn:
        """Raise an error about the command line, with a message of one line.

        Raises:
            ConfigError: always.
        """
        if match := INVALID_CHOICE.search(message):
            suggestion = did_you_mean(match["word"], re.findall(r"[\w.-]+", match["choices"]))
            raise ConfigError(message + suggestion, self._error_location())
        names_expected = "expected" in message
        raise ConfigError(
            message,
            self._error_location(),
            "" if names_expected else f"the arguments that {self.prog} --help lists",
        )

    def _verb_names(self) -> str:
        """Return the names of the command and of the subcommand."""
        return self.prog.removeprefix("handctl").strip()

    def _error_location(self) -> str:
        return self._verb_names() or "the command line"

    def _list_choices(self) -> str:
        return f"one that {self.prog} --help lists"


def _option_names(words: Iterable[str]) -> Iterable[str]:
    """Yield the names of all options in a command line that come before the word ``--``."""
    for word in words:
        if word == "--":
            return
        if word.startswith("--"):
            yield word.partition("=")[0]


def _quote_word(word: str) -> str:
    return repr(printable_text(word, MAX_WORD_CHARACTERS))


def did_you_mean(unknown_word: str, known_words: Iterable[str]) -> str:
    """Return the text ``, did you mean NAME?``, where NAME is the known name that is most similar to an unknown word.

    If no known name is similar enough, the returned text is empty.
    """
    similar_word = similar_name(unknown_word, known_words)
    return f", did you mean {similar_word}?" if similar_word else ""


def add_sub_verb(
    sub_verbs: "argparse._SubParsersAction[VerbParser]",
    name: str,
    text: str,
    example: CommandExample,
) -> "VerbParser":
    """Add the parser of a subcommand, and return this parser.

    Args:
        sub_verbs: parsers of the subcommands of the command.
        name: name of the subcommand.
        text: one line of help, which starts with a small letter and has no full stop.
        example: example command line for the end of the help.
    """
    description = f"{text[0].upper()}{text[1:]}."
    return sub_verbs.add_parser(
        name, help=text, description=description, epilog=example.help_epilog()
    )


def check_command_line(words: Sequence[str]) -> None:
    """Raise an error if a command line contains words that no command can use.

    Raises:
        ConfigError: a word contains NUL or a line end, or the value of an option is ``--``.
    """
    for mark, name in (("\0", "a NUL"), ("\n", "a line end")):
        for word in words:
            if mark in word:
                problem_text = f"a word with {name} in it: {printable_text(word)}"
                raise ConfigError(problem_text, "the command line", "words without it")
    for word in words:
        if match := DOUBLE_DASH_AS_VALUE.fullmatch(word):
            raise ConfigError("-- is no value", match[1], "a value")
