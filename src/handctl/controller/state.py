"""The whole state of a controller: small, frozen, and hashed into the log each tick."""

from typing import NamedTuple

from handctl.controller import digest as packing
from handctl.controller.monitor.motors import Motors
from handctl.controller.retune import Coming
from handctl.core.estimation.filter_state import FilterState
from handctl.core.estimation.posture import Posture
from handctl.core.estimation.touch import Touch
from handctl.core.gains.gains import Gains
from handctl.core.law.computed_torque import LawState
from handctl.core.types import Mode
from handctl.drives.contract import DriveState
from handctl.drives.sensors.node import SensorState
from handctl.programs.program import Progress
from handctl.safety.judge import SafetyState
from handctl.safety.watch import WatchState


class State(NamedTuple):
    """Everything that one tick hands to the next.

    Attributes:
        k: number of the last tick; -1 before the first.
        mode: of the hand.
        mode_since: when it began [s].
        goal_time: time that the program has been given [s]; stands still while safety holds.
        armed: a person (or the run's own task) has asked to arm.
        clearing: a person has ordered that what the drives have latched be cleared, before they are armed.
        drives: per motor.
        sensors: the sensor node.
        filter: the tension filter.
        law: the controller.
        progress: of the program.
        safety: debounce and latches.
        watch: what safety remembers besides.
        touch: what is felt of each digit, planned or not.
        posture: joint angles beside those of the free digit.
        failure: why the run ends early, one line; empty if it does not.
        unconfirmed: motors that have not confirmed that they are disabled.
        gains: that a person has set since the start; None before.
        coming: gains that are asked for and being designed.
    """

    k: int
    mode: Mode
    mode_since: float
    goal_time: float
    armed: bool
    drives: tuple[DriveState, ...]
    sensors: SensorState
    filter: FilterState
    law: LawState
    progress: Progress
    safety: SafetyState
    watch: WatchState
    touch: Touch
    posture: Posture
    failure: str = ""
    unconfirmed: tuple[str, ...] = ()
    clearing: bool = False
    gains: Gains | None = None
    coming: Coming | None = None

    def digest(self, motors: Motors | None = None) -> bytes:
        """8 bytes that change with every part of the state; ``motors``: the drives as columns, if they are at hand."""
        place = (self.k, self.mode, self.mode_since, self.goal_time, self.armed, self.clearing)
        return packing.digest(
            packing.PLACE.pack(*place),
            packing.words((self.failure, self.unconfirmed, self.safety.counting, self.safety.latched)),
            packing.filter_bytes(self.filter),
            packing.law_bytes(self.law),
            packing.sensor_bytes(self.sensors),
            packing.progress_bytes(self.progress),
            packing.watch_bytes(self.watch),
            packing.touch_bytes(self.touch),
            packing.posture_bytes(self.posture),
            packing.gains_bytes(self.gains),
            packing.gains_bytes(self.coming),
            packing.motor_bytes(motors or Motors.of(self.drives)),
        )
