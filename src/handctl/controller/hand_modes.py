"""State machine for the mode of a hand, from the silence before the first frame to the confirmed disarming at the end.

SILENT -> INVENTORY -> READY -> ARMING -> ACTIVE -> RELAX -> DISARM -> DONE. From every mode with
torque, the hand can change to the mode CUT. One function belongs to each mode. This function
returns the next mode and, if the run has failed, the reason.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from handctl.controller.controller_state import ControllerState
from handctl.controller.relaxing import (
    are_commands_relaxed,
    are_tensions_relaxed,
    begin_relaxing,
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
from handctl.safety.faults.node import PULL_AFTER_CUT_TIME_S
from handctl.safety.faults.table import FAULT_BY_ID
from handctl.safety.safety_action import SafetyAction

LISTENING_DURATION_S = 0.5
"""Time before this host sends its first frame, in which it detects a second controller [s]."""
INVENTORY_TIMEOUT_S = 3.0
CLEAR_ADVICE = " (when you have looked why: --clear)"
"""Advice to the operator, in the message about a drive with a latched error."""
LATCHED_ERROR_HINT = " (or an error that does not clear)"
READY_DURATION_S = 0.1
"""Time before arming in which the tension filter gets its first measurements [s]."""
ARMING_TIMEOUT_S = 1.0
RELAX_TIMEOUT_S = 1.0
DISARM_TIMEOUT_S = 1.0
CUT_DURATION_S = PULL_AFTER_CUT_TIME_S
"""Time for which the frames that cut the torque are repeated [s]."""
RELEASE_CHECK_TICKS = 2
"""Ticks after ``PULL_AFTER_CUT_TIME_S`` in which the detector of tendons that still pull (N16) has the last word."""


@dataclass(frozen=True, slots=True)
class OperatorRequests:
    """Stop and cut requests from the operator in a tick."""

    stop: bool = False
    cut: bool = False


class ModeInputs(NamedTuple):
    """Inputs of the state machine of the modes, in addition to the state of the controller.

    Attributes:
        model: model of the hand.
        drives: drives of all motors.
        elapsed: time since the present mode began [s].
        action: reaction that the safety monitor demands.
        operator: stop and cut requests from the operator.
        foreign: signs that a second controller uses the bus. Signs are frames that only a host
            sends, and replies of motors to which this host has sent no request.
        identities: identities that the drives had when the hand was calibrated, see
            ``Drive.identity``. The identity of a drive is empty if it is not known.
    """

    model: HandModel
    drives: tuple[Drive, ...]
    elapsed: float
    action: SafetyAction
    operator: OperatorRequests
    foreign: tuple[str, ...]
    identities: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the motors."""
        return tuple(drive.name for drive in self.drives)

    @property
    def no_override(self) -> bool:
        """Return True if the next mode is determined neither by the safety monitor nor by the operator."""
        return self.action < RELAX and not (self.foreign or self.operator.stop or self.operator.cut)


RELAX = SafetyAction.RELAX
NextMode = tuple[HandMode, str]
"""Next mode, and the reason if the run has failed (else empty)."""


def drive_target(mode: HandMode) -> DriveTarget:
    """Return the state into which every drive should go in a given mode of the hand."""
    return _DRIVE_TARGETS[mode]


_DRIVE_TARGETS = {
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
    """Return the frames that make the drives free for other programs at the end of a run.

    If the run has failed, there are no such frames, and the drives stay as they are.
    """
    if state.mode != HandMode.DONE or state.failure:
        return ()
    return tuple(
        frame
        for drive, own in zip(drives, state.drives, strict=True)
        for frame in drive.release_frames(own)
    )


def next_mode(
    model: HandModel,
    drives: tuple[Drive, ...],
    state: ControllerState,
    action: SafetyAction,
    operator: OperatorRequests,
    other_host_frames: tuple[str, ...],
    time_s: float,
    fault_identities: tuple[str, ...] = (),
) -> tuple[TickEvent, ...]:
    """Determine the next mode of the hand, and write it into the state.

    Args:
        model: model of the hand.
        drives: drives of all motors.
        state: state with the drive and filter values of the tick, modified in place.
        action: reaction that the safety monitor demands.
        operator: stop and cut requests from the operator.
        other_host_frames: texts that describe signs of a second controller on the bus.
        time_s: time of the tick [s].
        fault_identities: identities of the drives in the calibration. May be empty.

    Returns:
        The event of a mode change. There is no event if the mode does not change.
    """
    inputs = ModeInputs(
        model,
        drives,
        time_s - state.mode_since,
        action,
        operator,
        other_host_frames,
        fault_identities,
    )
    before = state.mode
    demanded = None if inputs.no_override else _overriding_mode(state, inputs)
    mode, failure = demanded or _NEXT_MODE_FUNCTIONS[before](state, inputs)
    if mode == before:
        if mode == HandMode.RELAX:
            update_relax_rate(state)
        return ()
    failure = failure or (
        "" if state.failure else _latched_faults(state)
    )  # this also applies to a fault during the move to the home position
    names = inputs.names
    level = "error" if failure else "info"
    unconfirmed = _motors_possibly_on(model, state, names) if mode == HandMode.DONE else ()
    text = f"{before.name} -> {mode.name}" + (f": {failure}" if failure else "")
    if (
        unconfirmed and REMOVE_POWER not in text
    ):  # an operator who has stopped the run reads only this line
        text += f"; {REMOVE_POWER}: not confirmed disabled: {', '.join(unconfirmed)}"
    reason = (
        f"{state.failure}; {failure}" if state.failure and unconfirmed else state.failure or failure
    )
    state.decide(failure=reason, unconfirmed=unconfirmed)
    state.mode = mode
    state.mode_since = time_s
    if mode == HandMode.RELAX:
        begin_relaxing(model, state)
    return (TickEvent(level, "mode", "", text),)


def _overriding_mode(state: ControllerState, inputs: ModeInputs) -> NextMode | None:
    """Return the mode that the safety monitor or the operator demands, or None."""
    acting = state.mode in TORQUE_MODES
    if acting and (inputs.operator.cut or inputs.action == SafetyAction.CUT):
        return HandMode.CUT, _latched_faults(state)
    if state.mode in _MODE_AFTER_STOP and inputs.action == SafetyAction.RELAX:
        return _MODE_AFTER_STOP[state.mode], _latched_faults(state)
    if state.mode in _MODE_AFTER_STOP and inputs.operator.stop:
        return _MODE_AFTER_STOP[state.mode], ""
    return _before_arming(state, inputs) if state.mode in MODES_BEFORE_ARMING else None


def _before_arming(state: ControllerState, inputs: ModeInputs) -> NextMode | None:
    """Return the mode that ends a run before any motor makes torque.

    Return None if the run continues.
    """
    if inputs.operator.stop or inputs.operator.cut:
        return HandMode.DONE, ""
    if inputs.foreign:
        return (
            HandMode.DONE,
            f"another controller is on the bus (heard: {', '.join(inputs.foreign)})",
        )
    return (HandMode.DONE, _latched_faults(state)) if inputs.action >= SafetyAction.RELAX else None


_MODE_AFTER_STOP = {HandMode.ARMING: HandMode.DISARM, HandMode.ACTIVE: HandMode.RELAX}
"""Mode that follows each mode after a fault or a stop.

In ARMING no tension has been commanded and no further drive may be enabled, so DISARM follows.
"""


def _latched_faults(state: ControllerState) -> str:
    """Return the latched faults as text, for the reason of a failure.

    The text is empty if no fault is latched.
    """
    if not state.latched:
        return ""
    return "fault " + ", ".join(f"{mark.id} {mark.instance}" for mark in state.latched)


def _after_silent(state: ControllerState, inputs: ModeInputs) -> NextMode:
    return (HandMode.INVENTORY if inputs.elapsed >= LISTENING_DURATION_S else HandMode.SILENT), ""


def _after_inventory(state: ControllerState, inputs: ModeInputs) -> NextMode:
    named = tuple(_named_drives(state, inputs))
    wrong = [
        f"{name}: {drive.error_text}" for name, drive in named if drive.phase == DrivePhase.FAULT
    ]
    if wrong_amplifiers := _wrong_amplifiers(state):
        return HandMode.DONE, "; ".join(wrong_amplifiers)
    if wrong and not (state.clearing and inputs.elapsed < INVENTORY_TIMEOUT_S):
        return HandMode.DONE, "; ".join(wrong) + CLEAR_ADVICE
    groups_missing = not state.view("group_frames").all()
    if (
        all(drive.phase == DrivePhase.READY for drive in state.drives)
        and state.started
        and not groups_missing
    ):
        return HandMode.READY, ""
    if inputs.elapsed < INVENTORY_TIMEOUT_S:
        return HandMode.INVENTORY, ""
    behind = [(name, drive) for name, drive in named if drive.phase != DrivePhase.READY]
    silent = [
        name for name, drive in behind if drive.phase == DrivePhase.SILENT and not drive.error_text
    ]
    silent += _silent_sensors(state) if groups_missing else []
    stuck = [
        f"{name}: {drive.error_text or 'not configured in time'}"
        for name, drive in behind
        if name not in silent
    ]
    silence = (
        [f"no answer from {', '.join(silent)}{LATCHED_ERROR_HINT if state.clearing else ''}"]
        if silent
        else []
    )
    return HandMode.DONE, "; ".join([*stuck, *silence, *_missing_inputs(state, inputs)])


def _wrong_amplifiers(state: ControllerState) -> list[str]:
    """Return the names of the amplifiers whose set-up has failed, each with the reason."""
    return [
        f"{one.name}: {one.error_text}"
        for one in state.decisions.amplifiers
        if one.phase == DrivePhase.FAULT
    ]


def _silent_sensors(state: ControllerState) -> list[str]:
    """Return the name of each amplifier whose set-up is not complete.

    If there is none, one name stands for all sensors.
    """
    amplifiers = state.decisions.amplifiers
    behind = [one for one in amplifiers if one.phase != DrivePhase.READY]
    silent = [one.name + (f" ({one.error_text})" if one.error_text else "") for one in behind]
    return silent or ["the load cells" if amplifiers else "the sensor node"]


def _missing_inputs(state: ControllerState, inputs: ModeInputs) -> list[str]:
    """Return the motors whose drives are ready but have not sent a position yet.

    The tension filter needs the position of every motor.
    """
    drives = _named_drives(state, inputs)
    blind = [
        name
        for name, drive in drives
        if drive.phase == DrivePhase.READY and math.isnan(drive.position)
    ]
    return [f"no position from {', '.join(blind)}"] if blind else []


def _after_ready(state: ControllerState, inputs: ModeInputs) -> NextMode:
    if wrong := _wrong_amplifiers(state):
        return HandMode.DONE, "; ".join(wrong)
    if strange := _other_drives(state, inputs):
        return (
            HandMode.DONE,
            f"{strange}: the calibration is of another hand, give that of this hand or commission it",
        )
    return (
        HandMode.ARMING if state.armed and inputs.elapsed >= READY_DURATION_S else HandMode.READY
    ), ""


def _other_drives(state: ControllerState, inputs: ModeInputs) -> str:
    """Return the drives whose identity differs from the identity in the calibration.

    Returns:
        The result has one phrase per drive. The text is empty if all identities are equal, or if
        the calibration contains none.
    """
    there = [
        drive.identity(drive_state)
        for drive, drive_state in zip(inputs.drives, state.drives, strict=True)
    ]
    pairs = zip(inputs.names, there, inputs.identities, strict=False)
    others = [(name, now, then) for name, now, then in pairs if then not in ("", now)]
    return ", ".join(
        f"{name} is drive {now}, but was calibrated with drive {then}" for name, now, then in others
    )


def _after_arming(state: ControllerState, inputs: ModeInputs) -> NextMode:
    if all(phase == DrivePhase.ENABLED for phase in state.phases):
        return HandMode.ACTIVE, ""
    if inputs.elapsed < ARMING_TIMEOUT_S:
        return HandMode.ARMING, ""
    late = [
        name for name, drive in _named_drives(state, inputs) if drive.phase != DrivePhase.ENABLED
    ]
    return HandMode.DISARM, f"not enabled: {', '.join(late)}"


def _after_active(state: ControllerState, inputs: ModeInputs) -> NextMode:
    return (HandMode.RELAX if state.progress.finished else HandMode.ACTIVE), state.progress.failure


def _after_relax(state: ControllerState, inputs: ModeInputs) -> NextMode:
    # A load cell may read less than the true tension. Therefore the torque is removed only when the
    # commanded forces have also fallen.
    relaxed = are_tensions_relaxed(inputs.model, state) and are_commands_relaxed(
        inputs.model, state
    )
    return (HandMode.DISARM if relaxed or inputs.elapsed >= RELAX_TIMEOUT_S else HandMode.RELAX), ""


def _after_disarm(state: ControllerState, inputs: ModeInputs) -> NextMode:
    pulling = _pulling_motors(inputs.model, state, inputs.names)
    if pulling:
        return HandMode.DONE, f"{REMOVE_POWER}: still pulling after the cut: {', '.join(pulling)}"
    enabled = motors_not_confirmed_off(state, inputs.names)
    if not enabled:
        # A drive may report that it is disabled although its motor still pulls.
        ticks_without_torque = state.run_integer(s.TICKS_SINCE_CUT) - RELEASE_CHECK_TICKS
        checked = ticks_without_torque * inputs.model.period >= PULL_AFTER_CUT_TIME_S
        return (HandMode.DONE if checked else HandMode.DISARM), ""
    if inputs.elapsed < DISARM_TIMEOUT_S:
        return HandMode.DISARM, ""
    return HandMode.DONE, f"{REMOVE_POWER}: not confirmed disabled: {', '.join(enabled)}"


def _after_cut(state: ControllerState, inputs: ModeInputs) -> NextMode:
    return (HandMode.DISARM if inputs.elapsed >= CUT_DURATION_S else HandMode.CUT), ""


def _after_done(state: ControllerState, inputs: ModeInputs) -> NextMode:
    return HandMode.DONE, ""


_NEXT_MODE_FUNCTIONS: dict[HandMode, Callable[[ControllerState, ModeInputs], NextMode]] = {
    HandMode.SILENT: _after_silent,
    HandMode.INVENTORY: _after_inventory,
    HandMode.READY: _after_ready,
    HandMode.ARMING: _after_arming,
    HandMode.ACTIVE: _after_active,
    HandMode.RELAX: _after_relax,
    HandMode.DISARM: _after_disarm,
    HandMode.CUT: _after_cut,
    HandMode.DONE: _after_done,
}


def _named_drives(state: ControllerState, inputs: ModeInputs) -> Iterator[tuple[str, DriveState]]:
    return zip(inputs.names, state.drives, strict=True)


def motors_not_confirmed_off(
    state: ControllerState, motor_names: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the names of motors that may still be enabled, because their drives have not confirmed otherwise.

    Before arming, handctl has not enabled any motor. So a drive without a confirmation is not
    listed. After the end of a run, a drive is listed only if it had not confirmed at the end of the
    run. A drive which reports that it is enabled is always listed.
    """
    in_doubt = motor_names
    if state.mode in MODES_BEFORE_ARMING:
        in_doubt = ()
    elif state.mode == HandMode.DONE:
        in_doubt = state.unconfirmed
    return tuple(
        name
        for name, drive in zip(motor_names, state.drives, strict=True)
        if drive.phase == DrivePhase.ENABLED or (name in in_doubt and not is_confirmed_off(drive))
    )


def _pulling_motors(
    model: HandModel, state: ControllerState, motor_names: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the names of motors whose tendons still have tension after the torque was cut (N16)."""
    tendons = {
        mark.instance for mark in state.latched if FAULT_BY_ID[mark.id].shows_torque_after_cut
    }
    return tuple(
        name
        for name, tendon in zip(motor_names, model.hand.tendon_names, strict=True)
        if tendon in tendons
    )


def _motors_possibly_on(
    model: HandModel, state: ControllerState, motor_names: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the names of motors that may still make torque at the end of a run.

    If the run ends before arming, a tendon may have tension although the motor makes no torque.
    """
    pulling = (
        () if state.mode in MODES_BEFORE_ARMING else _pulling_motors(model, state, motor_names)
    )
    return tuple(dict.fromkeys((*motors_not_confirmed_off(state, motor_names), *pulling)))
