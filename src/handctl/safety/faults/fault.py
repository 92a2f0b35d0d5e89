"""One row of the fault table, and the simplest detectors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from handctl.safety.action import Action, Release
from handctl.safety.signals import Limits, Named, Signals

Reading = tuple[str, float]
"""Instance and the value that shows the fault."""
Detector = Callable[[Limits, Signals], Sequence[Reading]]
PERSON, ITSELF = "a person", "by itself"
NOTHING: Named = ()


@dataclass(frozen=True, slots=True)
class Fault:
    """One row.

    Attributes:
        id: row of the fault catalogue; a letter behind it tells its stages apart.
        title: what it is, for a person.
        detection: how it is noticed.
        debounce: consecutive ticks before it counts.
        action: what happens.
        clears: who ends it: "by itself", or "a person" for latched ones.
        detect: the detector: instances in which the fault is present, each with the reading that shows it.
        release: how RELAX takes the torque away because of this fault.
    """

    id: str
    title: str
    detection: str
    debounce: int
    action: Action
    clears: str
    detect: Detector
    release: Release = Release.LOOP

    @property
    def reaction(self) -> str:
        """Return the action as tables name it, with the way to relax."""
        return self.release.value if self.action == Action.RELAX else self.action.name

    @property
    def latched(self) -> bool:
        """Whether the action stays until a person clears it."""
        return self.clears == PERSON

    @property
    def row(self) -> str:
        """The row of the fault catalogue, without the stage."""
        return self.id.rstrip("abcd")


def above(names: tuple[str, ...], values: Sequence[float], limit: float) -> Sequence[Reading]:
    """Instances whose value is above a limit; what is not a number is not, wherever it stands."""
    if not values or max(values) <= limit:
        return NOTHING
    return [(name, value) for name, value in zip(names, values, strict=False) if value > limit]


def io(*kinds: str) -> Detector:
    """What a bus or the host reports."""

    def detect(limits: Limits, s: Signals) -> Sequence[Reading]:
        return [(where or kind, float(number)) for kind, where, number in s.io if kind in kinds] if s.io else NOTHING

    return detect


def recorder(*wheres: str) -> Detector:
    """What the recorder reports."""

    def detect(limits: Limits, s: Signals) -> Sequence[Reading]:
        if not s.io:
            return NOTHING
        return [(where, float(number)) for kind, where, number in s.io if kind == "recorder" and where in wheres]

    return detect
