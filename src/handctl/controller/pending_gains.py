"""Requested gains for which the controller is still being designed while the old controller runs."""

from dataclasses import dataclass

from handctl.core.gains.gains import Gains


@dataclass(frozen=True, slots=True)
class PendingGains:
    """Requested gains, with the state of the design.

    Attributes:
        gains: all gains of the hand, including the requested changes.
        step: number of control loops that are designed so far.
    """

    gains: Gains
    step: int = 0
