"""Reading a hand: packaged or from a file, each section validated, then the whole checked."""

import tomllib
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.file.checks import check_hand
from handctl.hand.file.messages import config_error, shown

SCHEMA = 1
"""Version of the hand file's format that is read here."""
HANDS = Path(__file__).parent / "hands"
"""Where the packaged hand files are."""


def packaged_hands() -> tuple[str, ...]:
    """Names of the hands that come with handctl."""
    return tuple(sorted(path.stem for path in HANDS.glob("*.toml")))


def load_hand(name_or_path: str | Path) -> Hand:
    """Read a hand.

    Args:
        name_or_path: name of a packaged hand, or the path of a hand file.

    Raises:
        ConfigError: it cannot be found, read or used; the line names file, key path, value and what would be right.
    """
    path = hand_path(name_or_path)
    return hand_from(read_toml(path), str(path))


def hand_path(name_or_path: str | Path) -> Path:
    """Path of a hand file by packaged name or path.

    Raises:
        ConfigError: neither a packaged hand nor a file.
    """
    names = packaged_hands()
    if name_or_path in names:
        return HANDS / f"{name_or_path}.toml"
    path = Path(name_or_path)
    if not path.is_file():
        near = get_close_matches(str(name_or_path), names, n=1)
        raise ConfigError("no such hand or file", str(path), (f"{near[0]}? or " if near else "") + _choice(names))
    return path


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file.

    Raises:
        ConfigError: it cannot be read or is not TOML.
    """
    try:
        if path.exists() and not path.is_file():
            raise ConfigError("not a file", str(path), "a TOML file")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", str(path), "a readable file") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"byte {error.start} is not UTF-8", str(path), "a UTF-8 text file") from None
    return parse_toml(text, str(path))


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Parse TOML, from a file, a log or the command line.

    Args:
        text: what is parsed.
        source: what to call it in messages.

    Raises:
        ConfigError: it is not TOML, or a whole number has more than the 64 bits that TOML guarantees.
    """
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"not TOML: {error}", source, "valid TOML") from None
    _check_whole_numbers(content, source)
    return content


def _check_whole_numbers(content: dict[str, Any], source: str) -> None:
    """Refuse whole numbers that do not fit into 64 bits: a long one cannot even be printed."""
    nodes: list[tuple[str, Any]] = list(content.items())
    while nodes:
        key, node = nodes.pop()
        if isinstance(node, dict):
            nodes += node.items()
        elif isinstance(node, list):
            nodes += [(key, one) for one in node]
        elif isinstance(node, int) and node.bit_length() > 63:
            what = f"a whole number of {node.bit_length()} bits"
            raise ConfigError(what, f"{source}: {key}", f"at most {2**63 - 1} in magnitude")


def hand_from(content: Mapping[str, Any], source: str) -> Hand:
    """Validate content that was read, or put together from several layers.

    Args:
        content: as parsed from TOML.
        source: what to call it in messages.

    Raises:
        ConfigError: as ``load_hand``.
    """
    version = content.get("schema", SCHEMA)
    if isinstance(version, bool) or version != SCHEMA:
        raise ConfigError(shown(version), f"{source}: schema", f"{SCHEMA}, the version that this handctl reads")
    try:
        hand = Hand.model_validate(content)
    except ValidationError as error:
        raise config_error(error, Hand, content, source) from None
    check_hand(hand, source)
    return hand


def _choice(names: tuple[str, ...]) -> str:
    return "one of " + ", ".join(names) + ", or the path of a hand file"
