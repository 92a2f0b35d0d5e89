"""Conformance checks of a real drive.

The checks run one after the other, and keep the torque within a given limit. The shaft of the drive
can turn during the checks. Two checks raise the torque until the shaft has moved a little or the
torque limit is reached, and then brake the shaft.
"""

import math
from collections.abc import Callable, Iterator
from enum import Enum
from typing import NamedTuple

from handctl.drives.contract import Drive, DrivePhase, DriveProperty, DriveTarget
from handctl.runtime.diagnostics.drive_rig import PERIOD_NS, DriveRig
from handctl.runtime.diagnostics.torque_step import (
    MAX_REST_VELOCITY_RAD_S,
    MIN_MOTION_RAD,
    apply_torque_step,
    brake_shaft,
)

MAX_FEEDBACK_AGE_NS = 50_000_000
"""Largest age at which feedback still counts as fresh [ns]."""
MAX_LATE_TICKS_PER_100 = 5
"""Number of ticks in 100 in which older feedback is allowed, because other processes delay this process."""
HOST_SILENCE_S = 0.3
"""Shortest time for which the check of the watchdog sends no commands [s]."""
CHECK_DURATION_TICKS = 60
"""Number of ticks in which a check counts answers, or sends torque commands to a disabled drive."""
MIN_DUPLICATE_ANSWER_RATIO = 1.5
"""Number of answers per request above which a second drive must have the same node number.

A single drive sends one answer to each request. Two drives with the same number send two answers.
"""
OBEYED_TORQUE_FRACTION = 0.3
"""Reported torque that shows that a disabled drive has obeyed a command, as a fraction of the torque limit."""


class CheckVerdict(Enum):
    """Result of a conformance check of a drive: passed, failed, or not checked."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_CHECKED = "not checked"


class ConformanceCheck(NamedTuple):
    """Completed check with its result.

    Attributes:
        name: name of the checked requirement.
        verdict: result of the check.
        reason: observation that explains the result, in one line.
    """

    name: str
    verdict: CheckVerdict
    reason: str


class CheckFailed(Exception):  # noqa: N818 - a verdict, not an error; never leaves this module
    """Raised if a drive does not meet a requirement. The text of the exception describes how the drive behaved."""


class CheckNotPossible(Exception):  # noqa: N818 - a verdict, not an error; never leaves this module
    """Raised if a requirement cannot be checked. The text of the exception gives the reason."""


class DeviceUnderTest(NamedTuple):
    """Drive under test, with the limits of the test.

    Attributes:
        rig: test rig with the drive and its bus.
        torque_limit_N_m: largest torque of the test [N m].
        watchdog_s: timeout of the drive's watchdog [s].
    """

    rig: DriveRig
    torque_limit_N_m: float
    watchdog_s: float


RequirementCheck = Callable[[DeviceUnderTest], str]
"""Function that checks one requirement of a drive, and returns the observation as text.

If the drive does not pass, the function raises CheckFailed or CheckNotPossible.
"""


def run_checks(device: DeviceUnderTest) -> Iterator[ConformanceCheck]:
    """Run all checks in order, and yield each result.

    If a check leaves the drive in an unusable state, the remaining checks are left out. Two checks
    turn the shaft. If the first of these two checks fails, the second is left out.
    """
    is_usable = True
    reversed_direction_failed = False
    for name, requirement, turns in CHECKED_REQUIREMENTS:
        if not is_usable or (turns and reversed_direction_failed):
            yield _result_of_omitted_check(device, name, requirement)
            continue
        check = _run_check(device, name, requirement)
        yield check
        has_failed = check.verdict is CheckVerdict.FAILED
        reversed_direction_failed |= turns and has_failed
        is_usable = device.rig.set_up_drive() and not (
            has_failed and requirement is _check_one_answer_per_request
        )


def _result_of_omitted_check(
    device: DeviceUnderTest, name: str, requirement: RequirementCheck
) -> ConformanceCheck:
    """Return the result of a check that is left out after the failure of an earlier check.

    If the drive is still enabled, the check of the disable command counts as failed, because an
    earlier check has already sent the disable command.
    """
    if requirement is _check_disable_command and device.rig.state.phase == DrivePhase.ENABLED:
        return ConformanceCheck(
            name, CheckVerdict.FAILED, "stays enabled after the disable command of another check"
        )
    return ConformanceCheck(
        name, CheckVerdict.NOT_CHECKED, "not run, because of what failed before"
    )


def _run_check(
    device: DeviceUnderTest, name: str, requirement: RequirementCheck
) -> ConformanceCheck:
    """Run a check, and return its result."""
    try:
        return ConformanceCheck(name, CheckVerdict.PASSED, requirement(device))
    except CheckFailed as failed:
        return ConformanceCheck(name, CheckVerdict.FAILED, str(failed))
    except CheckNotPossible as not_possible:
        return ConformanceCheck(name, CheckVerdict.NOT_CHECKED, str(not_possible))


def _check_configuration(device: DeviceUnderTest) -> str:
    """Check that the drive accepts its settings, and reaches the phase READY."""
    rig = device.rig
    if not rig.run_until(DriveTarget.POLL, lambda state: state.phase == DrivePhase.READY, 5.0):
        raise CheckFailed(rig.reason_not_ready())
    if reason := rig.drive.unchecked_properties.get(DriveProperty.READBACK):
        raise CheckNotPossible(f"answers; not all settings are read back: {reason}")
    return "settings read back"


def _failed_check_error(
    device: DeviceUnderTest, checked_property: DriveProperty, observed_text: str
) -> Exception:
    """Return the exception for a drive that lacks a checked property.

    If handctl cannot check the property on this drive, the exception does not count as a failure of
    the drive.
    """
    reason = device.rig.drive.unchecked_properties.get(checked_property)
    return CheckNotPossible(f"{reason}; {observed_text}") if reason else CheckFailed(observed_text)


def _enable_drive(rig: DriveRig) -> None:
    """Enable the drive. If the drive does not report that it is enabled, raise CheckFailed."""
    if not rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.ENABLED, 2.0):
        raise CheckFailed(
            rig.state.error_text or "does not report that it is enabled within 2 s of the command"
        )


def _check_one_answer_per_request(device: DeviceUnderTest) -> str:
    """Check that each request to the drive gets exactly one answer.

    If the bus has a second drive with the same node number, the second drive sends another answer.
    """
    rig = device.rig
    drive = rig.drive
    unsolicited_frames, listened_s = (
        (0, 1.0) if drive.sends_one_reply_per_command else _feedback_frames(rig, DriveTarget.LISTEN)
    )
    answer_frames, polled_s = _feedback_frames(rig, DriveTarget.POLL)
    if drive.feedback_period_s:
        requests = polled_s / drive.feedback_period_s
        text = f"{answer_frames} messages in the time of {requests:.0f}"
    else:
        answer_frames -= round(unsolicited_frames * polled_s / listened_s)
        requests = CHECK_DURATION_TICKS
        text = f"{answer_frames} answers to {requests} requests"
    if answer_frames > MIN_DUPLICATE_ANSWER_RATIO * requests:
        raise CheckFailed(
            f"{text}: another drive has the same number; give each a number of its own"
        )
    return text


def _feedback_frames(rig: DriveRig, target: DriveTarget) -> tuple[int, float]:
    """Run CHECK_DURATION_TICKS ticks, and count the received feedback frames.

    Return the number of feedback frames, and the duration of the ticks [s]. The duration includes
    the ticks that were missed.
    """
    feedback_count_before = rig.state.feedback_count
    start_ns = rig.t_ns
    for _ in range(CHECK_DURATION_TICKS):
        rig.run_tick(target)
    return rig.state.feedback_count - feedback_count_before, (rig.t_ns - start_ns) * 1e-9


def _check_no_torque_when_ready(device: DeviceUnderTest) -> str:
    """Check that a drive in the phase READY makes no torque, even if the host sends torque commands."""
    rig = device.rig
    feedback_count_before = rig.state.feedback_count
    rig.run_for(DriveTarget.POLL, 0.3)
    if rig.state.phase != DrivePhase.READY:
        raise CheckFailed(rig.state.error_text or f"went to {rig.state.phase.name}")
    if math.isfinite(rig.velocity_rad_s) and abs(rig.velocity_rad_s) > MAX_REST_VELOCITY_RAD_S:
        raise CheckNotPossible(f"the shaft turns by itself, {rig.velocity_rad_s:.2g} rad/s")
    result_text = _check_torque_ignored_when_disabled(device)
    if rig.state.phase != DrivePhase.READY:
        raise CheckFailed(
            rig.state.error_text or f"went to {rig.state.phase.name} at a torque command"
        )
    return f"{result_text}; {rig.state.feedback_count - feedback_count_before} feedback frames meanwhile"


def _check_torque_ignored_when_disabled(device: DeviceUnderTest) -> str:
    """Send torque commands to a disabled drive, up to the torque limit of the test.

    If the disabled drive follows the torque commands, raise CheckFailed.
    """
    rig = device.rig
    if not rig.drive.torque_frames(0.0):
        return "without torque commands, because each of them enables"
    start_position = rig.state.position
    initial_reported_torque = rig.state.torque
    initial_speed = abs(rig.velocity_rad_s) if math.isfinite(rig.velocity_rad_s) else 0.0
    reported_torques: list[float] = []
    start_ns = rig.t_ns
    for i in range(CHECK_DURATION_TICKS):
        torque = device.torque_limit_N_m * (i + 1) / CHECK_DURATION_TICKS
        rig.run_tick(DriveTarget.POLL, extra_frames=rig.drive.torque_frames(torque))
        reported_torques.append(rig.state.torque - initial_reported_torque)
        position_change = rig.state.position - start_position
        if abs(position_change) > MIN_MOTION_RAD + initial_speed * (rig.t_ns - start_ns) * 1e-9:
            rig.run_tick(DriveTarget.POLL, extra_frames=rig.drive.torque_frames(0.0))
            raise CheckFailed(
                f"follows torque commands while disabled: {torque:+.3f} N m turned it by {position_change:+.3f} rad"
            )
    # The last command is a torque of zero, because a drive may store the last command and follow
    # this command as soon as the drive is enabled.
    rig.run_tick(DriveTarget.POLL, extra_frames=rig.drive.torque_frames(0.0))
    mean = sum(reported_torques[len(reported_torques) // 2 :]) / (
        len(reported_torques) - len(reported_torques) // 2
    )
    if abs(mean) > OBEYED_TORQUE_FRACTION * device.torque_limit_N_m:
        raise CheckFailed(f"reports {mean:+.3f} N m at torque commands while disabled")
    return f"ignores torque commands up to {device.torque_limit_N_m:+.3f} N m"


def _check_enable_command(device: DeviceUnderTest) -> str:
    """Check that the drive can be enabled, and measure the time until it is enabled."""
    start_ns = device.rig.t_ns
    _enable_drive(device.rig)
    return f"after {(device.rig.t_ns - start_ns) / 1e6:.0f} ms"


def _check_feedback(device: DeviceUnderTest) -> str:
    """Check that an enabled drive sends new feedback in nearly every tick."""
    rig = device.rig
    _enable_drive(rig)
    feedback_count_before = rig.state.feedback_count
    ticks = 100
    ages_ns = []
    for _ in range(ticks):
        state = rig.run_tick(DriveTarget.ENABLE)
        # After a tick, the time of the rig is already the time of the next tick.
        ages_ns.append(rig.t_ns - PERIOD_NS - state.feedback_t_ns)
    ages_ns.sort()
    count = rig.state.feedback_count - feedback_count_before
    high_age_ns = ages_ns[-MAX_LATE_TICKS_PER_100]
    result_text = (
        f"{count} feedback frames in {ticks} ticks, at most {max(ages_ns[-1], 0) / 1e6:.0f} ms old"
    )
    if count < 0.8 * ticks or high_age_ns > MAX_FEEDBACK_AGE_NS:
        raise CheckFailed(result_text)
    return result_text


def _rotation_check(motion_sign: int) -> RequirementCheck:
    """Return a check of the direction of rotation.

    The check tests whether a torque of the given sign turns the shaft in the direction of this
    torque.
    """

    def check_rotation(device: DeviceUnderTest) -> str:
        rig = device.rig
        _enable_drive(rig)
        if not brake_shaft(rig, device.torque_limit_N_m):
            raise CheckNotPossible(f"the shaft turns by itself, {rig.velocity_rad_s:.2g} rad/s")
        step = apply_torque_step(rig, motion_sign, device.torque_limit_N_m)
        if not step.enabled:
            raise CheckFailed(rig.state.error_text or "was no longer enabled")
        if step.moved_rad < -MIN_MOTION_RAD:
            raise CheckFailed(
                f"{step.commanded_torque_N_m:+.3f} N m turned it by "
                f"{motion_sign * step.moved_rad:+.3f} rad, the wrong way"
            )
        if step.moved_rad > MIN_MOTION_RAD:
            brake_shaft(rig, device.torque_limit_N_m)
            reported_text = (
                "no torque"
                if math.isnan(step.reported_torque_N_m)
                else f"{step.reported_torque_N_m:+.3f} N m"
            )
            return f"at {step.commanded_torque_N_m:+.3f} N m; the drive reports {reported_text}"
        raise _no_motion_error(device, motion_sign, step.reported_torque_N_m)

    return check_rotation


def _no_motion_error(device: DeviceUnderTest, motion_sign: int, torque: float) -> Exception:
    """Return the exception for a shaft that did not turn at the torque limit.

    The exception depends on ``torque``, the torque that the drive has reported [N m].
    """
    reported_torque = motion_sign * torque
    limit = f"{motion_sign * device.torque_limit_N_m:+.3f} N m"
    if math.isfinite(reported_torque) and reported_torque < 0.3 * device.torque_limit_N_m:
        return CheckFailed(
            f"{limit} did not turn it, and the drive reports {motion_sign * reported_torque:+.3f} N m"
        )
    return CheckNotPossible(f"did not turn at {limit}: held, or friction is larger")


def _check_torque_limit(device: DeviceUnderTest) -> str:
    """Check that handctl refuses to send a torque that is above the limit or not finite."""
    rig = device.rig
    _enable_drive(rig)
    for torque in (
        1.01 * device.torque_limit_N_m,
        -1.01 * device.torque_limit_N_m,
        math.nan,
        math.inf,
    ):
        try:
            rig.drive.advance(rig.state, rig.t_ns, DriveTarget.ENABLE, torque)
        except ValueError:
            continue
        raise CheckFailed(f"{torque:g} N m would have been sent")
    return f"more than {device.torque_limit_N_m:g} N m, NaN and infinity are refused before they are sent"


def _check_disable_command(device: DeviceUnderTest) -> str:
    """Check that the drive reports that it is disabled, within a second of the disable command."""
    rig = device.rig
    _enable_drive(rig)
    start_ns = rig.t_ns
    if not rig.run_until(DriveTarget.DISABLE, lambda state: state.phase != DrivePhase.ENABLED, 1.0):
        raise CheckFailed("does not report within 1 s of the command that it is disabled")
    if rig.state.phase == DrivePhase.FAULT:
        raise CheckFailed(f"reports a fault after the disable command: {rig.state.error_text}")
    duration_text = f"after {(rig.t_ns - start_ns) / 1e6:.0f} ms"
    # Some drives do not report whether they are enabled. A drive that does not report its state
    # gets torque commands after the disable command. The torque commands show whether the drive has
    # ignored the disable command.
    rig.run_for(DriveTarget.DISABLE, 0.05)
    return f"{duration_text}; {_check_torque_ignored_when_disabled(device)}"


def _check_watchdog(device: DeviceUnderTest) -> str:
    """Check that the watchdog disables the drive when the host sends no frames.

    Also check that the drive stays disabled when the host sends frames again.
    """
    rig = device.rig
    _enable_drive(rig)
    silence_s = max(HOST_SILENCE_S, 3.0 * device.watchdog_s)
    rig.run_for(DriveTarget.LISTEN, silence_s)
    if not rig.run_until(DriveTarget.ENABLE, lambda state: state.phase != DrivePhase.ENABLED, 0.5):
        result_text = f"still enabled after {silence_s * 1e3:.0f} ms without a command"
        raise _failed_check_error(device, DriveProperty.WATCHDOG, result_text)
    text = rig.state.error_text
    rig.run_for(DriveTarget.ENABLE, 0.3)
    if rig.state.phase != DrivePhase.FAULT:
        raise CheckFailed(f"{text}, and then enabled again without being cleared")
    return text


def _check_fault_clearing(device: DeviceUnderTest) -> str:
    """Check that the torque cut disables the drive.

    Also check that the drive is ready again after its faults are cleared.
    """
    rig = device.rig
    _enable_drive(rig)
    rig.cut_torque()
    rig.run_for(DriveTarget.LISTEN, 0.3)
    if not rig.run_until(DriveTarget.ENABLE, lambda state: state.phase != DrivePhase.ENABLED, 0.5):
        raise _failed_check_error(device, DriveProperty.CUT, "no sign that the cut has disabled it")
    text = rig.state.error_text
    rig.clear_faults()
    if not rig.run_until(DriveTarget.POLL, lambda state: state.phase == DrivePhase.READY, 3.0):
        raise CheckFailed(rig.state.error_text or "does not become ready after the clear")
    return f"{text or 'off'}, and ready again after a clear"


def _check_frames_decodable(device: DeviceUnderTest) -> str:
    """Check that every frame received from the drive could be decoded."""
    state = device.rig.state
    if state.misread_frame_count:
        raise CheckFailed(
            f"{state.misread_frame_count} frames on its identifiers could not be decoded"
        )
    return (
        f"{state.feedback_count} feedback frames, every frame on its identifiers could be decoded"
    )


def release_drive(rig: DriveRig, watchdog_s: float, original_drive: Drive | None = None) -> bool:
    """Disable the drive, clear the errors of the drive, and send the frames that end a run.

    Return True if the drive reports that it is disabled.

    After the frames that end a run, the next program can use the drive. The frames tell the drive
    that its host has ended, so that the drive does not report the loss of its host.

    Args:
        rig: test rig with a drive in any state.
        watchdog_s: timeout of the drive's watchdog [s].
        original_drive: description of the drive with the settings to restore. If ``original_drive``
            is None, the drive keeps its present settings.
    """
    if not rig.confirm_disabled(watchdog_s):
        return False
    if original_drive is not None:
        rig.replace_drive(original_drive)
    rig.clear_faults()
    rig.run_until(DriveTarget.POLL, lambda state: state.phase == DrivePhase.READY, 3.0)
    rig.send_release()
    return True


CHECKED_REQUIREMENTS: tuple[tuple[str, RequirementCheck, bool], ...] = (
    ("identifies itself, takes its settings and reads them back", _check_configuration, False),
    ("is the only drive with its number", _check_one_answer_per_request, False),
    ("makes no torque until it is enabled", _check_no_torque_when_ready, False),
    ("enables on command, and reports it", _check_enable_command, False),
    ("gives feedback in every tick", _check_feedback, False),
    ("turns the positive way by positive torque", _rotation_check(1), True),
    ("turns the negative way by negative torque", _rotation_check(-1), True),
    ("refuses commands above its limit", _check_torque_limit, False),
    ("disables on command, and reports it", _check_disable_command, False),
    ("disables itself when the host falls silent, and stays off", _check_watchdog, False),
    ("is cut at once, and cleared on command only", _check_fault_clearing, False),
    ("sends only frames that can be decoded", _check_frames_decodable, False),
)
"""For each checked requirement: the words of the requirement, its check, and True if the check turns the shaft."""
