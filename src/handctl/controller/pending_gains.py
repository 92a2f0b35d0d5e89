"""Requested gains whose controller design is in progress while the controller runs."""

from dataclasses import dataclass

from handctl.core.gains.gains import Gains


@dataclass(frozen=True, slots=True)
class PendingGains:
    """Requested gains, and the part of their controller design that is complete.

    Attributes:
        gains: all gains of the hand, including the requested changes.
        designed_loop_count: number of control loops designed so far.
    """

    gains: Gains
    designed_loop_count: int = 0
