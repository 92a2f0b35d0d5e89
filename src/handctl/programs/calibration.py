"""What was found out about one hand: tares, zeros, that every tendon pulls what it should, and what it is made of."""

import datetime
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, field_validator

from handctl.core.identified import Identified, check_identified
from handctl.core.types import Vector
from handctl.document import Document, validated
from handctl.drives.sensors.node import TARE_LEAST_N, TARE_MOST_N
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.load import read_toml


class TendonCalibration(Document):
    """One tendon's result of the sign test."""

    tare_N: float
    """Load-cell reading without tension."""
    zero_rad: float = Field(ge=-1000, le=1000)
    """Motor position at which the rope is just taut and the digit open."""
    answer_N: float
    """How much its own load cell answered to the pull."""
    crosstalk_N: float
    """The most that any other load cell answered."""

    @field_validator("tare_N")
    @classmethod
    def _readable(cls, tare: float) -> float:
        if not TARE_LEAST_N <= tare <= TARE_MOST_N:
            raise ValueError(f"{TARE_LEAST_N:g} to {TARE_MOST_N:g} N: adjust the load cell, then commission again")
        return tare


class Calibration(Document):
    """A hand's calibration file."""

    schema_: int = Field(1, alias="schema", ge=1, le=1)
    hand: str
    identity: str
    """Hash of the hand description it was made with."""
    made: str
    """Date and time, ISO 8601, UTC."""
    tendon: dict[str, TendonCalibration]
    drive: dict[str, str] = Field(default_factory=dict)
    """What tells each drive from others, by motor, see ``Drive.identity``; empty in files of earlier versions."""
    identified: dict[str, Identified] = Field(default_factory=dict)
    """What identification found, by tendon; what is not there is as the hand file says."""

    @field_validator("made")
    @classmethod
    def _date(cls, made: str) -> str:
        datetime.datetime.fromisoformat(made)
        return made

    def tare(self, hand: Hand) -> Vector:
        """(N,) load-cell tare [N]."""
        return np.array([self.tendon[name].tare_N for name in hand.tendon_names])

    def zero(self, hand: Hand) -> Vector:
        """(N,) motor zero [rad]."""
        return np.array([self.tendon[name].zero_rad for name in hand.tendon_names])


def load_calibration(path: Path, hand: Hand) -> Calibration:
    """Read a calibration and check that it belongs to this hand.

    Raises:
        ConfigError: it cannot be read, is for another hand or another version of its description, or lacks a tendon.
    """
    return calibration_from(read_toml(path), hand, str(path))


def calibration_from(content: Mapping[str, Any], hand: Hand, source: str) -> Calibration:
    """Check a calibration file's content.

    Raises:
        ConfigError: as ``load_calibration``; the line names the source.
    """
    calibration = validated(content, Calibration, source)
    if calibration.identity != hand.identity:
        raise ConfigError(
            f"is for hand {calibration.hand!r} with description {calibration.identity[:12]}",
            source,
            f"one of {hand.name!r} with {hand.identity[:12]}: run handctl commission again",
        )
    for name in set(hand.tendon_names) - calibration.tendon.keys():
        raise ConfigError("missing", f"{source}: tendon.{name}", "an entry for every tendon")
    check_identified(hand, calibration.identified, source)
    return calibration
