"""Test that every command line in the documents has valid arguments.

The tests do not check arguments that are placeholders, such as N.
"""

import re
import shlex
from pathlib import Path

import pytest

from handctl.cli.main import VERB_HELP, verb_parser
from handctl.errors import ConfigError

REPOSITORY_ROOT = Path(__file__).parents[2]
DOCUMENTS = [REPOSITORY_ROOT / "README.md", *sorted((REPOSITORY_ROOT / "docs").rglob("*.md"))]
FENCE_PATTERN = re.compile(r"^ *```.*?^ *```$", re.MULTILINE | re.DOTALL)


def commands_in_text(text: str) -> list[list[str]]:
    """Return the words of each handctl command in a document.

    The result has no command lines that contain placeholders or redirections.
    """
    lines = re.findall(r"`handctl ([^`\n]+)`", text)
    for block in FENCE_PATTERN.findall(text):
        lines += re.findall(r"^ *(?:sudo )?handctl ([^\n#;&|]+)$", block, re.MULTILINE)
    plain_lines = [line for line in lines if not re.search(r"[<>\[\]]|\.\.\.", line)]
    return [words for words in map(shlex.split, plain_lines) if words[0] in VERB_HELP]


@pytest.mark.parametrize(
    "path", DOCUMENTS, ids=lambda path: path.relative_to(REPOSITORY_ROOT).as_posix()
)
def test_every_argument_is_known(path: Path) -> None:
    refusal_texts = [
        parser_refusal(words) for words in commands_in_text(path.read_text(encoding="utf-8"))
    ]
    assert [text for text in refusal_texts if "unknown" in text] == []


def parser_refusal(words: list[str]) -> str:
    """Parse a command line.

    Return the error text of the parser, which is empty if the arguments are valid.
    """
    try:
        verb_parser(words[0]).parse_args(words[1:])
    except ConfigError as error:
        return f"handctl {' '.join(words)}: {error}"
    except SystemExit:  # --help ends the parser
        pass
    return ""


def test_a_wrong_argument_is_unknown() -> None:
    ((verb, *words),) = commands_in_text("`handctl log info move.mcap move.log`")
    with pytest.raises(ConfigError, match="unknown argument"):
        verb_parser(verb).parse_args(words)
