"""Faults and rows of the catalogue, and their declaration.

A row of the catalogue is a possible failure. A fault is a row, or a stage of a row, judged in every
tick. Each row and each fault is declared once, in the module of its kind: ``bus``,
``node``, ``tendon``, ``host``. The tables in the documents, the campaign's deadlines, the text of
an event and the reaction follow from the declaration.

A compiled detector in ``core.detectors`` finds a fault with ``per``. The declaration returns
the index of the fault for the detector: ``evidence[N07, motor]``. A bus, the host or the
recorder reports a fault with ``reports``.
"""

from dataclasses import dataclass
from typing import NamedTuple

from handctl.safety.action import Action, Release

OPERATOR = "by the operator"
ITSELF = "by itself"
"""How a fault ends: the operator clears a latched fault, any other fault ends with its cause."""

TENDON = "tendon"
MOTOR = "motor"
JOINT = "joint"
NODE = "node"
HAND = "hand"
"""Kinds of instances of a fault. ``NODE``: the motors, then the load cells. ``HAND``: a single instance."""

DETECTED = "detected"
REPLACED = "replaced"
LOST = "lost"
"""Visibility of a fault in a protocol: visible, replaced by a weaker sign, or invisible."""
TICK = "fault table"
ARMING = "before arming"
DRIVE = "the drive itself"
LOOP = "loop and recorder"
FILES = "files"
"""Places where a row is judged."""


class Row(NamedTuple):
    """A row of the catalogue.

    Attributes:
        id: of the row.
        title: the failure.
        where: place where the row is judged.
        mit: visibility with the MIT protocol: detected, "replaced: SIGN" or "lost: REASON".
        odrive: visibility with ODrive.
        cia402: visibility with CiA 402.
        ticks: latest reaction in ticks, plus ``ms``.
        ms: time in addition to ``ticks`` [ms].
        odrive_ms: additional time of an ODrive, with a heartbeat every 100 ms [ms].
        required: ticks of 5 ms for an ideal drive in the project's fault catalogue. 0: no time is
            given, as before torque.
        why: reason for more ticks than ``required``, else empty.
        tested: ``campaign``, or the test with the fault.
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
    required: int = 0
    why: str = ""
    tested: str = "campaign"

    def latest_ms(self, rate_hz: float) -> float:
        """Return the latest reaction at a control rate [ms]. An ODrive may take ``odrive_ms`` more."""
        return self.ticks * 1e3 / rate_hz + self.ms


@dataclass(frozen=True, slots=True)
class Fault:
    """A row judged in every tick, or a stage of the row.

    Attributes:
        id: row of the catalogue, followed by a letter if the row has stages.
        title: name for an operator.
        detection: condition of the fault.
        action: reaction.
        clears: how the fault ends, ``OPERATOR`` or ``ITSELF``.
        cause: usual causes, for the operator, in whole sentences.
        remedy: what to do about it, one line for the operator, in whole sentences.
        debounce: consecutive ticks before the fault counts.
        release: method of removing the torque in RELAX.
        per: kinds of instances, empty for a reported fault.
        name: of the single instance of ``HAND``.
        reports: kinds of bus and host events of the fault. Kinds of recorder events
            begin with ``recorder:``.
    """

    id: str
    title: str
    detection: str
    action: Action
    clears: str
    cause: str
    remedy: str
    debounce: int = 1
    release: Release = Release.LOOP
    per: tuple[str, ...] = ()
    name: str = ""
    reports: tuple[str, ...] = ()

    @property
    def reaction(self) -> str:
        """Return the action as in the tables, with the method of relaxing."""
        return self.release.value if self.action == Action.RELAX else self.action.name

    @property
    def latched(self) -> bool:
        """Return True if the action stays until an operator clears the fault."""
        return self.clears == OPERATOR

    @property
    def row(self) -> str:
        """Return the row of the catalogue, without the stage."""
        # Stages are marked by a letter a to d behind the two digits.
        return self.id.rstrip("abcd")


CATALOGUE: list[Row] = []
"""All rows, in the order of their declaration."""
TABLE: list[Fault] = []
"""All faults, in the order of their declaration."""
DETECTOR_ROWS: list[tuple[Fault, str]] = []
"""Fault and kind of instance of each row of the detectors' result table. The kinds of a fault follow each other."""


def row(*args: object, **details: object) -> None:
    """Declare a row of the catalogue. Arguments: see ``Row``."""
    CATALOGUE.append(Row(*args, **details))  # type: ignore[arg-type]


def fault(
    id_: str,
    title: str,
    detection: str,
    action: Action,
    clears: str,
    *per: str,
    cause: str,
    remedy: str,
    debounce: int = 1,
    release: Release = Release.LOOP,
    name: str = "",
    reports: tuple[str, ...] = (),
) -> int:
    """Declare a fault. Arguments: see ``Fault``.

    Returns:
        Row index of the fault's first kind of instance in the detectors' result table. -1 for a
            reported fault.
    """
    declared = Fault(id_, title, detection, action, clears, cause, remedy, debounce, release, per, name, reports)
    TABLE.append(declared)
    # One detector row for each kind of instance. Detectors use the index of the first kind plus 1.
    first = len(DETECTOR_ROWS)
    DETECTOR_ROWS.extend((declared, kind) for kind in per)
    return first if per else -1
