"""Change of gains while the controller runs, without a jump in torque.

The design of one control loop takes about a millisecond. Therefore a running controller designs one
loop in each tick. When all loops are designed, the controller switches all loops to the new gains
in the same tick. At the switch, the motor forces computed with the old gains and with the new gains
differ. The controller adds this difference to the new motor forces as an offset, which decays to
zero (bumpless transfer). The integrals of the control loops are forces in newtons. So the integrals
need no conversion at the switch.
"""

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

from handctl.controller.pending_gains import PendingGains
from handctl.core.gains.gain_bounds import (
    changed_gain_values,
    check_tendon_names,
    gains_with_values,
)
from handctl.core.gains.gains import Gains
from handctl.core.gains.motion_design import (
    combine_loop_designs,
    control_loop_count,
    design_control_loop,
)
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import GAIN_EVENT, TickEvent, Vector
from handctl.errors import ConfigError
from handctl.programs.requests import REFUSAL_EVENT_PREFIX

ControllerT = TypeVar("ControllerT")
"""Type variable for ``controller.tick.Controller``, or for another dataclass with a ``model``."""

CACHE_SIZE = 8
"""Number of designs in the cache: for present gains, for pending gains, and for some earlier gains to return to."""


class DesignProgress(NamedTuple):
    """Result of a design step, if the design is not complete after this step.

    Attributes:
        pending: state of the design, or None if no stabilising gains exist for the requested
            values.
        events: events which report that the design has failed.
    """

    pending: PendingGains | None
    events: tuple[TickEvent, ...] = ()


@dataclass(slots=True)
class DesignCache:
    """Cache of controller designs.

    The gains are the keys of the cache. The cache drops old designs. A dropped design is computed
    again when it is needed.

    Attributes:
        designed_pieces: control loops that are designed so far, for each of the last ``CACHE_SIZE``
            sets of requested gains.
        controllers: controllers whose design is complete.
        gains_in_use: gains of the controller that was returned last.
    """

    designed_pieces: dict[Gains, list[Vector]] = field(default_factory=dict)
    controllers: dict[Gains, Any] = field(default_factory=dict)
    gains_in_use: Gains | None = None

    def advance(self, model: HandModel, pending_gains: PendingGains) -> DesignProgress | None:
        """Design one more control loop for pending gains.

        When the design is complete, return None.
        """
        try:
            check_tendon_names(pending_gains.gains, model.space.names)
            designed_pieces = self._design_in_pieces(
                model, pending_gains.gains, pending_gains.step + 1
            )
        except ConfigError as error:
            return DesignProgress(
                None, (TickEvent("warn", "gains", "", f"{REFUSAL_EVENT_PREFIX}{error}"),)
            )
        if len(designed_pieces) >= control_loop_count(model.space):
            return None
        return DesignProgress(replace(pending_gains, step=pending_gains.step + 1))

    def controller(self, controller: ControllerT, gains: Gains) -> ControllerT:
        """Return a copy of a controller with other gains.

        The design for these gains stays in the cache.
        """
        self.gains_in_use = gains
        if gains not in self.controllers:
            old_controller: Any = controller
            model = old_controller.model
            designed_pieces = self._design_in_pieces(model, gains, control_loop_count(model.space))
            designed_model = replace(
                model, gains=gains, motion=combine_loop_designs(model.space, designed_pieces)
            )
            self.controllers[gains] = replace(
                old_controller, model=designed_model, similar_constants=old_controller.derived
            )
        controller_with_gains: ControllerT = self.controllers[gains]
        return controller_with_gains

    def _design_in_pieces(self, model: HandModel, gains: Gains, piece_count: int) -> list[Vector]:
        """Design the missing ones of the first ``piece_count`` loops, and return all designed loops."""
        designed_pieces = self.designed_pieces.setdefault(gains, [])
        if len(self.designed_pieces) > CACHE_SIZE:
            # A dictionary keeps the order of insertion, so the first entry is the oldest one. The
            # entry of the gains in use is kept.
            oldest_gains = next(
                designed_piece
                for designed_piece in self.designed_pieces
                if designed_piece != self.gains_in_use
            )
            self.controllers.pop(oldest_gains, None)
            del self.designed_pieces[oldest_gains]
        while len(designed_pieces) < piece_count:
            designed_pieces.append(
                design_control_loop(model.space, gains, model.period, len(designed_pieces))
            )
        return designed_pieces


def begin_design(
    present_gains: Gains, new_values: dict[str, float]
) -> tuple[PendingGains | None, tuple[TickEvent, ...]]:
    """Begin the controller design for requested gains.

    Args:
        present_gains: present gains.
        new_values: requested values, by the key of the gain.

    Returns:
        The requested gains with the state of their design. If no design can begin, None and an
        event with the reason.
    """
    try:
        return PendingGains(gains_with_values(present_gains, new_values, "gains", is_live=True)), ()
    except ConfigError as error:
        return None, (TickEvent("warn", "request", "", f"{REFUSAL_EVENT_PREFIX}{error}"),)


def gain_change_events(old_gains: Gains, new_gains: Gains) -> tuple[TickEvent, ...]:
    """Return one event for each changed gain, and a last event for the switch to the new gains."""
    differences = changed_gain_values(old_gains, new_gains)
    changed_tick_events = tuple(
        TickEvent("info", GAIN_EVENT, key, repr(value)) for key, (_, value) in differences.items()
    )
    return *changed_tick_events, TickEvent(
        "info", "gains", "", f"taken over: {len(changed_tick_events)} changed"
    )
