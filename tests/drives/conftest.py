"""Test fixtures: a drive object of handctl, and a model of the motor that this object controls.

The fixtures call the drive object once per tick, as the controller does.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from handctl.drives.contract import DrivePhase, DriveState, DriveTarget
from handctl.drives.frame import Frame
from handctl.drives.mit.drive import MitDrive
from tests.drives.scripted_motor import ScriptedMotor

PERIOD_NS = 2_000_000


@dataclass(frozen=True)
class MotorSection:
    """Keys and values of a ``[[motor]]`` section of a hand file."""

    name: str = "index_motor"
    protocol: str = "mit"
    node_id: int = 1
    position_range_rad: float = 12.5
    velocity_range_rad_s: float = 50.0
    torque_max_N_m: float = 0.8
    direction: int = 1
    zero_rad: float = 0.0
    watchdog_ms: float = 50
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class MotorRig:
    """A drive object of handctl, the state of this object, and the motor that the object controls.

    Each tick advances the time by one control period.
    """

    drive: MitDrive
    motor: ScriptedMotor
    state: DriveState
    t_ns: int = 0
    sent_frames: list[Frame] = field(default_factory=list)
    pending_replies: list[Frame] = field(default_factory=list)

    def tick(self, target: DriveTarget, torque: float = 0.0) -> DriveState:
        """Let the drive receive the frames that the motor has sent, and advance the drive by a tick.

        After the tick, the motor makes the reply frames for the next tick.
        """
        for frame in self.pending_replies:
            self.state = self.drive.receive(self.state, frame)
        self.state, frames = self.drive.advance(self.state, self.t_ns, target, torque)
        self.sent_frames += frames
        self.pending_replies = [
            reply
            for frame in frames
            for reply in self.motor.answer_frame(frame, self.t_ns + 300_000)
        ]
        self.t_ns += PERIOD_NS
        return self.state

    def run_until_phase(
        self, target: DriveTarget, *phases: DrivePhase, max_ticks: int = 300
    ) -> DriveState:
        """Run ticks until the drive is in one of the given drive phases.

        If the drive does not reach any of the given drive phases, the test fails.
        """
        for _ in range(max_ticks):
            if self.tick(target).phase in phases:
                return self.state
        pytest.fail(
            f"{self.state.phase.name} after {max_ticks} ticks, expected {[phase.name for phase in phases]}"
        )


@pytest.fixture
def rig() -> MotorRig:
    drive = MitDrive.from_motor(MotorSection(), 0)
    return MotorRig(drive, ScriptedMotor(), drive.initial_state())


def make_mit_drive(**section_changes: object) -> MitDrive:
    return MitDrive.from_motor(replace(MotorSection(), **section_changes), 0)  # type: ignore[arg-type]
