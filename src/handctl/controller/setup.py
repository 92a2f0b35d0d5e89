"""Putting a controller together from data, so that a log can put the same one together again."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from handctl.controller.tick import Controller
from handctl.core.gains.gains import Gains
from handctl.core.identified import identified_hand, torque_gain
from handctl.core.model import HandModel
from handctl.document import Document
from handctl.drives.contract import Drive
from handctl.drives.identifiers import check_identifiers
from handctl.drives.registry import make_drive
from handctl.drives.sensors.node import SensorNode
from handctl.hand.description import Hand
from handctl.hand.load import hand_from, parse_toml
from handctl.programs.calibration import Calibration
from handctl.programs.commission import CommissionProgram
from handctl.programs.excite import ExciteProgram, ExciteStep
from handctl.programs.exercise import Exercise
from handctl.programs.grasp import TaskProgram
from handctl.programs.live import JogProgram, LiveProgram
from handctl.programs.playback import PlaybackProgram, Recording
from handctl.programs.program import Program
from handctl.programs.requests import HoldTension, MoveDigits
from handctl.programs.task import Task

ATTACHMENT = "setup.json"
"""Name under which a log keeps its ``Setup``."""


class TaskSetup(Document):
    """A task file's program."""

    program: Literal["task"] = "task"
    task: Task


class LiveSetup(Document):
    """Waits for requests."""

    program: Literal["live"] = "live"


class JogSetup(Document):
    """One goal for a while."""

    program: Literal["jog"] = "jog"
    request: Annotated[MoveDigits | HoldTension, Field(discriminator="do")]
    duration_s: float


class CommissionSetup(Document):
    """Commissioning."""

    program: Literal["commission"] = "commission"


class PlaybackSetup(Document):
    """A recorded run done again; ``rows`` is ``Recording.text``."""

    program: Literal["playback"] = "playback"
    raw: bool
    rows: str


class ExerciseSetup(Document):
    """The exercise by which gains are judged."""

    program: Literal["exercise"] = "exercise"
    amplitudes: tuple[float, ...]


class ExciteSetup(Document):
    """Identification."""

    program: Literal["excite"] = "excite"
    steps: tuple[ExciteStep, ...]


AnySetup = TaskSetup | LiveSetup | JogSetup | CommissionSetup | PlaybackSetup | ExerciseSetup | ExciteSetup
ProgramSetup = Annotated[AnySetup, Field(discriminator="program")]


class Setup(Document):
    """What a controller was made from besides the hand and the gains; floats read back bit for bit."""

    schema_: int = Field(1, alias="schema", ge=1, le=1)
    rate_hz: float = Field(gt=0, le=100_000)
    arm_at_once: bool
    tare_N: tuple[float, ...]
    """(N,) load-cell tare, in the order of the tendons."""
    zero_rad: tuple[Annotated[float, Field(ge=-1000, le=1000)], ...]
    """(N,) motor zero, as far as a calibration may have it."""
    identities: tuple[str, ...] = ()
    """Of the drives that the calibration was made with; empty: unknown."""
    program: ProgramSetup
    identified_hand: str = ""
    """The hand as identified, TOML; empty: as its file says."""
    torque_gain: tuple[float, ...] = ()
    """(N,) as identified; empty: 1."""

    @staticmethod
    def of(controller: Controller, rate_hz: float) -> "Setup":
        """Setup of a controller that runs at ``rate_hz`` [Hz]."""
        return Setup(
            rate_hz=rate_hz,
            arm_at_once=controller.arm_at_once,
            tare_N=tuple(controller.tare.tolist()),
            zero_rad=tuple(controller.zero.tolist()),
            identities=controller.identities,
            program=_described(controller.program),
            identified_hand="" if controller.model.torque_gain is None else controller.model.hand.to_toml(),
            torque_gain=() if controller.model.torque_gain is None else tuple(controller.model.torque_gain.tolist()),
        )

    def controller(self, hand: Hand, gains: Gains) -> Controller:
        """The controller again; designs all gains."""
        identified = parse_toml(self.identified_hand, ATTACHMENT)
        known = hand_from(identified, ATTACHMENT) if identified else hand
        model = HandModel.of(known, gains, self.rate_hz, np.array(self.torque_gain) if self.torque_gain else None)
        tare, zero = np.array(self.tare_N), np.array(self.zero_rad)
        drives, sensors = make_drives(hand), make_sensors(hand)
        controller = Controller(model, drives, sensors, _made(self.program, hand), tare, zero, self.arm_at_once)
        return replace(controller, identities=self.identities)


def caveats(drives: Iterable[Drive]) -> tuple[str, ...]:
    """Guards of drives that no read-back can verify, a line each, for a person to read before arming."""
    return tuple(f"{drive.name}: {text}" for drive in drives for text in drive.caveats)


def make_drives(hand: Hand) -> tuple[Drive, ...]:
    """The motor of each tendon, in the order of the tendons.

    Raises:
        ConfigError: an option that a drive does not have, or an identifier with two meanings.
    """
    buses = hand.bus_names
    motors = [hand.motor_of(name) for name in hand.tendon_names]
    drives = tuple(make_drive(motor, buses.index(motor.bus)) for motor in motors)
    named = [(f"motor[{drive.name}].node_id", drive) for drive in drives]
    check_identifiers([("sensor_node.base_id", make_sensors(hand)), *named])
    return drives


def make_sensors(hand: Hand) -> SensorNode:
    """The hand's sensor node."""
    return SensorNode.of(hand.sensor_node, hand.bus_names.index(hand.sensor_node.bus), hand.tendon_names, hand.joints)


def make_controller(
    hand: Hand, gains: Gains, rate_hz: float, program: Program, calibration: Calibration | None, arm_at_once: bool
) -> Controller:
    """Design the gains and put the controller together; without a calibration nothing is tared.

    What a calibration has identified takes the place of what the hand file says; drives and limits stay the file's.
    """
    n = len(hand.tendon)
    tare = calibration.tare(hand) if calibration else np.zeros(n)
    zero = calibration.zero(hand) if calibration else np.zeros(n)
    found = calibration.identified if calibration else {}
    gain = torque_gain(hand, found) if found else None
    model = HandModel.of(identified_hand(hand, found) if found else hand, gains, rate_hz, gain)
    drives, sensors = make_drives(hand), make_sensors(hand)
    controller = Controller(model, drives, sensors, program, tare, zero, arm_at_once)
    known = calibration.drive if calibration else {}
    return replace(controller, identities=tuple(known.get(drive.name, "") for drive in drives) if known else ())


def _described(program: Program) -> AnySetup:
    match program:
        case TaskProgram(task):
            return TaskSetup(task=task)
        case JogProgram(request, duration):
            return JogSetup(request=request, duration_s=duration)
        case PlaybackProgram(recording, raw):
            return PlaybackSetup(raw=raw, rows=recording.text())
        case ExciteProgram(steps):
            return ExciteSetup(steps=steps)
        case CommissionProgram():
            return CommissionSetup()
        case Exercise(amplitudes):
            return ExerciseSetup(amplitudes=amplitudes)
        case LiveProgram():
            return LiveSetup()
    raise TypeError(f"{type(program).__name__} cannot be written into a log")


def _made(setup: AnySetup, hand: Hand) -> Program:
    match setup:
        case TaskSetup():
            return TaskProgram(setup.task)
        case JogSetup():
            return JogProgram(setup.request, setup.duration_s)
        case PlaybackSetup():
            recording = Recording.read(setup.rows, len(hand.joints), len(hand.tendon))
            return PlaybackProgram(recording, setup.raw)
        case ExciteSetup():
            return ExciteProgram(setup.steps)
        case CommissionSetup():
            return CommissionProgram()
        case ExerciseSetup():
            return Exercise(setup.amplitudes)
        case LiveSetup():
            return LiveProgram()
