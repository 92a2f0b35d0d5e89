"""Faults that cannot be detected without optional sensors, for ``handctl config check``."""

from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.hand.description import Hand
from handctl.hand.file.error_text import shortened_list
from handctl.safety.faults.table import FAULT_TABLE

FAULTS_NEEDING_LOAD_CELL = tuple(fault.id for fault in FAULT_TABLE if fault.needs_load_cell)
"""Faults that are not detected for a tendon without load cell.

The faults in the list are a difference between load cell and motor, or a failure of the load cell
itself. Without a load cell, the faults T01, T02, T03, T08 and N06 use the estimated tension.
Without a load cell, the limits of the faults T01, T02, T03, T08 and N06 are stricter by two
standard deviations of the estimate, and the fault N16 uses the torque that the drive reports.
"""
FAULTS_NEEDING_TORQUE_IN_REPLY = tuple(
    fault.id for fault in FAULT_TABLE if fault.shows_torque_after_cut
)
"""Faults that are not detected without load cell if the drive sends its torque in a separate frame.

A drive that sends its torque in a separate frame sends no torque after a cut of the torque.
"""
FAULTS_NEEDING_ENCODERS = tuple(fault.id for fault in FAULT_TABLE if fault.needs_joint_encoders)
"""Faults that are not detected for a tendon whose joints have no encoders."""


def sensing_warnings(hand: Hand) -> tuple[str, ...]:
    """Return one line for each kind of sensor that some tendons lack.

    Each line lists the faults that cannot be detected without the missing sensors.
    """
    lines = []
    tendons = hand.tendon_names
    if tendons_without_cell := [
        name for name, has in zip(tendons, hand.has_cell.tolist(), strict=True) if not has
    ]:
        text = "no load cell: its tension is that of motor, encoder and friction"
        lines.append(
            f"{shortened_list(tendons_without_cell)}: {text}; not judged: {', '.join(FAULTS_NEEDING_LOAD_CELL)}"
        )
        if without_torque := [
            name
            for name in tendons_without_cell
            if PROTOCOL_TRAITS[hand.motor_of_tendon(name).protocol].has_separate_torque_frame
        ]:
            text = "no load cell, and its drive sends no torque after a cut"
            lines.append(
                f"{shortened_list(without_torque)}: {text}; not judged: {', '.join(FAULTS_NEEDING_TORQUE_IN_REPLY)}"
            )
        if unread := [
            name
            for name in tendons_without_cell
            if not hand.tendons_with_encoders[tendons.index(name)]
        ]:
            text = "neither load cell nor joint encoders"
            lines.append(
                f"{shortened_list(unread)}: {text}; not judged: {', '.join(FAULTS_NEEDING_ENCODERS)}"
            )
    return tuple(lines)
