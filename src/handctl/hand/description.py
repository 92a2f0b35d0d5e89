"""The description of a hand: one TOML file, validated and frozen, and what follows from it directly."""

import hashlib
import json
import tomllib
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, ValidationError

from handctl.errors import ConfigError
from handctl.hand import quantities as qty
from handctl.hand.checks import check_hand
from handctl.hand.messages import config_error, shown
from handctl.hand.sections import Bus, Digit, Motor, Mount, Section, SensorNode, Tendon
from handctl.hand.toml_text import toml_text

SCHEMA = 1
"""Version of the hand file's format that is read here."""
HANDS = Path(__file__).parent / "hands"
"""Where the packaged hand files are."""


RATING = "joint_rated_torque_N_m"
"""Key of a digit that its content has only where the file gives it."""


class Hand(Section):
    """A hand as its file says it; lists are in file order, tendons digit by digit."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_by_name=False)

    schema_: qty.SchemaNumber = Field(alias="schema")
    name: qty.Name
    description: qty.Text
    mount: Mount
    bus: tuple[Bus, ...] = Field(min_length=1)
    sensor_node: SensorNode
    digit: tuple[Digit, ...] = Field(min_length=1)
    tendon: tuple[Tendon, ...] = Field(min_length=1)
    motor: tuple[Motor, ...] = Field(min_length=1)

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Joint names, digit by digit from the palm outwards: ``index_j1``, ``index_j2``, .."""
        return tuple(joint for digit in self.digit for joint in digit.joints)

    @cached_property
    def digit_names(self) -> tuple[str, ...]:
        """Digit names."""
        return tuple(digit.name for digit in self.digit)

    @cached_property
    def tendon_names(self) -> tuple[str, ...]:
        """Tendon names."""
        return tuple(tendon.name for tendon in self.tendon)

    @cached_property
    def motor_names(self) -> tuple[str, ...]:
        """Motor names."""
        return tuple(motor.name for motor in self.motor)

    @cached_property
    def bus_names(self) -> tuple[str, ...]:
        """Bus names."""
        return tuple(bus.name for bus in self.bus)

    @cached_property
    def moment_arms(self) -> NDArray[np.float64]:
        """R, (N, J) [m], read-only: excursion is R q, joint torque R^T f."""
        arms = np.array([[tendon.moment_arm_m.get(joint, 0.0) for joint in self.joints] for tendon in self.tendon])
        arms.setflags(write=False)
        return arms

    @cached_property
    def digit_joints(self) -> dict[str, slice]:
        """Of each digit, where its joints are among ``joints``."""
        return dict(zip(self.digit_names, _slices([len(digit.joints) for digit in self.digit]), strict=True))

    @cached_property
    def digit_tendons(self) -> dict[str, slice]:
        """Of each digit, where its tendons are among ``tendon``."""
        crossed = [set(tendon.moment_arm_m) for tendon in self.tendon]
        counts = [sum(not joints.isdisjoint(digit.joints) for joints in crossed) for digit in self.digit]
        return dict(zip(self.digit_names, _slices(counts), strict=True))

    @cached_property
    def motor_index(self) -> tuple[int, ...]:
        """Of each tendon, the index of its motor."""
        return tuple(self.motor_names.index(tendon.motor) for tendon in self.tendon)

    def motor_of(self, tendon: str) -> Motor:
        """Motor of a tendon, by the tendon's name."""
        return self.motor[self.motor_index[self.tendon_names.index(tendon)]]

    def digit_named(self, name: str) -> Digit:
        """Digit by name."""
        return self.digit[self.digit_names.index(name)]

    @cached_property
    def content(self) -> dict[str, Any]:
        """Resolved content as plain values, defaults included, keys as in the file."""
        content = self.model_dump(by_alias=True, mode="python")
        for digit in content["digit"]:
            if digit[RATING] is None:  # a key that came later: hands without it keep their identity
                del digit[RATING]
        return content

    def to_toml(self) -> str:
        """Resolved content as TOML text, for the log; ``load_hand`` reads the same hand back from it."""
        return toml_text(self.content)

    @cached_property
    def identity(self) -> str:
        """SHA-256 of the resolved content in hexadecimal; the file's comments, spelling of numbers and order of keys
        do not count."""
        canonical = json.dumps(self.content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()


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


def _slices(counts: list[int]) -> list[slice]:
    """Consecutive slices of the given lengths."""
    return [slice(end - count, end) for count, end in zip(counts, accumulate(counts), strict=True)]
