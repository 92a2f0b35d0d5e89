"""What is known of a run before its first tick."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Self

from handctl.errors import LogError
from handctl.hand.file.quantities import NAME_PATTERN
from handctl.printing import encodable

TRUTH_OFFSET = "truth_offset_ns"
"""In the metadata of a lockstep run: its t = 0 on the simulator's clock, which commissioning has moved on [ns]."""
PERIODS_NS = (10_000, 10_000_000_000)
"""Shortest and longest period of a tick in a log [ns]."""
LATEST_NS = 1 << 62
"""Latest time in a log [ns]: the sum of two of them, and UNIX time until 2116, fit into 64 bits."""
NAMES = ("joints", "tendons", "motors", "digits", "buses")
"""Lists of names in a header."""
MAX_NAMES = 1000
"""Names in one list."""


@dataclass(frozen=True, slots=True)
class RunHeader:
    """Written first, so that it survives whatever ends the run.

    Attributes:
        hand_toml: the hand's description, resolved.
        joints, tendons, motors, digits, buses: names in the order of the hand file.
        period_ns: period of the tick [ns].
        offset_ns: UNIX time at t = 0 [ns]; one per run; 0 in a deterministic run.
        metadata: version, bus, seed, operator's note ...: the metadata record ``handctl``.
        gains: name -> value at the start: the metadata record ``handctl.gains`` and the first parameter event.
        attachments: file name -> bytes, e.g. hand.urdf, gains.toml, calibration.toml, task.toml, initial_state.
        wall: all that depends on the machine or the wall clock: the metadata record ``handctl.wall``.
        deterministic: a lockstep run: nothing is dropped, no clock is read, equal runs give equal streams.
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
    def of_hand(cls, hand_toml: str, period_ns: int, **more: object) -> Self:
        """Header with all names taken from the hand's description; ``more`` as the other attributes."""
        hand = tomllib.loads(hand_toml)
        joints = tuple(f"{d['name']}_j{i + 1}" for d in hand["digit"] for i in range(len(d["link_length_m"])))
        names = {part: tuple(one["name"] for one in hand[part]) for part in ("tendon", "motor", "digit", "bus")}
        return cls(
            hand_toml,
            joints,
            names["tendon"],
            names["motor"],
            names["digit"],
            names["bus"],
            period_ns,
            **more,  # type: ignore[arg-type]
        )

    @classmethod
    def of_record(
        cls,
        record: Mapping[str, str],
        metadata: Mapping[str, dict[str, str]],
        attachments: dict[str, bytes],
    ) -> Self:
        """Read a header from the records of a log, and check every value that others count with.

        Args:
            record: metadata record ``handctl.run``, a JSON text by name.
            metadata: all metadata records.
            attachments: all attachments.

        Raises:
            ValueError: a value has another type than a header has, or is out of its range.
            KeyError: a value is missing.
        """
        run = {name: json.loads(text) for name, text in record.items()}
        names = {part: _names(part, run[part]) for part in NAMES}
        return cls(
            attachments.get("hand.toml", b"").decode(),
            **names,
            period_ns=_whole("period_ns", run["period_ns"], *PERIODS_NS),
            offset_ns=_whole("offset_ns", run["offset_ns"], 0, LATEST_NS),
            metadata=metadata.get("handctl", {}),
            gains=metadata.get("handctl.gains", {}),
            attachments=attachments,
            wall=metadata.get("handctl.wall", {}),
            deterministic=run["deterministic"] is True,
        )

    @property
    def truth_offset_ns(self) -> int:
        """Time of t = 0 on the simulator's clock [ns]; 0 of a run that was not in lockstep.

        Raises:
            LogError: the log states something else.
        """
        text = self.metadata.get(TRUTH_OFFSET, "0")
        if not (text.isascii() and text.isdecimal() and len(text) < 20 and int(text) <= LATEST_NS):
            raise LogError(f"{TRUTH_OFFSET} = {text}", "the log", f"a whole number from 0 to {LATEST_NS}")
        return int(text)

    def axis(self, name: str) -> tuple[str, ...]:
        """Names along an axis of the telemetry: joint, tendon, motor or digit."""
        return {"joint": self.joints, "tendon": self.tendons, "motor": self.motors, "digit": self.digits}[name]

    def dump(self) -> bytes:
        """For the pipe: one line of JSON, then the attachments one after the other."""
        sizes = {name: len(data) for name, data in self.attachments.items()}
        plain = asdict(self) | {"attachments": sizes}
        for table in ("metadata", "gains", "wall"):
            plain[table] = {encodable(name): encodable(text) for name, text in plain[table].items()}
        return json.dumps(plain).encode() + b"\n" + b"".join(self.attachments.values())

    @classmethod
    def load(cls, data: bytes) -> Self:
        """Inverse of ``dump``."""
        line, _, rest = data.partition(b"\n")
        plain = json.loads(line)
        attachments, at = {}, 0
        for name, size in plain["attachments"].items():
            attachments[name], at = rest[at : at + size], at + size
        names = {part: tuple(plain[part]) for part in NAMES}
        return cls(**(plain | names | {"attachments": attachments}))


def _whole(key: str, value: Any, low: int, high: int) -> int:
    """Check a whole number of a log's header."""
    if type(value) is not int or not low <= value <= high:
        raise ValueError(f"{key} is {_brief(value)}, not a whole number from {low} to {high}")
    return value


def _names(key: str, value: Any) -> tuple[str, ...]:
    """Check a list of names of a log's header: each as a hand file can have it, and none twice."""
    if not isinstance(value, list) or len(value) > MAX_NAMES:
        raise ValueError(f"{key} is {_brief(value)}, not a list of at most {MAX_NAMES} names")
    for name in value:
        if not isinstance(name, str) or not NAME_PATTERN.fullmatch(name):
            raise ValueError(f"{key} contains {_brief(name)}, not a name of letters, digits and _")
    if len(set(value)) < len(value):
        raise ValueError(f"{key} contains a name twice")
    return tuple(value)


def _brief(value: Any) -> str:
    """Write a value of a header for a message."""
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."
