"""Jog of one drive on a bench, in torque, position or velocity mode.

The host and the drive both limit the motion. The host changes the command along a ramp. The host
stops the drive if the shaft turns too fast or leaves the permitted travel. The host also stops the
drive if the torque is too large or feedback is missing. After a stop by the host, the drive is not
enabled again.
"""

import math
from typing import NamedTuple

from handctl.drives.contract import DrivePhase, DriveState, DriveTarget
from handctl.drives.drive_modes import COMMAND_UNITS, DriveMode, MotionLimits
from handctl.runtime.diagnostics.drive_rig import PERIOD_NS, DriveRig

PERIOD_S = PERIOD_NS * 1e-9
"""Period of a tick [s]."""
HOST_LIMIT_FRACTION = 0.8
"""Speed and acceleration of the host's ramps, as fractions of the drive's limits.

With these ramps, the drive never reaches its own limits.
"""
TORQUE_RAMP_S = 0.2
"""Duration of a ramp of the torque command from zero to the limit [s]."""
OVERSPEED_FACTOR = 1.5
"""Measured speed above which the jog stops, as a multiple of the speed limit."""
OVERSPEED_MARGIN_RAD_S = 0.5
"""Speed added to the overspeed threshold, because the measured speed of a slow shaft is noisy [rad/s]."""
OVERTORQUE_FACTOR = 1.5
"""Reported torque above which the jog stops, as a multiple of the torque limit."""
MAX_TICKS_BEYOND_LIMIT = 4
"""Number of consecutive ticks with too much speed or torque after which the jog stops."""
MAX_MISSED_TICKS = 10
"""Largest number of ticks in a row that a late host is allowed to miss before the jog stops.

After missed ticks, the command takes the steps of the missed ticks at once.
"""
SILENCE_TIMEOUT_NS = 100_000_000
"""Age of the latest feedback above which the jog stops [ns]."""
HOLD_DURATION_S = 0.2
"""Time at the end of a jog in which the drive holds its position, or stands still [s]."""


class JogGoal(NamedTuple):
    """Requested motion of one drive.

    Attributes:
        mode: mode of the drive: torque, position or velocity.
        target: target in the mode of the drive: torque [N m], velocity [rad/s], or position
            relative to the start [rad].
        duration_s: duration of the motion [s].
        limits: largest speed and largest acceleration of the shaft.
        max_torque_N_m: torque limit of the drive [N m].
        max_travel_rad: largest permitted distance of the shaft from its start [rad].
    """

    mode: DriveMode
    target: float
    duration_s: float
    limits: MotionLimits
    max_torque_N_m: float
    max_travel_rad: float


class JogResult(NamedTuple):
    """Result of a jog, computed from the values that the drive has reported.

    Attributes:
        failure: reason why the motion stopped early, in one line. The text is empty if the motion
            was complete.
        moved_rad: angle of the shaft at the end of the jog, relative to its start [rad].
        max_speed_rad_s: largest measured speed [rad/s].
        max_torque_N_m: largest reported torque [N m], or NaN if the drive reports no torque.
        final_speed_rad_s: measured speed shortly before the drive is disabled at the end [rad/s].
    """

    failure: str
    moved_rad: float = 0.0
    max_speed_rad_s: float = 0.0
    max_torque_N_m: float = math.nan
    final_speed_rad_s: float = math.nan


def distance_at(t_s: float, distance: float, speed: float, acceleration: float) -> float:
    """Return the position at a time in a motion that starts and ends at rest [rad].

    The velocity of the motion is a trapezoid over time.

    Args:
        t_s: time since the start of the motion [s].
        distance: whole distance of the motion [rad]. A negative distance is a motion backwards.
        speed: largest speed of the motion [rad/s].
        acceleration: acceleration and deceleration [rad/s2].
    """
    length = abs(distance)
    top_speed = min(speed, math.sqrt(length * acceleration))
    ramp_s = top_speed / acceleration
    total_s = ramp_s + (length / top_speed if top_speed > 0.0 else 0.0)
    if t_s >= total_s:
        return distance
    if t_s < ramp_s:
        travelled_distance = 0.5 * acceleration * t_s * t_s
    elif t_s < total_s - ramp_s:
        travelled_distance = top_speed * (t_s - 0.5 * ramp_s)
    else:
        travelled_distance = length - 0.5 * acceleration * (total_s - t_s) ** 2
    return math.copysign(travelled_distance, distance)


class _JogExecution:
    """Execution of a jog, a short motion of one drive.

    The execution computes the commands of the jog, checks its limits, and collects its result.
    """

    def __init__(self, rig: DriveRig, goal: JogGoal) -> None:
        self._rig = rig
        self._goal = goal
        self._start = 0.0
        self._command = 0.0
        self._command_t_ns = 0
        self._ticks_beyond_limit = 0
        self.max_speed_rad_s = 0.0
        self.max_torque_N_m = math.nan

    @property
    def moved_rad(self) -> float:
        """Return the present angle of the shaft, relative to the start of the motion [rad]."""
        return self._rig.state.position - self._start

    @property
    def _is_position_mode(self) -> bool:
        return COMMAND_UNITS[self._goal.mode] == "rad"

    def hold_command(self, state: DriveState) -> float:
        """Return the command that keeps the shaft still.

        In position mode, the command is the last position. In velocity or torque mode, the command
        is zero.
        """
        if not self._is_position_mode:
            return 0.0
        return self._command if state.phase == DrivePhase.ENABLED else state.position

    def enable_at_rest(self) -> str:
        """Enable the drive while the shaft is at rest.

        Return a description of the problem, or an empty text if the drive is enabled.
        """
        rig = self._rig
        if not rig.run_until(DriveTarget.POLL, lambda state: state.phase == DrivePhase.READY, 5.0):
            return rig.reason_not_ready()
        # The start position is read only after the drive is ready. Before the drive has got its
        # settings, the positions that the drive sends may have another scale.
        rig.run_for(DriveTarget.POLL, HOLD_DURATION_S)
        self._start = rig.state.position
        if not math.isfinite(self._start):
            return "reports no position"
        max_distance = abs(self._start) + abs(self._goal.target)
        if self._is_position_mode and max_distance > rig.drive.command_limit:
            return f"is at {self._start:+.2f} rad, the target is beyond its range of {rig.drive.command_limit:g} rad"
        self._command = self._start if self._is_position_mode else 0.0
        if not rig.run_until(
            DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.ENABLED, 2.0
        ):
            return (
                rig.state.error_text
                or "does not report that it is enabled within 2 s of the command"
            )
        return ""

    def execute_motion(self) -> str:
        """Command the position, velocity or torque of the jog, until the duration of the jog is over.

        Return the reason why the motion stopped early, or an empty text.
        """
        start_ns = self._command_t_ns = self._rig.t_ns - PERIOD_NS
        t_s = 0.0
        while t_s < self._goal.duration_s:
            # Even if ticks were missed before, the last command is the command for the end of the
            # motion.
            t_s = min((self._rig.t_ns - start_ns) / 1e9, self._goal.duration_s)
            if problem := self._run_tick(self._command_at(t_s)):
                return problem
        return ""

    def bring_to_rest(self) -> str:
        """Bring velocity or torque to zero along a ramp, or hold the position.

        Bringing the drive to rest takes at least ``HOLD_DURATION_S``. Return the reason for an
        early stop, or an empty text.
        """
        ramp_s = 0.0
        if self._goal.mode == DriveMode.VELOCITY:
            ramp_s = abs(self._command) / (HOST_LIMIT_FRACTION * self._goal.limits.acceleration)
        elif self._goal.mode == DriveMode.TORQUE:
            ramp_s = TORQUE_RAMP_S
        for _ in range(math.ceil((ramp_s + HOLD_DURATION_S) / PERIOD_S)):
            if problem := self._run_tick(
                self._command if self._is_position_mode else self._ramped_command(0.0)
            ):
                return problem
        return ""

    def _command_at(self, t_s: float) -> float:
        """Return the command for the time ``t_s`` [s] after the start of the motion."""
        goal = self._goal
        if not self._is_position_mode:
            return self._ramped_command(goal.target)
        speed = HOST_LIMIT_FRACTION * goal.limits.speed
        return self._start + distance_at(
            t_s, goal.target, speed, HOST_LIMIT_FRACTION * goal.limits.acceleration
        )

    def _ramped_command(self, target_value: float) -> float:
        """Return the next command of a ramp to a target velocity or torque.

        The step from the last command is proportional to the time since the last command. This time
        includes missed ticks.
        """
        goal = self._goal
        rate = goal.max_torque_N_m / TORQUE_RAMP_S
        if goal.mode == DriveMode.VELOCITY:
            rate = HOST_LIMIT_FRACTION * goal.limits.acceleration
        step = rate * (self._rig.t_ns - self._command_t_ns) * 1e-9
        return self._command + min(step, max(-step, target_value - self._command))

    def _run_tick(self, command: float) -> str:
        """Send a command, and check the drive's answer against the limits.

        Return the reason why the motion must stop, or an empty text.
        """
        self._command = command
        self._command_t_ns = self._rig.t_ns
        state = self._rig.run_tick(DriveTarget.ENABLE, command)
        if self._rig.missed_ticks > MAX_MISSED_TICKS:
            return f"the host missed {self._rig.missed_ticks} ticks in a row, expected at most {MAX_MISSED_TICKS}"
        if state.phase != DrivePhase.ENABLED:
            return state.error_text or f"went to {state.phase.name}"
        # The time of the rig is already the time of the next tick. Therefore the age computed here
        # is one period larger than the age was in the tick.
        if self._rig.t_ns - state.feedback_t_ns > SILENCE_TIMEOUT_NS:
            return f"no feedback for {SILENCE_TIMEOUT_NS / 1e6:.0f} ms"
        return self._violated_limit(state)

    def _violated_limit(self, state: DriveState) -> str:
        """Return the reason to stop if speed, torque or travel exceed their limits.

        If no limit is exceeded, return an empty text.
        """
        goal = self._goal
        speed = abs(self._rig.velocity_rad_s)
        torque = abs(state.torque)
        self.max_speed_rad_s = (
            max(self.max_speed_rad_s, speed) if math.isfinite(speed) else self.max_speed_rad_s
        )
        if math.isfinite(torque):
            self.max_torque_N_m = (
                torque if math.isnan(self.max_torque_N_m) else max(self.max_torque_N_m, torque)
            )
        if abs(self.moved_rad) > goal.max_travel_rad:
            return f"moved {self.moved_rad:+.2f} rad, expected at most {goal.max_travel_rad:g}"
        is_too_fast = speed > OVERSPEED_FACTOR * goal.limits.speed + OVERSPEED_MARGIN_RAD_S
        is_torque_too_large = torque > OVERTORQUE_FACTOR * goal.max_torque_N_m
        self._ticks_beyond_limit = (
            self._ticks_beyond_limit + 1 if is_too_fast or is_torque_too_large else 0
        )
        if self._ticks_beyond_limit < MAX_TICKS_BEYOND_LIMIT:
            return ""
        if is_too_fast:
            return f"turns at {speed:.2f} rad/s, expected at most {goal.limits.speed:g}"
        return f"reports {torque:.3g} N m, expected at most {goal.max_torque_N_m:g}"


def jog_drive(rig: DriveRig, goal: JogGoal) -> JogResult:
    """Enable a drive, move it, and bring it to rest. The caller must disable the drive.

    Args:
        rig: rig with the drive in the mode of the goal.
        goal: motion to execute.
    """
    motion = _JogExecution(rig, goal)
    rig.idle_command = motion.hold_command
    failure = motion.enable_at_rest()
    if failure:
        return JogResult(failure)
    failure = motion.execute_motion() or motion.bring_to_rest()
    if failure:
        rig.cut_torque()
    return JogResult(
        failure,
        motion.moved_rad,
        motion.max_speed_rad_s,
        motion.max_torque_N_m,
        abs(rig.velocity_rad_s),
    )
