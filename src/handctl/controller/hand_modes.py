"""State machine for the mode of a hand during a run.

At the start of a run, the host is silent. At the end of a run, every drive has confirmed that it is
disabled. A run passes through the modes SILENT -> INVENTORY -> READY -> ARMING -> ACTIVE -> RELAX
-> DISARM -> DONE. From every mode in which motors make torque, the hand can change directly to the
mode CUT, which disables all drives at once. For each mode, one function returns the next mode and,
if the run has failed, the reason of the failure.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from handctl.controller.controller_state import ControllerState
from handctl.controller.relaxation import (
    are_commands_relaxed,
    are_tensions_relaxed,
    start_relaxation,
    update_relax_rate,
)
from handctl.core import state_block as s
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import MODES_BEFORE_ARMING, TORQUE_MODES, HandMode, TickEvent
from handctl.drives.contract import (
    Drive,
    DrivePhase,
    DriveState,
    DriveTarget,
    is_confirmed_off,
)
from handctl.drives.frame import Frame
from handctl.errors import REMOVE_POWER
from handctl.safety.faults.node import TENSION_AFTER_CUT_TIME_S
from handctl.safety.faults.table import FAULT_BY_ID
from handctl.safety.safety_action import SafetyAction

LISTENING_DURATION_S = 0.5
"""Time before the first frame of this host, in which this host detects a second controller [s]."""
INVENTORY_TIMEOUT_S = 3.0
CLEAR_ERRORS_ADVICE = " (when you have looked why: --clear)"
"""Advice to the operator, in the message about a drive with a latched error."""
LATCHED_ERROR_HINT = " (or an error that does not clear)"
READY_DURATION_S = 0.1
"""Time before arming in which the tension filter gets its first measurements [s]."""
ARMING_TIMEOUT_S = 1.0
RELAX_TIMEOUT_S = 1.0
DISARM_TIMEOUT_S = 1.0
TORQUE_CUT_DURATION_S = TENSION_AFTER_CUT_TIME_S
"""Time for which the frames that cut the torque are repeated [s]."""
RELEASE_DETECTION_TICKS = 2
"""Ticks after ``TENSION_AFTER_CUT_TIME_S`` in which the detector of remaining tension (N16) can report a fault."""


@dataclass(frozen=True, slots=True)
class OperatorRequests:
    """Requests from the operator in a tick: to stop the run, or to cut the torque."""

    is_stop_requested: bool = False
    is_cut_requested: bool = False


class ModeInputs(NamedTuple):
    """Inputs of the mode state machine, in addition to the state of the controller.

    Attributes:
        model: model of the hand.
        drives: drives of all motors.
        time_in_mode: time since the present mode began [s].
        action: reaction that the safety monitor demands.
        operator_requests: requests from the operator to stop the run, or to cut the torque.
        other_host_signs: signs that a second controller uses the bus. Signs are frames that only a host
            sends, and replies of motors to which this host has sent no request.
        identities: identities that the drives had when the hand was calibrated, see
            ``Drive.identity``. The identity of a drive is empty if it is not known.
    """

    model: HandModel
    drives: tuple[Drive, ...]
    time_in_mode: float
    action: SafetyAction
    operator_requests: OperatorRequests
    other_host_signs: tuple[str, ...]
    identities: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the motors."""
        return tuple(drive.name for drive in self.drives)


RELAX = SafetyAction.RELAX
NextMode = tuple[HandMode, str]
"""Next mode, and the reason if the run has failed (else empty)."""


def drive_target(mode: HandMode) -> DriveTarget:
    """Return the drive state that the controller requests from every drive in a given mode of the hand."""
    return _DRIVE_TARGET_BY_MODE[mode]


_DRIVE_TARGET_BY_MODE = {
    HandMode.SILENT: DriveTarget.LISTEN,
    HandMode.INVENTORY: DriveTarget.POLL,
    HandMode.READY: DriveTarget.POLL,
    HandMode.ARMING: DriveTarget.ENABLE,
    HandMode.ACTIVE: DriveTarget.ENABLE,
    HandMode.RELAX: DriveTarget.ENABLE,
    HandMode.DISARM: DriveTarget.DISABLE,
    HandMode.CUT: DriveTarget.DISABLE,
    HandMode.DONE: DriveTarget.LISTEN,
}


def shutdown_frames(drives: tuple[Drive, ...], state: ControllerState) -> tuple[Frame, ...]:
    """Return the last frames of a run, after which other programs can use the drives.

    Return an empty tuple before the mode DONE, and after a failed run. After a failed run, the
    drives stay in their present state.
    """
    if state.mode != HandMode.DONE or state.failure:
        return ()
    return tuple(
        frame
        for drive, drive_state in zip(drives, state.drives, strict=True)
        for frame in drive.release_frames(drive_state)
    )


def next_mode(
    model: HandModel,
    drives: tuple[Drive, ...],
    state: ControllerState,
    action: SafetyAction,
    operator_requests: OperatorRequests,
    other_host_signs: tuple[str, ...],
    time_s: float,
    calibrated_identities: tuple[str, ...] = (),
) -> tuple[TickEvent, ...]:
    """Determine the next mode of the hand, and write it into the state.

    Args:
        model: model of the hand.
        drives: drives of all motors.
        state: state with the drive and filter values of the tick, modified in place.
        action: reaction that the safety monitor demands.
        operator_requests: requests from the operator to stop the run, or to cut the torque.
        other_host_signs: texts that describe signs of a second controller on the bus.
        time_s: time of the tick [s].
        calibrated_identities: identities of the drives in the calibration. The tuple can be empty.

    Returns:
        The event of a mode change, or no event if the mode does not change.
    """
    mode_before = state.mode
    is_overridden = (
        action >= RELAX
        or bool(other_host_signs)
        or operator_requests.is_stop_requested
        or operator_requests.is_cut_requested
    )
    if mode_before == HandMode.ACTIVE and not (is_overridden or state.progress.finished):
        return ()  # most ticks of a run end here
    inputs = ModeInputs(
        model,
        drives,
        time_s - state.mode_start_time,
        action,
        operator_requests,
        other_host_signs,
        calibrated_identities,
    )
    overriding_mode = _overriding_mode(state, inputs) if is_overridden else None
    mode, failure = overriding_mode or _NEXT_MODE_FUNCTIONS[mode_before](state, inputs)
    if mode == mode_before:
        if mode == HandMode.RELAX:
            update_relax_rate(state)
        return ()
    failure = failure or (
        "" if state.failure else _latched_faults(state)
    )  # a fault during the move to the home position is also a failure
    names = inputs.names
    level = "error" if failure else "info"
    unconfirmed_motors = (
        _motors_possibly_with_torque(model, state, names) if mode == HandMode.DONE else ()
    )
    text = f"{mode_before.name} -> {mode.name}" + (f": {failure}" if failure else "")
    if (
        unconfirmed_motors and REMOVE_POWER not in text
    ):  # an operator who has stopped the run reads only the line of the mode change
        text += f"; {REMOVE_POWER}: not confirmed disabled: {', '.join(unconfirmed_motors)}"
    reason = (
        f"{state.failure}; {failure}"
        if state.failure and unconfirmed_motors
        else state.failure or failure
    )
    state.decide(failure=reason, unconfirmed_motors=unconfirmed_motors)
    state.mode = mode
    state.mode_start_time = time_s
    if mode == HandMode.RELAX:
        start_relaxation(model, state)
    return (TickEvent(level, "mode", "", text),)


def _overriding_mode(state: ControllerState, inputs: ModeInputs) -> NextMode | None:
    """Return the mode that the safety monitor or the operator demands, or None."""
    is_torque_mode = state.mode in TORQUE_MODES
    if is_torque_mode and (
        inputs.operator_requests.is_cut_requested or inputs.action == SafetyAction.CUT
    ):
        return HandMode.CUT, _latched_faults(state)
    if state.mode in _MODE_AFTER_STOP and inputs.action == SafetyAction.RELAX:
        return _MODE_AFTER_STOP[state.mode], _latched_faults(state)
    if state.mode in _MODE_AFTER_STOP and inputs.operator_requests.is_stop_requested:
        return _MODE_AFTER_STOP[state.mode], ""
    return _next_mode_before_arming(state, inputs) if state.mode in MODES_BEFORE_ARMING else None


def _next_mode_before_arming(state: ControllerState, inputs: ModeInputs) -> NextMode | None:
    """Return the mode DONE and the reason for the end, if a run must end before any motor makes torque.

    Return None if the run continues.
    """
    if inputs.operator_requests.is_stop_requested or inputs.operator_requests.is_cut_requested:
        return HandMode.DONE, ""
    if inputs.other_host_signs:
        return (
            HandMode.DONE,
            f"another controller is on the bus (heard: {', '.join(inputs.other_host_signs)})",
        )
    return (HandMode.DONE, _latched_faults(state)) if inputs.action >= SafetyAction.RELAX else None


_MODE_AFTER_STOP = {HandMode.ARMING: HandMode.DISARM, HandMode.ACTIVE: HandMode.RELAX}
"""Mode that follows each mode after a fault or a stop.

In ARMING, no tension has been commanded, and no further drive is allowed to be enabled, so DISARM
follows.
"""


def _latched_faults(state: ControllerState) -> str:
    """Return a text that names the latched faults, as the reason of a failure.

    The text is empty if no fault is latched.
    """
    if not state.latched_faults:
        return ""
    return "fault " + ", ".join(
        f"{latched_fault.id} {latched_fault.part_name}" for latched_fault in state.latched_faults
    )


def _next_mode_after_silent(state: ControllerState, inputs: ModeInputs) -> NextMode:
    return (
        HandMode.INVENTORY if inputs.time_in_mode >= LISTENING_DURATION_S else HandMode.SILENT
    ), ""


def _next_mode_after_inventory(state: ControllerState, inputs: ModeInputs) -> NextMode:
    named_drives = tuple(_named_drives(state, inputs))
    wrong_drives = [
        f"{name}: {drive.error_text}"
        for name, drive in named_drives
        if drive.phase == DrivePhase.FAULT
    ]
    if wrong_amplifiers := _wrong_amplifiers(state):
        return HandMode.DONE, "; ".join(wrong_amplifiers)
    if wrong_drives and not (
        state.is_clearing_errors and inputs.time_in_mode < INVENTORY_TIMEOUT_S
    ):
        return HandMode.DONE, "; ".join(wrong_drives) + CLEAR_ERRORS_ADVICE
    is_group_missing = not state.view("group_frames").all()
    if (
        all(phase == DrivePhase.READY for phase in state.drive_phases)
        and state.has_started
        and not is_group_missing
    ):
        return HandMode.READY, ""
    if inputs.time_in_mode < INVENTORY_TIMEOUT_S:
        return HandMode.INVENTORY, ""
    unready_drives = [
        (name, drive) for name, drive in named_drives if drive.phase != DrivePhase.READY
    ]
    silent_names = [
        name
        for name, drive in unready_drives
        if drive.phase == DrivePhase.SILENT and not drive.error_text
    ]
    silent_names += _silent_sensors(state) if is_group_missing else []
    stuck_drives = [
        f"{name}: {drive.error_text or 'not configured in time'}"
        for name, drive in unready_drives
        if name not in silent_names
    ]
    silence_text = (
        [
            f"no answer from {', '.join(silent_names)}{LATCHED_ERROR_HINT if state.is_clearing_errors else ''}"
        ]
        if silent_names
        else []
    )
    return HandMode.DONE, "; ".join([*stuck_drives, *silence_text, *_missing_inputs(state, inputs)])


def _wrong_amplifiers(state: ControllerState) -> list[str]:
    """Return the names of the amplifiers whose set-up has failed, each with the reason."""
    return [
        f"{amplifier.name}: {amplifier.error_text}"
        for amplifier in state.decisions.amplifiers
        if amplifier.phase == DrivePhase.FAULT
    ]


def _silent_sensors(state: ControllerState) -> list[str]:
    """Return the name of each amplifier whose set-up is not complete.

    If the set-up of every amplifier is complete, return a list with one name that stands for all
    sensors of the hand.
    """
    amplifiers = state.decisions.amplifiers
    unready_amplifiers = [
        amplifier for amplifier in amplifiers if amplifier.phase != DrivePhase.READY
    ]
    silent_groups = [
        identity.name + (f" ({identity.error_text})" if identity.error_text else "")
        for identity in unready_amplifiers
    ]
    return silent_groups or ["the load cells" if amplifiers else "the sensor node"]


def _missing_inputs(state: ControllerState, inputs: ModeInputs) -> list[str]:
    """Return a text that lists the motors whose drives are ready, but have not sent a position yet.

    The tension filter needs the position of every motor.
    """
    drives = _named_drives(state, inputs)
    motors_without_position = [
        name
        for name, drive in drives
        if drive.phase == DrivePhase.READY and math.isnan(drive.position)
    ]
    return (
        [f"no position from {', '.join(motors_without_position)}"]
        if motors_without_position
        else []
    )


def _next_mode_after_ready(state: ControllerState, inputs: ModeInputs) -> NextMode:
    if wrong_amplifiers := _wrong_amplifiers(state):
        return HandMode.DONE, "; ".join(wrong_amplifiers)
    if strange := _other_drives(state, inputs):
        return (
            HandMode.DONE,
            f"{strange}: the calibration is of another hand, give that of this hand or commission it",
        )
    return (
        HandMode.ARMING
        if state.is_arming_requested and inputs.time_in_mode >= READY_DURATION_S
        else HandMode.READY
    ), ""


def _other_drives(state: ControllerState, inputs: ModeInputs) -> str:
    """Return a text that lists the drives whose identity differs from the identity in the calibration.

    Returns:
        The result has one phrase per drive. The text is empty if all identities are equal, or if
        the calibration contains no identities.
    """
    drives_found = [
        drive.identity(drive_state)
        for drive, drive_state in zip(inputs.drives, state.decisions.drives, strict=True)
    ]
    pairs = zip(inputs.names, drives_found, inputs.identities, strict=False)
    unexpected_drives = [
        (name, present_target, expected_target)
        for name, present_target, expected_target in pairs
        if expected_target not in ("", present_target)
    ]
    return ", ".join(
        f"{name} is drive {present_target}, but was calibrated with drive {expected_target}"
        for name, present_target, expected_target in unexpected_drives
    )


def _next_mode_after_arming(state: ControllerState, inputs: ModeInputs) -> NextMode:
    if all(phase == DrivePhase.ENABLED for phase in state.drive_phases):
        return HandMode.ACTIVE, ""
    if inputs.time_in_mode < ARMING_TIMEOUT_S:
        return HandMode.ARMING, ""
    names_not_enabled = [
        name for name, drive in _named_drives(state, inputs) if drive.phase != DrivePhase.ENABLED
    ]
    return HandMode.DISARM, f"not enabled: {', '.join(names_not_enabled)}"


def _next_mode_after_active(state: ControllerState, inputs: ModeInputs) -> NextMode:
    return (HandMode.RELAX if state.progress.finished else HandMode.ACTIVE), state.progress.failure


def _next_mode_after_relax(state: ControllerState, inputs: ModeInputs) -> NextMode:
    # A load cell can read less than the true tension, so the torque is removed only when the
    # commanded forces have also fallen.
    is_relaxed = are_tensions_relaxed(inputs.model, state) and are_commands_relaxed(
        inputs.model, state
    )
    return (
        HandMode.DISARM if is_relaxed or inputs.time_in_mode >= RELAX_TIMEOUT_S else HandMode.RELAX
    ), ""


def _next_mode_after_disarm(state: ControllerState, inputs: ModeInputs) -> NextMode:
    pulling_motors = _pulling_motors(inputs.model, state, inputs.names)
    if pulling_motors:
        return (
            HandMode.DONE,
            f"{REMOVE_POWER}: still pulling after the cut: {', '.join(pulling_motors)}",
        )
    possibly_enabled_motors = motors_not_confirmed_off(state, inputs.names)
    if not possibly_enabled_motors:
        # A drive can report that it is disabled although its motor still pulls.
        ticks_without_torque = state.run_integers[s.TICKS_SINCE_CUT] - RELEASE_DETECTION_TICKS
        is_checked = ticks_without_torque * inputs.model.period >= TENSION_AFTER_CUT_TIME_S
        return (HandMode.DONE if is_checked else HandMode.DISARM), ""
    if inputs.time_in_mode < DISARM_TIMEOUT_S:
        return HandMode.DISARM, ""
    return (
        HandMode.DONE,
        f"{REMOVE_POWER}: not confirmed disabled: {', '.join(possibly_enabled_motors)}",
    )


def _next_mode_after_cut(state: ControllerState, inputs: ModeInputs) -> NextMode:
    return (HandMode.DISARM if inputs.time_in_mode >= TORQUE_CUT_DURATION_S else HandMode.CUT), ""


def _next_mode_after_done(state: ControllerState, inputs: ModeInputs) -> NextMode:
    return HandMode.DONE, ""


_NEXT_MODE_FUNCTIONS: dict[HandMode, Callable[[ControllerState, ModeInputs], NextMode]] = {
    HandMode.SILENT: _next_mode_after_silent,
    HandMode.INVENTORY: _next_mode_after_inventory,
    HandMode.READY: _next_mode_after_ready,
    HandMode.ARMING: _next_mode_after_arming,
    HandMode.ACTIVE: _next_mode_after_active,
    HandMode.RELAX: _next_mode_after_relax,
    HandMode.DISARM: _next_mode_after_disarm,
    HandMode.CUT: _next_mode_after_cut,
    HandMode.DONE: _next_mode_after_done,
}


def _named_drives(state: ControllerState, inputs: ModeInputs) -> Iterator[tuple[str, DriveState]]:
    return zip(inputs.names, state.drives, strict=True)


def motors_not_confirmed_off(
    state: ControllerState, motor_names: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the names of motors that are possibly still enabled.

    A motor is possibly enabled if its drive has not confirmed the disabled state. Before arming,
    handctl has not enabled any motor, so a motor without a confirmation is not in the result. After
    the end of a run, the result contains only motors that had no confirmation at the end of the
    run. A motor whose drive reports that it is enabled is always in the result.
    """
    doubtful_motors = motor_names
    if state.mode in MODES_BEFORE_ARMING:
        doubtful_motors = ()
    elif state.mode == HandMode.DONE:
        doubtful_motors = state.unconfirmed_motors
    return tuple(
        name
        for name, drive in zip(motor_names, state.drives, strict=True)
        if drive.phase == DrivePhase.ENABLED
        or (name in doubtful_motors and not is_confirmed_off(drive))
    )


def _pulling_motors(
    model: HandModel, state: ControllerState, motor_names: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the names of motors whose tendon still has tension after the torque was cut (fault N16)."""
    tendons = {
        latched_fault.part_name
        for latched_fault in state.latched_faults
        if FAULT_BY_ID[latched_fault.id].shows_torque_after_cut
    }
    return tuple(
        name
        for name, tendon in zip(motor_names, model.hand.tendon_names, strict=True)
        if tendon in tendons
    )


def _motors_possibly_with_torque(
    model: HandModel, state: ControllerState, motor_names: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the names of motors that possibly still make torque at the end of a run.

    If the run ends before arming, the function ignores the tensions of the tendons. Before arming,
    a tendon can have tension although its motor makes no torque.
    """
    pulling_motors = (
        () if state.mode in MODES_BEFORE_ARMING else _pulling_motors(model, state, motor_names)
    )
    return tuple(dict.fromkeys((*motors_not_confirmed_off(state, motor_names), *pulling_motors)))
