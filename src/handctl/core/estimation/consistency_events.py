"""Log events for changes of two states: the consistency of a tendon's model, and the blocking of a digit.

The model of a tendon is consistent if it agrees with the measurements of the tendon.
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from handctl.core.estimation.kalman import NIS_AVERAGING_TIME_S
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent


class NamedFields(Protocol):
    """State block whose fields are read by name."""

    def view(self, name: str) -> NDArray[Any]:
        """Return the array of the field with the given name."""
        ...


def consistency_events(
    model: HandModel, fields_before: NamedFields, fields_after: NamedFields
) -> tuple[TickEvent, ...]:
    """Return the log events for tendons and digits whose state has changed between two ticks.

    Args:
        model: model of the hand.
        fields_before: state of the controller after the last tick.
        fields_after: state of the controller in the present tick.
    """
    events: list[TickEvent] = []
    is_inconsistent = fields_after.view("doubtful")
    previous = fields_before.view("doubtful")
    if (is_inconsistent != previous).any():
        for n in np.flatnonzero(is_inconsistent != previous).tolist():
            name = model.hand.tendon_names[n]
            nis = fields_after.view("nis_mean")[n]
            verdict = (
                "the estimate is not to be trusted"
                if is_inconsistent[n]
                else "the estimate is good again"
            )
            text = f"{name}: NIS {nis:.1f} over {NIS_AVERAGING_TIME_S:g} s, 2 is right: {verdict}"
            events.append(
                TickEvent("warn" if is_inconsistent[n] else "info", "estimate", name, text)
            )
    is_blocked = fields_after.view("blocked")
    previous = fields_before.view("blocked")
    if (is_blocked != previous).any():
        planned_contact = fields_after.view("planned_contact")
        for d in np.flatnonzero((is_blocked != previous) & (planned_contact == 0)).tolist():
            name = model.hand.digit_names[d]
            tension = fields_after.view("touch")[d]
            text = f"{name} is blocked: {tension:.1f} N of unexplained tension"
            events.append(
                TickEvent(
                    "info", "blocked", name, text if is_blocked[d] else f"{name} is free again"
                )
            )
    return tuple(events)
