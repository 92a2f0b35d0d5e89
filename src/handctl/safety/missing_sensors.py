"""Faults that cannot be detected without optional sensors, for ``handctl config check``."""

from handctl.hand.description import Hand
from handctl.hand.file.error_text import shortened_list

NEED_LOAD_CELL = ("N02", "N14b", "T03b", "T04a", "T04b", "T05", "T05b", "T06", "T09")
"""Faults that are not detected for a tendon without load cell.

These faults compare a load cell with the motor, or concern the load cell itself. Without a load
cell, the faults T01, T02, T03, T08 and N06 use the estimated tension. The limits of these five
faults are then stricter by two standard deviations of the estimate. The fault N16 then uses the torque that the
drive reports.
"""
NEED_ENCODERS = ("N06a", "N06b", "T08")
"""Faults that are not detected for a tendon whose joints have no encoders."""


def sensing_warnings(hand: Hand) -> tuple[str, ...]:
    """Return one line per missing kind of sensor, with the faults that cannot be detected without this sensor."""
    lines = []
    tendons = hand.tendon_names
    if bare := [name for name, has in zip(tendons, hand.has_cell.tolist(), strict=True) if not has]:
        text = "no load cell: its tension is that of motor, encoder and friction"
        lines.append(f"{shortened_list(bare)}: {text}; not judged: {', '.join(NEED_LOAD_CELL)}")
        if unread := [name for name in bare if not hand.tendons_with_encoders[tendons.index(name)]]:
            text = "neither load cell nor joint encoders"
            lines.append(
                f"{shortened_list(unread)}: {text}; not judged: {', '.join(NEED_ENCODERS)}"
            )
    return tuple(lines)
