"""What a fault is, and where faults are declared.

A row of the catalogue is something that can go wrong. A fault is a row that a tick can judge, or a stage of one. Both
are declared once, in the file of their kind: ``bus``, ``node``, ``tendon``, ``host``. Tables in README and docs, the
campaign's deadlines, the text of an event and the reaction follow from the declaration.

A fault with ``per`` is found by a compiled detector in ``core.detectors``. Its declaration returns the index by which
the detector addresses it, ``found[N07, motor]``. A fault with ``reports`` is told by a bus, the host or the recorder.
"""

from dataclasses import dataclass
from typing import NamedTuple

from handctl.safety.action import Action, Release

OPERATOR, ITSELF = "a person", "by itself"
"""Who ends a fault: an operator, for what is latched, or the fault by going away."""

TENDON, MOTOR, JOINT, NODE, HAND = "tendon", "motor", "joint", "node", "hand"
"""What the instances of a fault are. ``NODE``: motors, then the load cells. ``HAND``: a single one."""

DETECTED, REPLACED, LOST = "detected", "replaced", "lost"
"""How far a protocol shows a fault: it does, a weaker sign takes its place, or it does not."""
TICK, ARMING, DRIVE, LOOP, FILES = "fault table", "before arming", "the drive itself", "loop and recorder", "files"
"""Where a row is judged."""


class Row(NamedTuple):
    """One row of the catalogue.

    Attributes:
        id: of the row. title: what goes wrong.
        where: it is judged.
        mit, odrive, cia402: how far each protocol shows it; detected, or "replaced: by what", or "lost: why".
        ticks, ms: latest reaction, together: so many ticks, and a time besides.
        odrive_ms: what an ODrive needs besides, since it tells its state every 100 ms [ms].
        asked: ticks of 5 ms that the project's fault catalogue gives an ideal drive; 0: none given, as before torque.
        why: more ticks are needed than that; empty if not.
        tried: ``campaign``, or the test that produces it.
    """

    id: str
    title: str
    where: str = TICK
    mit: str = DETECTED
    odrive: str = DETECTED
    cia402: str = DETECTED
    ticks: int = 0
    ms: float = 0.0
    odrive_ms: float = 0.0
    asked: int = 0
    why: str = ""
    tried: str = "campaign"

    def latest_ms(self, rate_hz: float) -> float:
        """Return the latest reaction at a control rate [ms]; an ODrive's may take ``odrive_ms`` more."""
        return self.ticks * 1e3 / rate_hz + self.ms


@dataclass(frozen=True, slots=True)
class Fault:
    """A row that a tick can judge, or a stage of one.

    Attributes:
        id: row of the catalogue; a letter behind it tells its stages apart.
        title: what it is, for an operator.
        detection: how it is noticed.
        action: what happens.
        clears: who ends it, ``OPERATOR`` or ``ITSELF``.
        debounce: consecutive ticks before it counts.
        release: how RELAX takes the torque away because of this fault.
        per: what its instances are; empty if it is reported. name: of the single instance of ``HAND``.
        reports: kinds of events of buses and host that mean it; those of the recorder as ``recorder:WHAT``.
    """

    id: str
    title: str
    detection: str
    action: Action
    clears: str
    debounce: int = 1
    release: Release = Release.LOOP
    per: tuple[str, ...] = ()
    name: str = ""
    reports: tuple[str, ...] = ()

    @property
    def reaction(self) -> str:
        """Return the action as tables name it, with the way to relax."""
        return self.release.value if self.action == Action.RELAX else self.action.name

    @property
    def latched(self) -> bool:
        """Whether the action stays until an operator clears it."""
        return self.clears == OPERATOR

    @property
    def row(self) -> str:
        """The row of the catalogue, without the stage."""
        return self.id.rstrip("abcd")


CATALOGUE: list[Row] = []
"""All rows, in the order of their declaration."""
TABLE: list[Fault] = []
"""All faults, likewise."""
FOUND: list[tuple[Fault, str]] = []
"""Fault and kind of instance of each row of what the detectors find; a fault of several kinds has one after another."""


def row(*args: object, **details: object) -> None:
    """Declare a row of the catalogue; see ``Row``."""
    CATALOGUE.append(Row(*args, **details))  # type: ignore[arg-type]


def fault(
    id_: str,
    title: str,
    detection: str,
    action: Action,
    clears: str,
    *per: str,
    debounce: int = 1,
    release: Release = Release.LOOP,
    name: str = "",
    reports: tuple[str, ...] = (),
) -> int:
    """Declare a fault; see ``Fault``.

    Returns:
        the index of its row for detectors, that of the first kind of instance; -1 for a fault that is reported.
    """
    one = Fault(id_, title, detection, action, clears, debounce, release, per, name, reports)
    TABLE.append(one)
    first = len(FOUND)
    FOUND.extend((one, kind) for kind in per)
    return first if per else -1
