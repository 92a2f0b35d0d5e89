"""Generate the blocks about the command line from the parsers of the commands and from the exit codes."""

import argparse
from collections.abc import Iterator
from typing import Any

from handctl.cli.main import VERB_GROUPS, VERB_HELP, verb_parser
from handctl.session.exit_codes import ExitCode
from tools.reference.markdown import (
    attribute_docstrings,
    markdown_table,
    prose_markdown,
    quoted_code,
)

COMMON_OPTIONS = {"-h", "-v", "-q"}
"""Options that every command has. The page explains these options only once."""


def verb_table() -> str:
    """Return a table of all commands, with one line for each."""
    return markdown_table(
        ("verb", "purpose"), ((quoted_code(name), text) for name, text in VERB_HELP.items())
    )


def verb_sections() -> str:
    """Return a section for each command and each sub-command.

    A section has the purpose of the command, its arguments and an example.
    """
    sections = []
    for group in VERB_GROUPS.values():
        sections.append(f"## {group.title[0].upper()}{group.title[1:]}")
        for name in group.verbs:
            sections += _command_sections(verb_parser(name), f"handctl {name}", "###")
    return "\n\n".join(sections)


def _command_sections(parser: argparse.ArgumentParser, command: str, level: str) -> Iterator[str]:
    """Yield the section of a command, and a section for each of its sub-commands."""
    yield f"{level} {command}"
    yield prose_markdown(parser.description)
    rows = [_argument_row(action) for action in parser._actions if _is_listed(action)]
    if rows:
        yield markdown_table(("argument", "meaning"), rows)
    subs = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    example = (parser.epilog or "").strip()
    if example and not subs:
        yield f"```text\n{example}\n```"
    for sub in subs:
        for name, below in sub.choices.items():
            yield from _command_sections(below, f"{command} {name}", "####")


def _is_listed(action: argparse.Action) -> bool:
    """Return True if the section of a command must list this argument."""
    if isinstance(action, argparse._SubParsersAction) or action.help == argparse.SUPPRESS:
        return False
    return not COMMON_OPTIONS.intersection(action.option_strings)


def _argument_row(action: argparse.Action) -> tuple[str, str]:
    """Return the name and the meaning of a command-line argument."""
    value = _value_placeholder(action)
    names = ", ".join(action.option_strings)
    name = f"{names} {value}".strip() if names else value
    text = prose_markdown(action.help)
    substitutions: dict[str, Any] = {"default": action.default, "prog": "handctl"}
    text = text % substitutions if "%(" in text else text.replace("%%", "%")
    required = "required" if names and action.required else ""
    return quoted_code(name), "; ".join(filter(None, (text, required)))


def _value_placeholder(action: argparse.Action) -> str:
    """Return the placeholder for the value of an argument, or an empty text for an option without a value."""
    if action.nargs == 0:
        return ""
    if action.metavar is not None:
        words = (action.metavar,) if isinstance(action.metavar, str) else action.metavar
        value = " ".join(words)
    elif action.choices:
        value = "{" + ",".join(map(str, action.choices)) + "}"
    else:
        value = action.dest.upper()
    return (
        f"[{value}]"
        if action.nargs == "?"
        else f"{value} ..."
        if action.nargs in ("*", "+")
        else value
    )


def exit_codes() -> str:
    """Return a table of the exit codes."""
    meanings = attribute_docstrings(ExitCode) | {"DONE": "The verb has done its work."}
    rows = ((int(exit_), quoted_code(exit_.name), meanings[exit_.name]) for exit_ in ExitCode)
    return markdown_table(("code", "name", "meaning"), rows)
