"""Functions that the state machines of several drive protocols share.

The shared functions are the transition to a fault, the repeated read-back, and enabling and
disabling. The state machine of each protocol has its own progress, a named tuple in
``DriveState.protocol_state``. Each function returns the next drive state, and uses only the fields
of ``EnablingProgress`` that its docstring lists.
"""

from typing import Any, Protocol, Self

from handctl.drives import readback
from handctl.drives.contract import DrivePhase, DriveState
from handctl.drives.frame import Frame
from handctl.drives.readback import ReadbackCursor, SettingRecheck

SILENT, CONFIGURING, READY, ENABLED, FAULT = DrivePhase

SILENCE_TIMEOUT_NS = 250_000_000
"""Time without a frame after which a disabled drive may have lost power and settings [ns]."""


class EnablingProgress(Protocol):
    """Fields of a state machine's progress that the functions of this module use.

    Attributes:
        cursor: position in the list of settings to read back.
        is_configured: True if all settings have their required values.
        enabled_by_other_host: True if the drive may make torque without a command of this host.
        is_enable_sent: True from the enable command until the drive reports that it is off.
        is_disabling: True while the drive is being disabled.
        disable_command_ns: time of the first disable command [ns].
        errors_to_ignore: number of further feedback frames with an error that the host ignores.
        ready_ns: time at which the host verified the last setting [ns].
        serial: serial number of the drive, 0 if the serial number is unknown.
    """

    cursor: ReadbackCursor
    is_configured: bool
    enabled_by_other_host: bool
    is_enable_sent: bool
    is_disabling: bool
    disable_command_ns: int
    errors_to_ignore: int
    ready_ns: int
    serial: int

    @property
    def may_be_enabled(self) -> bool:
        """Return True if the drive may make torque."""
        ...

    def _replace(self, **changes: Any) -> Self: ...


def enter_fault(state: DriveState, error_code: int, fault_text: str) -> DriveState:
    """Return the drive state in phase FAULT, with the given error code and error text."""
    return state._replace(phase=FAULT, error=error_code, error_text=fault_text)


class RecheckedDrive(Protocol):
    """Properties of a drive that ``request_recheck`` uses, see ``contract.Drive``."""

    @property
    def node_id(self) -> int:
        """Return the node number of the drive."""
        ...

    @property
    def rechecks(self) -> tuple[SettingRecheck, ...]:
        """Return the settings that the host reads back again and again while the drive is enabled."""
        ...


def request_recheck(
    state: DriveState, drive: RecheckedDrive, error_code: int, t_ns: int
) -> tuple[DriveState, tuple[Frame, ...]]:
    """Return the next drive state, and the next read-back request to the enabled drive if a request is due.

    Args:
        state: state of the drive.
        drive: drive whose settings the host reads again.
        error_code: error code that is set if the drive does not answer the request for a setting.
        t_ns: time of the tick [ns].
    """
    # Most calls of ``request_recheck`` return here, because no request is due. The frames of the
    # requests are built only for a request that is due.
    if t_ns < state.recheck.due_ns or not (rechecks := drive.rechecks):
        return state, ()
    recheck = rechecks[state.recheck.step]
    check, problem = readback.cursor_after_recheck_request(
        state.recheck, recheck.name, drive.node_id, t_ns
    )
    state = state._replace(recheck=check)
    return enter_fault(state, error_code, problem) if problem else state, (recheck.request,)


def state_after_recheck_reply(
    state: DriveState,
    error_code: int,
    setting_count: int,
    is_equal: bool,
    name: str,
    answer: str,
    expected: str,
) -> DriveState:
    """Return the drive state after a setting of the enabled drive was read again.

    Args:
        state: state of the drive.
        error_code: error code of a setting with a wrong value.
        setting_count: number of settings in the repeated read-back.
        is_equal: True if the setting has the required value.
        name: name of the setting.
        answer: answer of the drive in words, such as ``reads 3``.
        expected: required value, as text.
    """
    check, problem = readback.cursor_after_recheck_reply(
        state.recheck, setting_count, is_equal, name, answer, expected
    )
    state = state._replace(recheck=check)
    return enter_fault(state, error_code, problem) if problem else state


def is_steady(state: DriveState) -> bool:
    """Return True if this host has enabled the drive, and is not disabling it.

    The function uses the fields ``is_enable_sent`` and ``is_disabling``.
    """
    progress: EnablingProgress = state.protocol_state
    return state.phase == ENABLED and progress.is_enable_sent and not progress.is_disabling


def may_have_lost_power(state: DriveState, t_ns: int) -> bool:
    """Return True if a drive in the phase READY has sent no frame for SILENCE_TIMEOUT_NS.

    The function uses the fields ``is_enable_sent`` and ``ready_ns``.
    """
    progress: EnablingProgress = state.protocol_state
    return (
        state.phase == READY
        and not progress.is_enable_sent
        and t_ns - max(state.feedback_t_ns, progress.ready_ns) > SILENCE_TIMEOUT_NS
    )


def state_after_configuration(state: DriveState, t_ns: int, serial: int) -> DriveState:
    """Return the state in phase READY, after the host has verified all settings of a drive.

    A serial number of 0 means that the serial number is unknown.
    """
    progress: EnablingProgress = state.protocol_state
    ready_progress = progress._replace(
        cursor=ReadbackCursor(), is_configured=True, ready_ns=t_ns, serial=serial
    )
    return state._replace(phase=READY, protocol_state=ready_progress)


def start_enabling(state: DriveState, node_id: int, t_ns: int) -> DriveState:
    """Return the state of a drive to which the host sends an enable command.

    The function uses the field ``is_enable_sent``.
    """
    progress: EnablingProgress = state.protocol_state
    if progress.is_enable_sent:
        return state
    check = readback.first_recheck(node_id, t_ns)
    return state._replace(recheck=check, protocol_state=progress._replace(is_enable_sent=True))


def start_disabling(state: DriveState, t_ns: int) -> DriveState:
    """Return the state of a drive to which the host sends a disable command.

    If the drive may be enabled, the drive counts as enabled until its feedback reports that the
    drive is off. The function uses the fields ``may_be_enabled``, ``is_disabling`` and
    ``disable_command_ns``.
    """
    progress: EnablingProgress = state.protocol_state
    if not progress.is_disabling:
        state = state._replace(
            protocol_state=progress._replace(is_disabling=True, disable_command_ns=t_ns)
        )
    return state._replace(phase=ENABLED) if progress.may_be_enabled else state


def state_when_off(
    state: DriveState, has_dropped_out: bool, error_code: int, error_text: str
) -> DriveState:
    """Return the drive state after the drive has reported that it is off and that it has no error.

    The function uses the fields ``is_enable_sent``, ``enabled_by_other_host``, ``errors_to_ignore``, ``is_disabling``
    and ``disable_command_ns``.

    Args:
        state: state of the drive, with the values of the received feedback.
        has_dropped_out: True if the drive was on. A drive that was on and has received no disable
            command has disabled itself.
        error_code: error code of a drive that has disabled itself.
        error_text: text of the error ``error_code``.
    """
    progress: EnablingProgress = state.protocol_state
    progress_when_off = progress._replace(
        is_enable_sent=False, enabled_by_other_host=False, errors_to_ignore=0
    )
    is_waiting = state.phase == READY and not state.error and progress_when_off == progress
    if is_waiting and not has_dropped_out:
        return state  # most reports come from a drive that waits in the phase READY
    if progress.is_disabling:
        # Feedback that the drive sent before the disable command does not show the effect of the
        # command.
        if state.feedback_t_ns < progress.disable_command_ns:
            return state
        return state._replace(
            phase=FAULT if state.error else READY, protocol_state=progress_when_off
        )
    if has_dropped_out:
        return enter_fault(state._replace(protocol_state=progress_when_off), error_code, error_text)
    progress_when_off = progress_when_off._replace(is_enable_sent=progress.is_enable_sent)
    return state._replace(
        phase=CONFIGURING if state.phase == SILENT else state.phase,
        protocol_state=progress_when_off,
    )


def state_when_on(state: DriveState, error_code: int, error_text: str) -> DriveState:
    """Return the drive state after the drive has reported that it is on.

    The function uses the field ``is_enable_sent``.

    Args:
        state: state of the drive.
        error_code: error code of a drive that this host has not enabled.
        error_text: text of the error ``error_code``.
    """
    progress: EnablingProgress = state.protocol_state
    if progress.is_enable_sent and state.phase != FAULT:
        return state if state.phase == ENABLED else state._replace(phase=ENABLED)
    return state_enabled_by_other_host(state, error_code, error_text)


def state_enabled_by_other_host(state: DriveState, error_code: int, error_text: str) -> DriveState:
    """Return the state of a drive that may make torque although this host has not enabled it.

    The function uses the fields ``enabled_by_other_host`` and ``is_disabling``. The arguments have the same
    meaning as in ``state_when_on``.
    """
    progress: EnablingProgress = state.protocol_state
    enabled_by_other_state = state._replace(
        protocol_state=progress._replace(enabled_by_other_host=True)
    )
    if progress.is_disabling:
        return enabled_by_other_state._replace(phase=ENABLED)
    if state.phase in (READY, ENABLED):
        return enter_fault(enabled_by_other_state, error_code, error_text)
    return (
        enabled_by_other_state._replace(phase=CONFIGURING)
        if state.phase == SILENT
        else enabled_by_other_state
    )
