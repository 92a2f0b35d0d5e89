"""Loading of packaged hands and hand files.

Each section of a hand file is first validated separately. Then the sections are checked against
each other.
"""

import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import ValidationError

from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.file.checks import check_hand, check_sections
from handctl.hand.file.error_text import (
    FileMistake,
    group_mistakes,
    toml_spelling,
    validation_mistakes,
    with_paths_in_hand_file,
)
from handctl.hand.file.section_models import Digit, Section, Tendon
from handctl.hand.file.sensor_checks import missing_node_keys
from handctl.hand.file.templates import (
    SCHEMA_WITH_TEMPLATES,
    SCHEMA_WITHOUT_TEMPLATES,
    KeyPathOrigins,
    join_missing_key_mistakes,
    resolve_templates,
)
from handctl.printing import similar_name

READABLE_SCHEMAS = (SCHEMA_WITHOUT_TEMPLATES, SCHEMA_WITH_TEMPLATES)
"""Schema numbers of the hand files that this version of handctl reads."""
PACKAGED_HANDS_FOLDER = Path(__file__).parent / "hands"
"""Folder of the packaged hand files."""
SINGLE_BRACKET_PATTERN = re.compile(r"\s*\[(digit|tendon|motor|bus)\]\s*(#.*)?$")
"""Line that begins a table, where a hand file needs an entry of a list of tables."""
ValidatedSection = TypeVar("ValidatedSection", bound=Section)


def packaged_hands() -> tuple[str, ...]:
    """Return the names of the packaged hands."""
    return tuple(sorted(path.stem for path in PACKAGED_HANDS_FOLDER.glob("*.toml")))


def load_hand(name_or_path: str | Path) -> Hand:
    """Load a packaged hand or a hand file.

    Args:
        name_or_path: name of a packaged hand, or path of a hand file.

    Raises:
        ConfigError: the hand is missing, unreadable, or invalid. The error message contains the
            file, the key path, the value, and a valid value.
    """
    path = hand_path(name_or_path)
    return hand_from_content(read_toml(path), str(path))


def hand_path(name_or_path: str | Path) -> Path:
    """Return the path of a hand file, given the name of a packaged hand or a path.

    Raises:
        ConfigError: the argument is neither the name of a packaged hand nor the path of a file.
    """
    names = packaged_hands()
    if name_or_path in names:
        return PACKAGED_HANDS_FOLDER / f"{name_or_path}.toml"
    path = Path(name_or_path)
    if not path.is_file():
        similar_word = similar_name(str(name_or_path), names)
        raise ConfigError(
            "no such hand or file",
            str(path),
            (f"{similar_word}? or " if similar_word else "") + _valid_names_text(names),
        )
    return path


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file.

    Raises:
        ConfigError: the file is unreadable, or its content is not TOML.
    """
    try:
        if path.exists() and not path.is_file():
            raise ConfigError("not a file", str(path), "a TOML file")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(
            f"cannot be read: {error.strerror}", str(path), "a readable file"
        ) from None
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"byte {error.start} is not UTF-8", str(path), "a UTF-8 text file"
        ) from None
    return parse_toml(text, str(path))


def parse_toml(text: str, source_name: str) -> dict[str, Any]:
    """Parse TOML text from a file, a log, or the command line.

    Args:
        text: TOML text.
        source_name: name of the source of the text, for error messages.

    Raises:
        ConfigError: the text is not TOML, or contains an integer that does not fit into 64 bits.
    """
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise _single_bracket_error(text, source_name) or ConfigError(
            f"not TOML: {error}", source_name, "valid TOML"
        ) from None
    _check_whole_numbers(content, source_name)
    return content


def _single_bracket_error(text: str, source_name: str) -> ConfigError | None:
    """Return an error about the first line with single brackets, such as ``[digit]`` instead of ``[[digit]]``.

    If a file contains both ``[digit]`` and ``[[digit]]``, the TOML parser itself reports a line
    that is not the line with the mistake.
    """
    for number, line in enumerate(text.splitlines(), 1):
        section = SINGLE_BRACKET_PATTERN.match(line)
        if section:
            return ConfigError(f"line {number}: [{section[1]}]", source_name, f"[[{section[1]}]]")
    return None


def _check_whole_numbers(content: dict[str, Any], source_name: str) -> None:
    """Refuse integers of more than 64 bits.

    Python cannot print very long integers, so an error message could not contain the value.
    """
    # The function uses a list instead of recursion, because deeply nested content would exceed
    # Python's recursion limit.
    nodes: list[tuple[str, Any]] = list(content.items())
    while nodes:
        key, node = nodes.pop()
        if isinstance(node, dict):
            nodes += node.items()
        elif isinstance(node, list):
            nodes += [(key, subnode) for subnode in node]
        elif isinstance(node, int) and node.bit_length() > 63:
            problem_text = f"a whole number of {node.bit_length()} bits"
            raise ConfigError(
                problem_text, f"{source_name}: {key}", f"at most {2**63 - 1} in magnitude"
            )


def hand_from_content(content: Mapping[str, Any], source_name: str) -> Hand:
    """Validate the parsed content of a hand file, and return the hand.

    Args:
        content: content as parsed from TOML, possibly merged from several sources.
        source_name: name of the source of the content, for error messages.

    Raises:
        ConfigError: the hand is invalid, see ``load_hand``.
    """
    hand, mistakes = validate_content(content)
    if hand is None:
        raise mistakes[0].error(source_name)
    return hand


def hand_content(name_or_path: str | Path) -> dict[str, Any]:
    """Return the content of a hand file, with defaults and templates replaced by values.

    The function does not check that the content describes a valid hand.

    Raises:
        ConfigError: the file is missing, unreadable, or not TOML.
    """
    return resolve_templates(read_toml(hand_path(name_or_path))).content


def validate_content(content: Mapping[str, Any]) -> tuple[Hand | None, list[FileMistake]]:
    """Validate the parsed content of a hand file, and find all mistakes in the content.

    Returns:
        The hand and an empty tuple of mistakes, or None and at least one mistake.
    """
    if not content:
        expected = (
            f"schema = {SCHEMA_WITH_TEMPLATES} and the sections of a hand; "
            "handctl config init writes them from a few answers"
        )
        return None, [FileMistake("the file is empty", "schema", expected)]
    version = content.get("schema", SCHEMA_WITHOUT_TEMPLATES)
    if isinstance(version, bool) or version not in READABLE_SCHEMAS:
        return None, [
            FileMistake(
                toml_spelling(version),
                "schema",
                f"{SCHEMA_WITHOUT_TEMPLATES} or {SCHEMA_WITH_TEMPLATES}, versions that this handctl reads",
            )
        ]
    resolved_content = resolve_templates(content)
    mistakes = list(resolved_content.mistakes)
    hand = None
    try:
        hand = Hand.model_validate(resolved_content.content)
    except ValidationError as error:
        hand_mistakes = validation_mistakes(error, Hand, resolved_content.content)
        if content.get("schema") == SCHEMA_WITH_TEMPLATES:
            hand_mistakes = join_missing_key_mistakes(hand_mistakes, resolved_content.content)
        digits = _valid_sections(resolved_content.content, "digit", Digit)
        hand_mistakes += check_sections(
            digits, _valid_sections(resolved_content.content, "tendon", Tendon)
        )
        hand_mistakes += missing_node_keys(resolved_content.content.get("sensor_node"))
    else:
        # The whole hand is checked only if the templates have no mistakes, because a mistake in a
        # template would cause further mistakes wherever the template is used.
        hand_mistakes = [] if mistakes else list(check_hand(hand))
    mistakes += with_paths_in_hand_file(hand_mistakes, resolved_content.origins)
    return (None, mistakes) if mistakes else (hand, [])


class HandInspection(NamedTuple):
    """Result of the inspection of a hand file.

    Attributes:
        hand: the hand, or None if the content of the file is not valid.
        mistakes: all mistakes that the user must correct before a run. Even a valid hand can have
            mistakes that prevent a run.
        origins: key path of each value in the hand file, by the key path of the value in the
            resolved content.
    """

    hand: Hand | None
    mistakes: list[FileMistake]
    origins: KeyPathOrigins


def inspect_hand_content(content: Mapping[str, Any]) -> HandInspection:
    """Validate the parsed content of a hand file, and find all mistakes that prevent the use of the hand."""
    hand, mistakes = validate_content(content)
    origins = (
        resolve_templates(content).origins if content.get("schema") == SCHEMA_WITH_TEMPLATES else {}
    )
    if hand is not None:
        # The import is inside the function, because ``readiness_checks`` imports numba. The import
        # of numba takes long, and loading a hand does not need numba.
        from handctl.hand.readiness_checks import reasons_not_ready

        mistakes = with_paths_in_hand_file(reasons_not_ready(hand), origins)
    return HandInspection(hand, group_mistakes(mistakes), origins)


def _valid_sections(
    content: Mapping[str, Any], section_kind: str, model: type[ValidatedSection]
) -> Iterator[ValidatedSection]:
    """Yield the sections of a kind that are valid when each section is checked separately."""
    sections = content.get(section_kind)
    for section in sections if isinstance(sections, list | tuple) else ():
        with suppress(ValidationError):
            yield model.model_validate(section)


def _valid_names_text(hand_names: tuple[str, ...]) -> str:
    """Return a text for messages, with the names of all packaged hands."""
    return "one of " + ", ".join(hand_names) + ", or the path of a hand file"
