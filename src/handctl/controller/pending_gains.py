"""Requested gains in design while the controller runs."""

from dataclasses import dataclass

from handctl.core.gains.gains import Gains


@dataclass(frozen=True, slots=True)
class PendingGains:
    """Requested gains.

    Attributes:
        gains: all gains, with the changes.
        step: number of designed pieces.
    """

    gains: Gains
    step: int = 0
