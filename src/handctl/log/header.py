"""What is known of a run before its first tick."""

import json
import tomllib
from dataclasses import asdict, dataclass, field
from typing import Self

TRUTH_OFFSET = "truth_offset_ns"
"""In the metadata of a lockstep run: its t = 0 on the simulator's clock, which commissioning has moved on [ns]."""


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

    def axis(self, name: str) -> tuple[str, ...]:
        """Names along an axis of the telemetry: joint, tendon, motor or digit."""
        return {"joint": self.joints, "tendon": self.tendons, "motor": self.motors, "digit": self.digits}[name]

    def dump(self) -> bytes:
        """For the pipe: one line of JSON, then the attachments one after the other."""
        sizes = {name: len(data) for name, data in self.attachments.items()}
        plain = asdict(self) | {"attachments": sizes}
        return json.dumps(plain).encode() + b"\n" + b"".join(self.attachments.values())

    @classmethod
    def load(cls, data: bytes) -> Self:
        """Inverse of ``dump``."""
        line, _, rest = data.partition(b"\n")
        plain = json.loads(line)
        attachments, at = {}, 0
        for name, size in plain["attachments"].items():
            attachments[name], at = rest[at : at + size], at + size
        names = {part: tuple(plain[part]) for part in ("joints", "tendons", "motors", "digits", "buses")}
        return cls(**(plain | names | {"attachments": attachments}))
