"""Change of gains while the controller runs: a piece of design per tick, then a takeover without torque step.

The design of a loop takes about a millisecond. A running controller therefore designs a loop
per tick, and takes all loops over at once. At the takeover, the motor force commanded by the old
gains minus the force commanded by the new gains becomes a fading trim (bumpless transfer).
Integrals are in newtons, not integrals of the error, and need no rescaling.
"""

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

from handctl.controller.pending_gains import PendingGains
from handctl.core.gains.bounds import flat, with_values
from handctl.core.gains.gains import Gains
from handctl.core.gains.motion_design import assembled, design_piece, pieces
from handctl.core.model import HandModel
from handctl.core.types import GAIN_EVENT, Event, Vector
from handctl.errors import ConfigError
from handctl.programs.requests import REFUSED

Controller = TypeVar("Controller")
"""``controller.tick.Controller``, or another dataclass with a ``model``."""

CACHE_SIZE = 8
"""Size of the design cache: the gains of a run, the pending gains, and some earlier gains to return to."""


class DesignProgress(NamedTuple):
    """An incomplete design.

    Attributes:
        pending: progress of the design. None if these weights lead to no gains.
        events: of the failure.
    """

    pending: PendingGains | None
    events: tuple[Event, ...] = ()


@dataclass(slots=True)
class Designs:
    """Cache of designs by gains. A missing design is computed again.

    Attributes:
        designed_pieces: pieces designed so far, for the last ``CACHE_SIZE`` requests.
        controllers: with complete designs.
        used: gains of the last requested controller.
    """

    designed_pieces: dict[Gains, list[Vector]] = field(default_factory=dict)
    controllers: dict[Gains, Any] = field(default_factory=dict)
    used: Gains | None = None

    def advance(self, model: HandModel, pending: PendingGains) -> DesignProgress | None:
        """Design a further piece. Return None when the design is complete."""
        try:
            done = self._up_to(model, pending.gains, pending.step + 1)
        except ConfigError as error:
            return DesignProgress(None, (Event("warn", "gains", "", f"{REFUSED}{error}"),))
        return None if len(done) >= pieces(model.space) else DesignProgress(replace(pending, step=pending.step + 1))

    def controller(self, controller: Controller, gains: Gains) -> Controller:
        """Return the controller with other gains, and keep these gains in the cache."""
        self.used = gains
        if gains not in self.controllers:
            old: Any = controller
            model = old.model
            designed_pieces = self._up_to(model, gains, pieces(model.space))
            designed = replace(model, gains=gains, motion=assembled(model.space, designed_pieces))
            self.controllers[gains] = replace(old, model=designed)
        made: Controller = self.controllers[gains]
        return made

    def _up_to(self, model: HandModel, gains: Gains, count: int) -> list[Vector]:
        """Return the first ``count`` pieces or more, with missing pieces designed."""
        designed_pieces = self.designed_pieces.setdefault(gains, [])
        if len(self.designed_pieces) > CACHE_SIZE:
            # Dictionaries keep insertion order, so the first entry is the oldest. The gains in use stay.
            oldest = next(one for one in self.designed_pieces if one != self.used)
            self.controllers.pop(oldest, None)
            del self.designed_pieces[oldest]
        while len(designed_pieces) < count:
            designed_pieces.append(design_piece(model.space, gains, model.period, len(designed_pieces)))
        return designed_pieces


def begin_design(present: Gains, values: dict[str, float]) -> tuple[PendingGains | None, tuple[Event, ...]]:
    """Begin the design of requested gains.

    Args:
        present: gains to change.
        values: requested values by key.

    Returns:
        The pending gains, or None with an event stating the reason.
    """
    try:
        return PendingGains(with_values(present, values, "gains", live=True)), ()
    except ConfigError as error:
        return None, (Event("warn", "request", "", f"{REFUSED}{error}"),)


def changes(before: Gains, after: Gains) -> tuple[Event, ...]:
    """Return an event for each changed gain, then an event for the takeover."""
    old = flat(before)
    new = flat(after)
    changed = tuple(Event("info", GAIN_EVENT, key, repr(value)) for key, value in new.items() if value != old[key])
    return *changed, Event("info", "gains", "", f"taken over: {len(changed)} changed")
