"""Construction of a controller from plain data, such as numbers and texts.

A log contains the data for the construction, so the controller of a run can be constructed again
from the log of the run.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from handctl.controller.tick import Controller
from handctl.core.calibration import Calibration
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.identified_parameters import identified_hand, torque_gain
from handctl.document import Document
from handctl.drives.canopen.codec import SYNC
from handctl.drives.cia402.drive import Cia402Drive
from handctl.drives.cia404.load_cells import Cia404LoadCells
from handctl.drives.contract import Drive
from handctl.drives.identifier_checks import check_identifiers
from handctl.drives.motor_description import PROTOCOL_TRAITS, position_loop_protocols_text
from handctl.drives.protocol_registry import make_drive
from handctl.drives.sensors.contract import SensorInterface
from handctl.drives.sensors.sensor_node import SensorNode
from handctl.drives.signals import SignalQuantity
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.file.error_text import lines_by_text
from handctl.hand.file.quantity_types import MAX_POSITION_RANGE_RAD
from handctl.hand.file.section_models import Motor
from handctl.hand.hand_loading import hand_from_content, parse_toml
from handctl.programs.commission import CommissionProgram
from handctl.programs.excitation import ExciteProgram, ExciteStep
from handctl.programs.gains_exercise import ExerciseProgram
from handctl.programs.live_session import JogProgram, LiveProgram
from handctl.programs.playback import PlaybackProgram, RecordedGoals
from handctl.programs.program import Program
from handctl.programs.requests import HoldTensionRequest, MoveDigitsRequest
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram

SETUP_ATTACHMENT_NAME = "setup.json"
"""Name of the log attachment that holds the ``RunSetup``."""


class TaskSetup(Document):
    """Set-up of a program that executes a task file."""

    program: Literal["task"] = "task"
    task: Task


class LiveSetup(Document):
    """Set-up of a program that waits for requests."""

    program: Literal["live"] = "live"


class JogSetup(Document):
    """Set-up of a program that pursues a single goal for a given time."""

    program: Literal["jog"] = "jog"
    request: Annotated[MoveDigitsRequest | HoldTensionRequest, Field(discriminator="do")]
    duration_s: float


class CommissionSetup(Document):
    """Set-up of the program that commissions the hand."""

    program: Literal["commission"] = "commission"


class PlaybackSetup(Document):
    """Set-up of a program that repeats a recorded run.

    The field ``rows`` contains the recording as text, see ``RecordedGoals.to_text``.
    """

    program: Literal["playback"] = "playback"
    raw: bool
    rows: str


class ExerciseSetup(Document):
    """Set-up of a program that moves the hand to evaluate gains."""

    program: Literal["exercise"] = "exercise"
    amplitudes: tuple[float, ...]
    turns: tuple[tuple[str, ...], ...] = ()


class ExciteSetup(Document):
    """Set-up of a program that moves the hand to identify its parameters."""

    program: Literal["excite"] = "excite"
    steps: tuple[ExciteStep, ...]


AnyProgramSetup = (
    TaskSetup | LiveSetup | JogSetup | CommissionSetup | PlaybackSetup | ExerciseSetup | ExciteSetup
)
ProgramSetup = Annotated[AnyProgramSetup, Field(discriminator="program")]


class RunSetup(Document):
    """Data for the construction of a controller, in addition to the hand and the gains.

    Floating-point numbers are stored without rounding.
    """

    schema_: int = Field(1, alias="schema", ge=1, le=1)
    rate_hz: float = Field(gt=0, le=100_000)
    arm_at_once: bool
    tare_N: tuple[float, ...]
    """(N,) load-cell tare, in the order of the tendons."""
    zero_rad: tuple[
        Annotated[float, Field(ge=-MAX_POSITION_RANGE_RAD, le=MAX_POSITION_RANGE_RAD)], ...
    ]
    """(N,) motor zero within the range of a calibration [rad]."""
    identities: tuple[str, ...] = ()
    """Identities of the drives at calibration. The tuple is empty if the identities are unknown."""
    program: ProgramSetup
    identified_hand: str = ""
    """Hand description with identified parameters, as TOML text.

    The text is empty if the values of the hand file apply.
    """
    torque_gain: tuple[float, ...] = ()
    """(N,) identified torque gains. The tuple is empty if all torque gains are 1."""

    @staticmethod
    def from_controller(controller: Controller, rate_hz: float) -> "RunSetup":
        """Return the set-up of a controller with the control rate ``rate_hz`` [Hz]."""
        return RunSetup(
            rate_hz=rate_hz,
            arm_at_once=controller.arm_at_once,
            tare_N=tuple(controller.tare_tensions.tolist()),
            zero_rad=tuple(controller.motor_zeros.tolist()),
            identities=controller.identities,
            program=_setup_of_program(controller.program),
            identified_hand=""
            if controller.model.torque_gain is None
            else controller.model.hand.to_toml(),
            torque_gain=()
            if controller.model.torque_gain is None
            else tuple(controller.model.torque_gain.tolist()),
        )

    def controller(self, hand: Hand, gains: Gains) -> Controller:
        """Construct the controller that the set-up describes.

        The function also designs the gains of all control loops.
        """
        identified = parse_toml(self.identified_hand, SETUP_ATTACHMENT_NAME)
        known_hand = hand_from_content(identified, SETUP_ATTACHMENT_NAME) if identified else hand
        model = HandModel.from_hand(
            known_hand,
            gains,
            self.rate_hz,
            np.array(self.torque_gain) if self.torque_gain else None,
        )
        tare = np.array(self.tare_N)
        zero = np.array(self.zero_rad)
        drives = make_drives(hand)
        sensors = make_sensors(hand)
        controller = Controller(
            model,
            drives,
            sensors,
            _program_of_setup(self.program, hand),
            tare,
            zero,
            self.arm_at_once,
        )
        return replace(controller, identities=self.identities)


def unverified_protections(drives: Iterable[Drive]) -> tuple[str, ...]:
    """Return one line, with the name of the drive, for each protection that the host cannot verify."""
    return tuple(
        f"{drive.name}: {text}" for drive in drives for text in drive.unverified_protections
    )


def caution_lines(drives: Iterable[Drive]) -> tuple[str, ...]:
    """Return the lines of ``unverified_protections`` in a shorter form.

    If several drives have the same text, one line names all of them.

    Lines about a watchdog come first, because a drive without a watchdog keeps its torque if the
    host fails.
    """
    drive_texts = [(drive.name, text) for drive in drives for text in drive.unverified_protections]
    return lines_by_text(
        sorted(drive_texts, key=lambda drive_and_text: not drive_and_text[1].startswith("watchdog"))
    )


def make_drives(hand: Hand) -> tuple[Drive, ...]:
    """Return the drive that pulls each tendon, in the order of the tendons.

    A CiA 402 drive replies to a SYNC frame, and supervises the heartbeat of the host. The host
    sends the heartbeat after the command of one drive on each bus. On a bus without other SYNC
    frames, the host also sends SYNC after the command of the drive that is selected for the
    heartbeat.

    Raises:
        ConfigError: the drive does not support an option in the hand file, two nodes use the same
            identifier, or neither a load cell nor a torque report shows the tension of a tendon.
    """
    buses = hand.bus_names
    motors = [hand.motor_of_tendon(name) for name in hand.tendon_names]
    drives = tuple(make_drive(motor, buses.index(motor.bus)) for motor in motors)
    for motor, drive, tendon, has_cell in zip(
        motors, drives, hand.tendon_names, hand.has_cell.tolist(), strict=True
    ):
        _check_position_loop(motor, drive)
        if not has_cell:
            _check_torque_report(motor, tendon)
    sensors = make_sensors(hand)
    drives_by_key = [(f"motor[{drive.name}].node_id", drive) for drive in drives]
    location = "sensor_node.node_ids" if hand.sensor_node.is_cia404 else "sensor_node.base_id"
    check_identifiers([(location, sensors), *drives_by_key])
    return _with_host_frames(drives, sensors)


def _check_torque_report(motor: Motor, tendon: str) -> None:
    """Check that the drive of a tendon without a load cell reports its torque.

    Without the torque report, a drive that does not obey its commands could pull with any torque
    unnoticed.

    Raises:
        ConfigError: an option of the drive disables the torque report.
    """
    option = PROTOCOL_TRAITS[motor.protocol].torque_option
    if option and not motor.options.get(option, False):
        expected = f"true, because no load cell measures the tension of {tendon}"
        raise ConfigError("false", f"motor[{motor.name}].options.{option}", expected)


def _check_position_loop(motor: Motor, drive: Drive) -> None:
    """Check that the hand file gives a position loop whose values fit into the commands of the drive.

    The commands must contain a position setpoint. The stiffness and damping in the hand file must
    be within the range of the commands.

    Raises:
        ConfigError: the commands cannot contain the values of a position loop.
    """
    if not motor.closes_position_loop:
        return
    location = f"motor[{motor.name}]"
    message = drive.cyclic_messages.position
    if message is None:
        expected = position_loop_protocols_text()
        if reason := PROTOCOL_TRAITS[motor.protocol].no_position_loop_reason:
            expected += f". {reason}"
        raise ConfigError(f'"{motor.protocol}"', f"{location}.protocol", expected)
    key_by_quantity = {
        SignalQuantity.STIFFNESS: "kp_N_m_per_rad",
        SignalQuantity.DAMPING: "kd_N_m_s_per_rad",
    }
    for signal in message.signals:
        value = (
            getattr(motor, key_by_quantity[signal.quantity])
            if signal.quantity in key_by_quantity
            else None
        )
        largest = signal.value_limits[1]
        smallest_gain = signal.step if signal.quantity == SignalQuantity.STIFFNESS else 0.0
        if value is not None and not smallest_gain <= value <= largest:
            expected = (
                f"{smallest_gain:.3g} to {largest:g} {signal.unit}, the codes of {motor.protocol}"
            )
            raise ConfigError(
                f"{value:g}", f"{location}.{key_by_quantity[signal.quantity]}", expected
            )


def _with_host_frames(drives: tuple[Drive, ...], sensors: SensorInterface) -> tuple[Drive, ...]:
    """Add heartbeat and SYNC of the host to the commands of one CiA 402 drive per bus, and return all drives.

    On each bus, one CiA 402 drive is selected. The host sends its heartbeat after the command of
    the selected drive. If the bus has no other SYNC frames, the host also sends SYNC after the
    command of the selected CiA 402 drive. All CiA 402 drives on a bus receive the same heartbeat
    and the same SYNC frames. The last CiA 402 drive on a bus is selected, so that the SYNC frame
    comes after all commands. The heartbeat has the shortest period that any drive on the bus needs.

    The host adds no SYNC frames to a bus in two cases. The sensor node on the bus uses the
    identifier 0x080, or the hand file sets the option ``sync`` of a drive on the bus.
    """
    completed_drives = list(drives)
    drives_by_bus = dict[int, dict[int, Cia402Drive]]()
    for n, drive in enumerate(drives):
        if isinstance(drive, Cia402Drive):
            drives_by_bus.setdefault(drive.bus, {})[n] = drive
    for bus, drives_on_bus in drives_by_bus.items():
        period_ns = min(drive.heartbeat_period_ns for drive in drives_on_bus.values())
        uses_sync = (bus == sensors.bus and SYNC in sensors.host_ids) or any(
            drive.sync for drive in drives_on_bus.values()
        )
        last_index = max(drives_on_bus)
        for n, drive in drives_on_bus.items():
            is_last_drive = n == last_index
            completed_drives[n] = replace(
                drive,
                sync=drive.sync or (is_last_drive and not uses_sync),
                sends_heartbeat=is_last_drive,
                heartbeat_period_ns=period_ns,
            )
    return tuple(completed_drives)


def make_sensors(hand: Hand) -> SensorInterface:
    """Return the protocol drivers of the hand's load cells and joint encoders."""
    node = hand.sensor_node
    bus = hand.bus_names.index(node.bus)
    if node.is_cia404:
        return Cia404LoadCells.from_description(node, bus, hand.tendon_names)
    prismatic = hand.is_prismatic.nonzero()[0].tolist()
    return SensorNode.from_description(node, bus, hand.tendon_names, hand.joints, prismatic)


def make_controller(
    hand: Hand,
    gains: Gains,
    rate_hz: float,
    program: Program,
    calibration: Calibration | None,
    arm_at_once: bool,
) -> Controller:
    """Construct a controller, and design its gains.

    Without a calibration, all tares and motor zeros are 0.

    Identified parameters in the calibration replace the values of the hand file. The drives and the
    limits always come from the hand file.
    """
    n = len(hand.tendon)
    tare = calibration.tare_tensions(hand) if calibration else np.zeros(n)
    zero = calibration.motor_zeros(hand) if calibration else np.zeros(n)
    identified = calibration.identified if calibration else {}
    gain = torque_gain(hand, identified) if identified else None
    model = HandModel.from_hand(
        identified_hand(hand, identified) if identified else hand, gains, rate_hz, gain
    )
    drives = make_drives(hand)
    sensors = make_sensors(hand)
    controller = Controller(model, drives, sensors, program, tare, zero, arm_at_once)
    known_drive = calibration.drive if calibration else {}
    return replace(
        controller,
        identities=tuple(known_drive.get(drive.name, "") for drive in drives)
        if known_drive
        else (),
    )


def _setup_of_program(program: Program) -> AnyProgramSetup:
    """Return the set-up of a program.

    The program can be constructed again from its set-up.
    """
    match program:
        case TaskProgram(task):
            return TaskSetup(task=task)
        case JogProgram(request, duration):
            return JogSetup(request=request, duration_s=duration)
        case PlaybackProgram(recording, raw):
            return PlaybackSetup(raw=raw, rows=recording.to_text())
        case ExciteProgram(steps):
            return ExciteSetup(steps=steps)
        case CommissionProgram():
            return CommissionSetup()
        case ExerciseProgram(amplitudes, turns):
            return ExerciseSetup(amplitudes=amplitudes, turns=turns)
        case LiveProgram():
            return LiveSetup()
    raise TypeError(f"{type(program).__name__} cannot be written into a log")


def _program_of_setup(setup: AnyProgramSetup, hand: Hand) -> Program:
    """Return the motion program that a program set-up describes."""
    match setup:
        case TaskSetup():
            return TaskProgram(setup.task)
        case JogSetup():
            return JogProgram(setup.request, setup.duration_s)
        case PlaybackSetup():
            recording = RecordedGoals.from_text(setup.rows, len(hand.joints), len(hand.tendon))
            return PlaybackProgram(recording, setup.raw)
        case ExciteSetup():
            return ExciteProgram(setup.steps)
        case CommissionSetup():
            return CommissionProgram()
        case ExerciseSetup():
            return ExerciseProgram(setup.amplitudes, setup.turns)
        case LiveSetup():
            return LiveProgram()
