"""Header of a run's log, with all data of the run that are known before the first tick."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Self

from handctl.errors import LogError
from handctl.hand.file.quantity_types import NAME_PATTERN
from handctl.printing import escape_surrogates

TRUTH_OFFSET_KEY = "truth_offset_ns"
"""Metadata key of the simulator's time at t = 0 of a lockstep run [ns].

The simulator's time at the start of the run is not 0 if the hand was commissioned before the run.
"""
PERIOD_RANGE_NS = (10_000, 10_000_000_000)
"""Shortest and longest accepted tick period in a log [ns]."""
MAX_LOG_TIME_NS = 1 << 62
"""Latest accepted time in a log [ns].

The sum of two accepted times fits into 64 bits. As a UNIX time, the limit lies in the year 2116.
"""
NAME_LIST_KEYS = ("joints", "tendons", "motors", "digits", "buses")
"""Keys of those header values that are lists of names."""
MAX_NAMES_PER_LIST = 1000
"""Largest number of names in one list of a header."""


@dataclass(frozen=True, slots=True)
class RunHeader:
    """Header of a run's log.

    The header is the first part of the log file. Because the header comes first, every log has a
    header, even if the run ends with a crash.

    Attributes:
        hand_toml: the hand description with all defaults applied.
        joints, tendons, motors, digits, buses: names of the joints, tendons, motors, digits and
            buses of the hand, in the order of the hand file.
        period_ns: control period of the run [ns].
        offset_ns: UNIX time when the time of the run is 0 [ns]. The value is 0 for a run in
            lockstep.
        metadata: content of the metadata record `handctl`: version, bus, seed, note of the
            operator, and more.
        gains: gains at the start of the run, by name. The metadata record `handctl.gains` and the
            first parameter event of the log contain these gains.
        attachments: content of the files that are attached to the log, by the name of the file,
            such as hand.urdf, gains.toml, calibration.toml, task.toml and initial_state.
        wall: data about the machine and the wall clock. The metadata record `handctl.wall` contains
            these data.
        deterministic: True for a run in lockstep. The recorder of a run in lockstep drops no tick
            and reads no clock. Therefore two equal runs in lockstep write equal logs.
    """

    hand_toml: str
    joints: tuple[str, ...]
    tendons: tuple[str, ...]
    motors: tuple[str, ...]
    digits: tuple[str, ...]
    buses: tuple[str, ...]
    period_ns: int
    offset_ns: int = 0
    metadata: dict[str, str] = field(default_factory=dict)
    gains: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    wall: dict[str, str] = field(default_factory=dict)
    deterministic: bool = False

    @classmethod
    def from_hand(cls, hand_toml: str, period_ns: int, **other_fields: object) -> Self:
        """Return a header with the names of joints, tendons, motors, digits and buses, taken from the hand description.

        Args:
            hand_toml: the description of the hand, after all defaults have been applied.
            period_ns: control period, the time from one tick to the next [ns].
            other_fields: values of the other attributes of the header, by name.
        """
        hand = tomllib.loads(hand_toml)
        joints = tuple(
            f"{d['name']}_j{i + 1}" for d in hand["digit"] for i in range(len(d["link_length_m"]))
        )
        names = {
            hand_part: tuple(part_fields["name"] for part_fields in hand[hand_part])
            for hand_part in ("tendon", "motor", "digit", "bus")
        }
        return cls(
            hand_toml,
            joints,
            names["tendon"],
            names["motor"],
            names["digit"],
            names["bus"],
            period_ns,
            **other_fields,  # type: ignore[arg-type]
        )

    @classmethod
    def from_record(
        cls,
        record: Mapping[str, str],
        metadata: Mapping[str, dict[str, str]],
        attachments: dict[str, bytes],
    ) -> Self:
        """Return the run header that is stored in the records of a log.

        Each value that handctl uses in calculations is checked for its type and its range.

        Args:
            record: metadata record `handctl.run`. The values of a metadata record are JSON texts.
            metadata: all metadata records of the log.
            attachments: all attachments of the log.

        Raises:
            ValueError: a value has the wrong type or is out of range.
            KeyError: a value is missing.
        """
        run = {name: json.loads(text) for name, text in record.items()}
        names = {list_key: _checked_names(list_key, run[list_key]) for list_key in NAME_LIST_KEYS}
        return cls(
            attachments.get("hand.toml", b"").decode(),
            **names,
            period_ns=_checked_integer("period_ns", run["period_ns"], *PERIOD_RANGE_NS),
            offset_ns=_checked_integer("offset_ns", run["offset_ns"], 0, MAX_LOG_TIME_NS),
            metadata=metadata.get("handctl", {}),
            gains=metadata.get("handctl.gains", {}),
            attachments=attachments,
            wall=metadata.get("handctl.wall", {}),
            deterministic=run["deterministic"] is True,
        )

    @property
    def truth_offset_ns(self) -> int:
        """Return the time of the simulator [ns] when the time of the run was 0.

        For a run that was not in lockstep, the result is 0.

        Raises:
            LogError: the value in the log is not a time.
        """
        text = self.metadata.get(TRUTH_OFFSET_KEY, "0")
        if not (
            text.isascii() and text.isdecimal() and len(text) < 20 and int(text) <= MAX_LOG_TIME_NS
        ):
            raise LogError(
                f"{TRUTH_OFFSET_KEY} = {text}",
                "the log",
                f"a whole number from 0 to {MAX_LOG_TIME_NS}",
            )
        return int(text)

    def axis_names(self, name: str) -> tuple[str, ...]:
        """Return the names of all joints, tendons, motors or digits, depending on the telemetry axis `name`."""
        return {
            "joint": self.joints,
            "tendon": self.tendons,
            "motor": self.motors,
            "digit": self.digits,
        }[name]

    def dump(self) -> bytes:
        """Encode the header for the pipe to the recorder: one line of JSON, followed by the attachments in order."""
        sizes = {name: len(data) for name, data in self.attachments.items()}
        fields = asdict(self) | {"attachments": sizes}
        for table in ("metadata", "gains", "wall"):
            fields[table] = {
                escape_surrogates(name): escape_surrogates(text)
                for name, text in fields[table].items()
            }
        return json.dumps(fields).encode() + b"\n" + b"".join(self.attachments.values())

    @classmethod
    def load(cls, data: bytes) -> Self:
        """Decode a header that `dump` has encoded."""
        line, _, payload = data.partition(b"\n")
        fields = json.loads(line)
        attachments = {}
        offset = 0
        for name, size in fields["attachments"].items():
            attachments[name] = payload[offset : offset + size]
            offset += size
        names = {list_key: tuple(fields[list_key]) for list_key in NAME_LIST_KEYS}
        return cls(**(fields | names | {"attachments": attachments}))


def _checked_integer(key: str, value: Any, minimum: int, maximum: int) -> int:
    """Check the type and the range of an integer from the header of a log, and return the integer.

    Raises:
        ValueError: the value is not a whole number from `minimum` to `maximum`.
    """
    # `isinstance(value, int)` would also accept True. But JSON distinguishes true from 1.
    if type(value) is not int or not minimum <= value <= maximum:
        raise ValueError(
            f"{key} is {_shortened_json(value)}, not a whole number from {minimum} to {maximum}"
        )
    return value


def _checked_names(key: str, value: Any) -> tuple[str, ...]:
    """Check that a value from the header of a log is a list of valid names, and return the names.

    Raises:
        ValueError: the value is not a list of valid names.
    """
    if not isinstance(value, list) or len(value) > MAX_NAMES_PER_LIST:
        raise ValueError(
            f"{key} is {_shortened_json(value)}, not a list of at most {MAX_NAMES_PER_LIST} names"
        )
    for name in value:
        if not isinstance(name, str) or not NAME_PATTERN.fullmatch(name):
            raise ValueError(
                f"{key} contains {_shortened_json(name)}, not a name of letters, digits and _"
            )
    if len(set(value)) < len(value):
        raise ValueError(f"{key} contains a name twice")
    return tuple(value)


def _shortened_json(value: Any) -> str:
    """Return a value of the header as text with at most 40 characters, for an error message."""
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."
