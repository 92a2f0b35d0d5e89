"""Types for faults and for rows of the fault catalogue, and functions that declare faults and rows.

A row of the fault catalogue describes a possible failure. A fault is a condition that the
controller checks in every tick. Each fault belongs to one row of the fault catalogue. A row can
have several faults, such as B11a and B11b, which are called the stages of the row. The modules
``bus``, ``node``, ``tendon`` and ``host`` declare the catalogue rows and the faults. Each
declaration is the only source of four things: the tables in the documents, the deadlines in the
tests that inject faults, the event texts, and the reactions.

A fault is either detected by compiled code in ``core.detectors``, or reported by a bus, the host or
the recorder. The argument ``fault_places`` of ``declare_fault`` lists the kinds of parts that a
detected fault can affect, such as motors or tendons. The argument ``reports`` lists the events that
report a fault. The function ``declare_fault`` returns an index: the row of the evidence table in
which the detectors store their results about the fault. For example, N07_NOISY_ENCODER is the index
in ``evidence[N07_NOISY_ENCODER, motor]``.
"""

from dataclasses import dataclass
from typing import NamedTuple

from handctl.safety.safety_action import RelaxMethod, SafetyAction

CLEARED_BY_OPERATOR = "by the operator"
CLEARED_BY_ITSELF = "by itself"
"""Ways in which a fault ends. The operator clears a latched fault.

A fault that is not latched ends by itself when its cause ends.
"""

FAULT_PLACE_TENDON = "tendon"
FAULT_PLACE_MOTOR = "motor"
FAULT_PLACE_JOINT = "joint"
FAULT_PLACE_NODE = "node"
FAULT_PLACE_HAND = "hand"
"""Kinds of parts that a fault can affect.

``FAULT_PLACE_NODE`` includes motors and the sensor node. A fault of ``FAULT_PLACE_HAND`` has a single instance.
"""

VISIBLE_FAULT = "detected"
INDIRECTLY_VISIBLE = "replaced"
INVISIBLE_FAULT = "lost"
"""Visibility of a fault with a protocol: detected, replaced by a weaker sign, or not visible."""
CHECKED_BY_FAULT_TABLE = "fault table"
CHECKED_BEFORE_ARMING = "before arming"
CHECKED_BY_DRIVE = "the drive itself"
CHECKED_BY_CONTROL_LOOP = "loop and recorder"
CHECKED_BY_FILE_READERS = "files"
"""Parts of handctl that check a row of the catalogue."""


class CatalogueRow(NamedTuple):
    """Row of the fault catalogue, which describes a possible failure.

    Attributes:
        id: identifier of the row.
        title: name of the failure.
        checked_by: the part of handctl that checks the row of the catalogue.
        mit: visibility with the MIT protocol: detected, "replaced: SIGN" or "lost: REASON".
        odrive: visibility with ODrive.
        cia402: visibility with CiA 402.
        ticks: the part of the longest reaction time that is counted in ticks. The longest reaction
            time is the sum of ``ticks`` and ``ms``.
        ms: the part of the longest reaction time that does not depend on the tick [ms]. The longest
            reaction time is the sum of ``ticks`` and ``ms``.
        odrive_extra_ms: additional reaction time with an ODrive [ms], because the heartbeat of an ODrive
            has a period of 100 ms.
        required_ticks: reaction time that the project's fault catalogue requires with an ideal drive
            [ticks of 5 ms]. The value is 0 if the catalogue gives no reaction time, for example for
            a fault before any torque.
        why: the reason why ``ticks`` is larger than ``required_ticks``, or an empty text.
        tested_by: ``campaign``, or the name of the test that covers the fault.
        moteus: visibility with moteus. The text is empty if the visibility equals ``mit``, because
            both protocols answer each command once.
        robstride: visibility with RobStride. The text is empty if the visibility equals ``mit``.
        reaction_time_start: event from which the longest reaction time counts, as a clause that can
            follow the word "after". The text is empty if the reaction time counts from the failure
            itself.
    """

    id: str
    title: str
    checked_by: str = CHECKED_BY_FAULT_TABLE
    mit: str = VISIBLE_FAULT
    odrive: str = VISIBLE_FAULT
    cia402: str = VISIBLE_FAULT
    ticks: int = 0
    ms: float = 0.0
    odrive_extra_ms: float = 0.0
    required_ticks: int = 0
    why: str = ""
    tested_by: str = "campaign"
    moteus: str = ""
    robstride: str = ""
    reaction_time_start: str = ""

    def visibility(self, protocol: str) -> str:
        """Return the visibility of the failure with a drive protocol: detected, replaced by a weaker sign, or lost.

        The argument ``protocol`` is one of ``VERIFIABLE_PROTOCOLS``.
        """
        visibility: str = getattr(self, protocol)
        return visibility or self.mit

    def max_reaction_time_ms(self, rate_hz: float) -> float:
        """Return the longest permitted time from the failure to the reaction at the control rate ``rate_hz`` [ms].

        With an ODrive, the reaction is permitted to take ``odrive_extra_ms`` longer than the
        returned time.
        """
        return self.ticks * 1e3 / rate_hz + self.ms


@dataclass(frozen=True, slots=True)
class Fault:
    """Fault that the controller checks in every tick.

    Each fault belongs to one row of the fault catalogue. A row can have several faults, which are
    called the stages of the row.

    Attributes:
        id: identifier of the row, followed by a letter if the row has stages.
        title: name of the fault for an operator.
        detection: condition of the fault.
        action: reaction to the fault.
        cleared_by: the way in which the fault ends, ``CLEARED_BY_OPERATOR`` or ``CLEARED_BY_ITSELF``.
        cause: usual causes, for the operator, in whole sentences.
        remedy: instruction for the operator in one line, in whole sentences.
        debounce_ticks: number of consecutive ticks with the fault after which the fault becomes active.
        relax_method: method of removing the motor torque if the action is RELAX.
        fault_places: kinds of parts that the fault can affect. The value is empty for a reported fault.
        name: name of the only instance, if the fault has the kind ``FAULT_PLACE_HAND``.
        reports: kinds of bus and host events that report the fault. Kinds of recorder events begin
            with ``recorder:``.
        makes_tension_unreliable: True if the fault makes it possible that the true tension is
            larger than the measured tension.
        caused_by_lateness: True if late answers of drives, late sensor frames or late ticks can
            latch the fault.
        shows_torque_after_cut: True if the fault shows that a motor still makes torque after a cut
            of the torque.
        needs_load_cell: True if the fault cannot be detected for a tendon without a load cell.
        needs_joint_encoders: True if the fault cannot be detected for a tendon whose joints have no
            encoders.
    """

    id: str
    title: str
    detection: str
    action: SafetyAction
    cleared_by: str
    cause: str
    remedy: str
    debounce_ticks: int = 1
    relax_method: RelaxMethod = RelaxMethod.TENSION_LOOP
    fault_places: tuple[str, ...] = ()
    name: str = ""
    reports: tuple[str, ...] = ()
    makes_tension_unreliable: bool = False
    caused_by_lateness: bool = False
    shows_torque_after_cut: bool = False
    needs_load_cell: bool = False
    needs_joint_encoders: bool = False

    @property
    def reaction_name(self) -> str:
        """Return the name of the reaction for tables. For the reaction RELAX, the name includes the relax method."""
        return self.relax_method.value if self.action == SafetyAction.RELAX else self.action.name

    @property
    def is_latched(self) -> bool:
        """Return True if the reaction lasts until an operator clears the fault."""
        return self.cleared_by == CLEARED_BY_OPERATOR

    @property
    def row(self) -> str:
        """Return the identifier of the fault's catalogue row: B11 for the faults B11a and B11b."""
        # A stage has a letter from a to d behind the two digits of the identifier.
        return self.id.rstrip("abcd")


DECLARED_ROWS: list[CatalogueRow] = []
"""All rows of the fault catalogue, in the order of their declaration."""
DECLARED_FAULTS: list[Fault] = []
"""All faults, in the order of their declaration."""
DETECTOR_ROWS: list[tuple[Fault, str]] = []
"""Fault and kind of part for each row of the evidence table, in which the detectors store their results.

If a fault can affect several kinds of parts, the rows of these kinds are adjacent.
"""


def declare_catalogue_row(*args: object, **details: object) -> None:
    """Declare a row of the fault catalogue. For the arguments see ``CatalogueRow``."""
    DECLARED_ROWS.append(CatalogueRow(*args, **details))  # type: ignore[arg-type]


def declare_fault(
    fault_id: str,
    title: str,
    detection: str,
    action: SafetyAction,
    cleared_by: str,
    *fault_places: str,
    cause: str,
    remedy: str,
    debounce_ticks: int = 1,
    relax_method: RelaxMethod = RelaxMethod.TENSION_LOOP,
    name: str = "",
    reports: tuple[str, ...] = (),
    makes_tension_unreliable: bool = False,
    caused_by_lateness: bool = False,
    shows_torque_after_cut: bool = False,
    needs_load_cell: bool = False,
    needs_joint_encoders: bool = False,
) -> int:
    """Declare a fault. For the arguments see ``Fault``.

    Returns:
        First row of the fault in the evidence table, or -1 for a
        reported fault, which has no detector.
    """
    fault = Fault(
        fault_id,
        title,
        detection,
        action,
        cleared_by,
        cause,
        remedy,
        debounce_ticks,
        relax_method,
        fault_places,
        name,
        reports,
        makes_tension_unreliable,
        caused_by_lateness,
        shows_torque_after_cut,
        needs_load_cell,
        needs_joint_encoders,
    )
    DECLARED_FAULTS.append(fault)
    # A fault can affect several kinds of parts, such as tendons and joints. In the table of the
    # detectors' results, a fault of tendons and joints has one row for tendons and one row for
    # joints. For the second kind of part, detectors add 1 to the row of the first kind.
    first_row = len(DETECTOR_ROWS)
    DETECTOR_ROWS.extend((fault, kind) for kind in fault_places)
    return first_row if fault_places else -1
