"""What is shown: the hand and the run of a log, as the lenses and the layout want to know them."""

import tomllib
from dataclasses import dataclass
from functools import cached_property

from handctl.controller.types import TELEMETRY_AXES
from handctl.errors import LogError
from handctl.hand.description import Hand, hand_from
from handctl.log.batch import columns
from handctl.log.header import RunHeader


@dataclass(frozen=True)
class Subject:
    """One run of one hand.

    Attributes:
        header: names, period and offset of the run.
        hand: its description, out of the log.
        name: what a person calls the log.
    """

    header: RunHeader
    hand: Hand
    name: str

    @classmethod
    def of(cls, header: RunHeader, name: str) -> "Subject":
        """The subject of a log.

        Raises:
            LogError: the description in the log is no TOML, or its names are not those of the header.
            ConfigError: the description in the log is none of a hand.
        """
        where = f"{name}, attachment hand.toml"
        try:
            content = tomllib.loads(header.hand_toml)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise LogError(f"not TOML: {error}", where, "the description of the hand that ran") from None
        hand = hand_from(content, where)
        if (hand.joints, hand.tendon_names, hand.digit_names) != (header.joints, header.tendons, header.digits):
            raise LogError("other names than the log's header has", where, "the description of the hand that ran")
        return cls(header, hand, name)

    @property
    def application(self) -> str:
        """Rerun keeps one layout for each of these."""
        return f"handctl_{self.hand.name}"

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Where each field of the telemetry is in a row of /controller/values."""
        return columns(self.header)

    @property
    def width(self) -> int:
        """Number of columns of /controller/values."""
        return sum(len(self.header.axis(axis)) for axis in TELEMETRY_AXES.values())

    @property
    def limits(self) -> list[float]:
        """Each different tension limit of a tendon [N]."""
        return sorted({tendon.tension_max_N for tendon in self.hand.tendon})

    @property
    def reach(self) -> float:
        """Length of the longest digit [m]."""
        return max(sum(digit.link_length_m) for digit in self.hand.digit)
