"""Change of gains while the controller runs, without a jump in torque.

The design of one control loop takes about a millisecond, so a running controller designs one loop
in each tick. When all loops are designed, the controller switches all loops to the new gains in the
same tick. At the switch to the new gains, the motor forces computed with the old gains and with the
new gains differ. The controller adds the difference of old and new motor forces to the new motor
forces as an offset, which decays to zero (bumpless transfer). The integrals of the control loops
are forces in newtons, so the integrals need no conversion at the switch.
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

MAX_CACHED_DESIGNS = 8
"""Number of designs in the cache: for present gains, for pending gains, and for some earlier gains to return to."""


class DesignProgress(NamedTuple):
    """Result of a design step that did not complete the design of the controller.

    The design is still in progress, or has failed.

    Attributes:
        pending_gains: state of the design, or None if no stabilising gains exist for the requested
            values.
        events: events which report that the design has failed.
    """

    pending_gains: PendingGains | None
    events: tuple[TickEvent, ...] = ()


@dataclass(slots=True)
class DesignCache:
    """Cache of controller designs.

    The gains are the keys of the cache. The cache drops old designs, and computes a dropped design
    again if the controller needs it.

    Attributes:
        loop_designs: control loops that are designed so far, for each of the last ``MAX_CACHED_DESIGNS``
            sets of requested gains.
        controllers: controllers whose design is complete.
        gains_in_use: gains of the controller that was returned last.
    """

    loop_designs: dict[Gains, list[Vector]] = field(default_factory=dict)
    controllers: dict[Gains, Any] = field(default_factory=dict)
    gains_in_use: Gains | None = None

    def design_next_loop(
        self, model: HandModel, pending_gains: PendingGains
    ) -> DesignProgress | None:
        """Design one more control loop for pending gains.

        When the design is complete, return None.
        """
        try:
            check_tendon_names(pending_gains.gains, model.tendon_constants.names)
            loop_designs = self._design_missing_loops(
                model, pending_gains.gains, pending_gains.designed_loop_count + 1
            )
        except ConfigError as error:
            return DesignProgress(
                None, (TickEvent("warn", "gains", "", f"{REFUSAL_EVENT_PREFIX}{error}"),)
            )
        if len(loop_designs) >= control_loop_count(model.tendon_constants):
            return None
        return DesignProgress(
            replace(pending_gains, designed_loop_count=pending_gains.designed_loop_count + 1)
        )

    def controller(self, controller: ControllerT, gains: Gains) -> ControllerT:
        """Return a copy of a controller in which ``gains`` replace the present gains.

        The designed controller for ``gains`` stays in the cache, for later changes of gains.
        """
        self.gains_in_use = gains
        if gains not in self.controllers:
            old_controller: Any = controller
            model = old_controller.model
            loop_designs = self._design_missing_loops(
                model, gains, control_loop_count(model.tendon_constants)
            )
            designed_model = replace(
                model,
                gains=gains,
                motion_design=combine_loop_designs(model.tendon_constants, loop_designs),
            )
            self.controllers[gains] = replace(
                old_controller,
                model=designed_model,
                reusable_constants=old_controller.derived_constants,
            )
        controller_with_gains: ControllerT = self.controllers[gains]
        return controller_with_gains

    def _design_missing_loops(
        self, model: HandModel, gains: Gains, loop_count: int
    ) -> list[Vector]:
        """Design the missing ones of the first ``loop_count`` control loops, and return all designed loops."""
        loop_designs = self.loop_designs.setdefault(gains, [])
        if len(self.loop_designs) > MAX_CACHED_DESIGNS:
            # A dictionary keeps the order of insertion, so the first entry is the oldest entry. The
            # entry of the gains in use is kept.
            least_recent_gains = next(
                designed_gains
                for designed_gains in self.loop_designs
                if designed_gains != self.gains_in_use
            )
            self.controllers.pop(least_recent_gains, None)
            del self.loop_designs[least_recent_gains]
        while len(loop_designs) < loop_count:
            loop_designs.append(
                design_control_loop(model.tendon_constants, gains, model.period, len(loop_designs))
            )
        return loop_designs


def begin_gain_design(
    present_gains: Gains, new_values: dict[str, float]
) -> tuple[PendingGains | None, tuple[TickEvent, ...]]:
    """Begin the controller design for requested gains.

    Args:
        present_gains: present gains.
        new_values: requested values, by the key of the gain.

    Returns:
        The requested gains with the state of their design. If no design can begin, the result is
        None and an event with the reason.
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
