"""Gains that change while the controller runs: designed a piece a tick, then taken over without a step in torque.

The design of a loop takes about a millisecond, so a running controller does one a tick and takes all of them over at
once. When it does, the motor force that the old gains ask for in that tick less what the new ones ask for is kept as
a trim and fades. Integrals are kept in newtons, not as an integral of the error, so they need no rescaling.
"""

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

from handctl.controller.coming import Coming
from handctl.core.gains.bounds import flat, with_values
from handctl.core.gains.gains import Gains
from handctl.core.gains.motion_design import assembled, design_piece, pieces
from handctl.core.model import HandModel
from handctl.core.types import GAIN_EVENT, Event, Vector
from handctl.errors import ConfigError
from handctl.programs.requests import REFUSED

Controller = TypeVar("Controller")
"""``controller.tick.Controller``: a dataclass with a ``model``."""

KEPT = 8
"""Gains whose designs are remembered: those of a run, those that are coming, and some to go back to."""


class Unfinished(NamedTuple):
    """A design that is not complete.

    Attributes:
        coming: how far it is; None if no gains follow from these weights.
        told: says so.
    """

    coming: Coming | None
    told: tuple[Event, ...] = ()


@dataclass(slots=True)
class Designs:
    """Designs that were made already, by gains: only a memory, for what is missing in it is made again.

    Attributes:
        found: pieces so far, of the ``KEPT`` gains that were asked for last.
        controllers: with whole designs.
        used: gains whose controller was asked for last.
    """

    found: dict[Gains, list[Vector]] = field(default_factory=dict)
    controllers: dict[Gains, Any] = field(default_factory=dict)
    used: Gains | None = None

    def advance(self, model: HandModel, coming: Coming) -> Unfinished | None:
        """Design one piece more; None when the design is complete."""
        try:
            done = self._up_to(model, coming.gains, coming.step + 1)
        except ConfigError as error:
            return Unfinished(None, (Event("warn", "gains", "", f"{REFUSED}{error}"),))
        return None if len(done) >= pieces(model.space) else Unfinished(replace(coming, step=coming.step + 1))

    def controller(self, controller: Controller, gains: Gains) -> Controller:
        """Return the controller with other gains; those that a run uses are not forgotten."""
        self.used = gains
        if gains not in self.controllers:
            old: Any = controller
            model = old.model
            found = self._up_to(model, gains, pieces(model.space))
            designed = replace(model, gains=gains, motion=assembled(model.space, found))
            self.controllers[gains] = replace(old, model=designed)
        made: Controller = self.controllers[gains]
        return made

    def _up_to(self, model: HandModel, gains: Gains, count: int) -> list[Vector]:
        found = self.found.setdefault(gains, [])
        if len(self.found) > KEPT:
            oldest = next(one for one in self.found if one != self.used)
            self.controllers.pop(oldest, None)
            del self.found[oldest]
        while len(found) < count:
            found.append(design_piece(model.space, gains, model.period, len(found)))
        return found


def asked(present: Gains, values: dict[str, float]) -> tuple[Coming | None, tuple[Event, ...]]:
    """What a request for other gains leads to: their design, or one line that says why not.

    Args:
        present: gains to change.
        values: by key.
    """
    try:
        return Coming(with_values(present, values, "gains", live=True)), ()
    except ConfigError as error:
        return None, (Event("warn", "request", "", f"{REFUSED}{error}"),)


def changes(before: Gains, after: Gains) -> tuple[Event, ...]:
    """An event for every key whose value is another, and one that says that the new gains act from now on."""
    old, new = flat(before), flat(after)
    changed = tuple(Event("info", GAIN_EVENT, key, repr(value)) for key, value in new.items() if value != old[key])
    return *changed, Event("info", "gains", "", f"taken over: {len(changed)} changed")
