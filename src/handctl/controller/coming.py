"""Gains that are requested while the controller runs, and being designed."""

from dataclasses import dataclass

from handctl.core.gains.gains import Gains


@dataclass(frozen=True, slots=True)
class Coming:
    """Gains that somebody has requested.

    Attributes:
        gains: all of them, with those that change.
        step: pieces of the design that are done.
    """

    gains: Gains
    step: int = 0
