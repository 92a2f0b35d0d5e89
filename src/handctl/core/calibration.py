"""Calibration of a hand.

A calibration contains the tares of the load cells, the zero angles of the motors, and the
identified parameters of the tendons. A calibration also contains the response of the load cells to
a pull of each motor.
"""

import datetime
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field, field_validator

from handctl.core.identified_parameters import IdentifiedParameters, check_identified
from handctl.core.tick_types import Vector
from handctl.document import Document, validate_content
from handctl.drives.sensors.sensor_node import TARE_MAX_N, TARE_MIN_N
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.file.quantity_types import MAX_POSITION_RANGE_RAD


class TendonCalibration(Document):
    """Calibration of a tendon: tare, motor zero, and the responses of the load cells during commissioning."""

    tare_N: float
    """Tare of the load cell: its reading without tension."""
    zero_rad: float = Field(ge=-MAX_POSITION_RANGE_RAD, le=MAX_POSITION_RANGE_RAD)
    """Motor position at which the tendon is just taut while its digit is open."""
    answer_N: float
    """Response of the tendon's own load cell to the pull of its motor during commissioning."""
    crosstalk_N: float
    """Largest response of any other load cell to the pull of the tendon's motor during commissioning."""

    @field_validator("tare_N")
    @classmethod
    def _check_tare_range(cls, tare: float) -> float:
        if not TARE_MIN_N <= tare <= TARE_MAX_N:
            raise ValueError(
                f"{TARE_MIN_N:g} to {TARE_MAX_N:g} N: adjust the load cell, then commission again"
            )
        return tare


class Calibration(Document):
    """Calibration file of a hand."""

    schema_: int = Field(1, alias="schema", ge=1, le=1)
    hand: str
    identity: str
    """Hash of the hand description that the calibration belongs to."""
    made: str
    """Date and time of the calibration, ISO 8601, UTC."""
    simulated: bool = False
    """True if the calibration belongs to a simulated hand.

    With the calibration of a simulated hand, the controller does not arm a hand that has real
    motors.
    """
    tendon: dict[str, TendonCalibration]
    drive: dict[str, str] = Field(default_factory=dict)
    """Identity of the drive of each motor, see `Drive.identity`.

    The dictionary is empty in calibration files of earlier versions of handctl.
    """
    identified: dict[str, IdentifiedParameters] = Field(default_factory=dict)
    """Identified parameters of each tendon. Parameters that are not identified have the values of the hand file."""

    @field_validator("made")
    @classmethod
    def _check_date(cls, creation_date: str) -> str:
        datetime.datetime.fromisoformat(creation_date)
        return creation_date

    def tare_tensions(self, hand: Hand) -> Vector:
        """Return the tares (N,) of all load cells [N]."""
        return np.array([self.tendon[name].tare_N for name in hand.tendon_names])

    def motor_zeros(self, hand: Hand) -> Vector:
        """Return the zero angles (N,) of all motors [rad]."""
        return np.array([self.tendon[name].zero_rad for name in hand.tendon_names])


def parse_calibration(file_content: Mapping[str, Any], hand: Hand, source_name: str) -> Calibration:
    """Check the content of a hand's calibration file, and return the calibration.

    Args:
        file_content: content of the file, as parsed from TOML.
        hand: hand of the calibration.
        source_name: name of the file, for error messages.

    Raises:
        ConfigError: the content is not a calibration, belongs to another hand or another version of
            the hand's description, or lacks a tendon.
    """
    calibration = validate_content(file_content, Calibration, source_name)
    if calibration.identity != hand.identity:
        raise ConfigError(
            f"is for hand {calibration.hand!r} with description {calibration.identity[:12]}",
            source_name,
            f"one of {hand.name!r} with {hand.identity[:12]}: run handctl commission again",
        )
    for name in set(hand.tendon_names) - calibration.tendon.keys():
        raise ConfigError("missing", f"{source_name}: tendon.{name}", "an entry for every tendon")
    check_identified(hand, calibration.identified, source_name)
    return calibration
