"""How much tension may be asked now: less of a warm drive, and no more than there is while safety holds."""

from collections.abc import Sequence

import numpy as np

from handctl.controller.state import State
from handctl.core.estimation import touch
from handctl.core.model import HandModel
from handctl.core.types import Mode, Vector
from handctl.safety.action import Action
from handctl.safety.signals import Limits

HELD_MARGIN_N = 1.0
"""Above the tension that safety holds: about what the estimate may be wrong by."""


def derated(model: HandModel, limits: Limits, temperatures: Sequence[float]) -> Vector | None:
    """Largest tension of each rope by its drive's temperature: all up to the soft limit, the floor at the hard one.

    Args:
        model: the hand.
        limits: of temperature.
        temperatures: (N,) of the drives [degC], NaN where a drive tells none.

    Returns:
        (N,) [N], or None as long as no drive is warm.
    """
    soft = limits.temperature_soft
    if True not in [temperature > soft for temperature in temperatures]:
        return None
    known = np.array([t if t == t else limits.temperature_soft for t in temperatures])
    share = (limits.temperature_hard - known) / (limits.temperature_hard - limits.temperature_soft)
    return np.asarray(model.floor + np.minimum(np.maximum(share, 0.0), 1.0) * (model.ceiling - model.floor))


def restraints(
    model: HandModel, limits: Limits, state: State, action: Action, tension: Vector
) -> tuple[Vector | None, Vector | None]:
    """What limits the tensions of this tick besides the hand itself.

    Args:
        model: the hand. limits: of safety.
        state: with what was received in this tick.
        action: what safety demands.
        tension: (N,) now [N].

    Returns:
        (N,) largest tension that warm drives and blocked digits allow [N], and what there was when safety began to
        hold [N]; None each as long as no drive is warm and no digit blocked, and while safety does not hold.
    """
    most = derated(model, limits, [drive.temperature for drive in state.drives])
    most = touch.gentle(model, state.touch, state.law.planned, most)
    if action != Action.HOLD or state.mode != Mode.ACTIVE:
        return most, None
    before = state.law.held
    return most, before if before is not None else np.maximum(tension, model.floor) + HELD_MARGIN_N
