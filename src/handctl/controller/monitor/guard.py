"""What one tick shows to safety: ages, errors, frames that should not be, and what the watcher makes of the rest."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handctl.choose import chosen, nothing, zeros
from handctl.compiled import kernel
from handctl.controller.monitor.motors import Motors
from handctl.controller.monitor.received import Received
from handctl.controller.monitor.surplus import surplus
from handctl.controller.monitor.thresholds import make_watcher
from handctl.controller.state import State
from handctl.core.estimation.estimator import Measured
from handctl.core.law.computed_torque import Command
from handctl.core.model import HandModel
from handctl.core.types import ACTING, Event, Mode, TickIn, Vector
from handctl.drives.causes import Cause
from handctl.drives.contract import Drive, DriveState, Phase
from handctl.drives.frame import EXTENDED, REMOTE
from handctl.drives.sensors.node import SensorNode, SensorState
from handctl.programs.program import TARE_PHASE
from handctl.safety.detectors import stuck
from handctl.safety.detectors.answers import asked
from handctl.safety.signals import (
    LEAST_SILENT,
    LOAD_CELLS,
    SILENT_S,
    Named,
    Signals,
    ticks_for,
)
from handctl.safety.watch import Seen, Watcher, WatchState, counted, screen, watched

CUT_OFF = (Mode.CUT, Mode.DISARM)
"""Modes in which no torque must act any more."""
READY, FAULT = Phase.READY, Phase.FAULT
"""As names of this module: looking a member up in its enumeration costs more than comparing it."""
MUTE = (Mode.SILENT, Mode.DONE)
"""Modes in which nothing is asked."""
NEVER = 1_000_000
"""Age of what never came [ticks]."""
FOLLOW_S = 0.1
"""Time in which a motor follows a goal that jumps, several times over [s]."""
RELAXED_S = 0.1
"""After so long of relaxing no rope of a motor that obeys is above its trip [s]."""
SLOW_M_S = 2e-3
"""What moves no faster is followed at once [m/s]."""
ARRIVED_M = 0.2e-3
"""From the goal: a motor that stands there is where it was to go."""
LEAP_M = 2.0 * ARRIVED_M
"""In one tick: further than what is already there goes along with a digit that arrives."""


@dataclass(frozen=True, slots=True)
class Guard:
    """What never changes.

    Attributes:
        model: the hand. drives: per motor. sensors: the node.
        watcher: of safety.
        cyclic_ns: per motor, how often feedback comes by itself [ns]; 0 if every tick asks for it.
        period_ns: control period [ns].
        mute_ns: after so long without a frame joint encoders are silent [ns].
    """

    model: HandModel
    drives: tuple[Drive, ...]
    sensors: SensorNode
    watcher: Watcher
    cyclic_ns: tuple[int, ...]
    period_ns: int
    mute_ns: int

    @staticmethod
    def of(model: HandModel, drives: tuple[Drive, ...], sensors: SensorNode) -> "Guard":
        """The guard of a hand."""
        cyclic_ns = tuple(round(drive.feedback_period_s * 1e9) for drive in drives)
        watcher = make_watcher(model, drives, sensors)
        every = watcher.rotor.joint_period
        mute_ns = round(ticks_for(SILENT_S, every, LEAST_SILENT) * every * 1e9)
        return Guard(model, drives, sensors, watcher, cyclic_ns, round(model.period * 1e9), mute_ns)

    def screen(self, state: State, measured: Measured, missed: int) -> tuple[WatchState, Measured, Named]:
        """Drop positions that cannot be, so long after the last tick, before anything else sees them; under torque."""
        if state.mode not in ACTING:
            return state.watch, measured, ()
        joints = measured.joints if measured.read else None
        watch, motor, joint = screen(self.watcher, state.watch, measured.position, joints, missed)
        if motor is None and joint is None:
            return watch, measured, ()
        n, j = len(self.drives), len(self.watcher.joints)
        motor, joint = zeros(n) if motor is None else motor, zeros(j) if joint is None else joint
        read, nowhere = chosen(joint > 0.0, nothing(j), measured.joints), motor > 0.0
        dropped = measured._replace(
            position=chosen(nowhere, nothing(n), measured.position),
            travel=chosen(nowhere, nothing(n), measured.travel),
            joints=read,
            excursion=self.model.excursion_of(read),
        )
        names = (*self.watcher.limits.motors, *self.watcher.joints)
        jumps = zip(names, (*motor.tolist(), *joint.tolist()), strict=True)
        return watch, dropped, tuple((name, size) for name, size in jumps if size > 0.0)

    def look(
        self,
        before: State,
        state: State,
        entry: TickIn,
        received: Received,
        told: Iterable[Event],
    ) -> tuple[WatchState, Signals]:
        """Facts of this tick for safety.

        Args:
            before: state before the tick. state: with what was received in it, and screened.
            entry: of the tick.
            received: in it.
            told: events of this tick's requests.
        """
        measured, motors = received.measured, received.motors
        raw = self._raw(before, state, entry, received)
        counts = zip(motors.feedback_count, received.counts_before, strict=True)
        extra = surplus(self.drives, self.sensors, before, state, entry.frames, [now - was for now, was in counts])
        if extra.twice or extra.unasked:
            raw = raw._replace(twice=extra.twice, foreign=(*raw.foreign, *extra.unasked))
        shapes = self._misshapen(before, state, received)
        refused = len([event for event in told if event.level == "warn"])
        watch = state.watch._replace(owed=extra.owed)
        watch, raw = counted(self.watcher, watch, raw, shapes, (len(received.strange), refused), entry.k)
        force = np.array(motors.torque) / self.model.space.spool
        np.putmask(force, np.isnan(measured.travel), np.nan)
        tared = state.progress.phase != TARE_PHASE  # until then a load cell may read anything
        seen = Seen(
            tension=measured.tension if tared else nothing(len(force)),
            travel=measured.travel,
            position=measured.position,
            speed=received.estimate.speed,
            force=force,
            excursion=measured.excursion,
            joints=measured.joints,
            read=measured.read,
            cut=state.mode in CUT_OFF,
        )
        return watched(self.watcher, watch, raw, seen)

    def _raw(self, before: State, state: State, entry: TickIn, received: Received) -> Signals:
        motors = received.motors
        return Signals(
            armed=state.mode in ACTING,
            missed=entry.k - before.k - 1,
            late=entry.late_ns / self.period_ns,
            motor_age=self._ages(motors.feedback_t_ns, entry.t_ns, self.cyclic_ns),
            sensor_age=self._ages(self.sensors.tension_times(state.sensors), entry.t_ns),
            tension=tuple(received.measured.tension.tolist()),
            temperature=motors.temperature,
            frames=len(entry.frames),
            heard=state.mode in ACTING or _heard(state),
            relaxed=state.mode == Mode.RELAX and entry.t_ns * 1e-9 - state.mode_since > RELAXED_S,
            drive_errors=self._errors(motors) if FAULT in motors.phase else (),
            foreign=received.foreign,
            io=tuple([(event.kind, event.where, event.number) for event in entry.io_events]),
            stale=self._stale(before, state, entry),
            jumped=received.jumped,
            jumping=self._jumping(state.watch, received.jumped) if received.jumped else (),
            mute=self._mute(state, entry.t_ns),
            railed=self._railed(received.measured) if received.measured.railed else (),
        )

    def _jumping(self, watch: WatchState, jumped: Named) -> Named:
        """Of what jumped, that which had jumped in the reading before."""
        names = (*self.watcher.limits.motors, *self.watcher.joints)
        dropped = dict(zip(names, (*watch.motors.dropped, *watch.joints.dropped), strict=True))
        return tuple([(name, size) for name, size in jumped if dropped[name] > 1.0])

    def _railed(self, measured: Measured) -> Named:
        """Tendons whose load cell is at an end of its range, and what it reads [N]."""
        tendons = self.watcher.limits.tendons
        return tuple([(tendons[i], float(measured.tension[i])) for i in measured.railed])

    def _mute(self, state: State, now_ns: int) -> Named:
        """Joint frames that have not come for too long: the first joint of each, and since when [s]."""
        rows, joints, since = self.sensors.joint_times(state.sensors), self.watcher.joints, now_ns - self.mute_ns
        return tuple([(joints[i], (now_ns - t_ns) * 1e-9) for i, t_ns in rows if t_ns < since])

    def _ages(self, times_ns: tuple[int, ...], now_ns: int, cyclic_ns: tuple[int, ...] = ()) -> tuple[int, ...]:
        """Whole ticks by which readings are overdue; one that came within the last period is on time."""
        n, period_ns = len(times_ns), self.period_ns
        if min(times_ns) > max(-1, now_ns - period_ns):
            return (0,) * n
        rows = zip(times_ns, cyclic_ns or (0,) * n, strict=True)
        return tuple([max(0, (now_ns - own - t_ns) // period_ns) if t_ns >= 0 else NEVER for t_ns, own in rows])

    def _errors(self, motors: Motors) -> tuple[tuple[str, int, Cause], ...]:
        """Name, code and cause of every drive in fault."""
        rows = zip(self.drives, motors.phase, motors.error, strict=True)
        return tuple([(drive.name, error, drive.cause(error)) for drive, phase, error in rows if phase == FAULT])

    def _stale(self, before: State, state: State, entry: TickIn) -> Named:
        """Whether the load cells answered an older question, and whether the fresh answer had come before."""
        if state.sensors.stale == before.sensors.stale:
            return ()
        seen: set[int] = set()
        behind = 0.0
        for frame in entry.frames:
            if frame.bus == self.sensors.bus and frame.can_id in self.sensors.ids and frame.data:
                fresh = frame.data[0] & 0xF == before.sensors.asked
                behind = max(behind, float(frame.can_id in seen and not fresh))
                seen |= {frame.can_id} if fresh else set()
        return ((LOAD_CELLS, behind),)

    def _misshapen(self, before: State, state: State, received: Received) -> tuple[bool, ...]:
        """Per node, whether a frame of a wrong shape came."""
        now = received.motors.misread
        shapes = [drive.misread != count for drive, count in zip(before.drives, now, strict=True)]
        shapes.append(before.sensors.misread != state.sensors.misread)
        for frame in received.strange:
            if not frame.can_id & (EXTENDED | REMOTE):
                continue
            plain = frame.can_id & 0x7FF
            for i, drive in enumerate(self.drives):
                shapes[i] |= frame.bus == drive.bus and plain in drive.node_ids
            shapes[-1] |= frame.bus == self.sensors.bus and plain in self.sensors.node_ids
        return tuple(shapes)

    def commanded(
        self,
        watch: WatchState,
        mode: Mode,
        command: Command,
        drives: tuple[DriveState, ...],
        k: int,
        excursion: Vector | None = None,
    ) -> WatchState:
        """Remember what tick k asks and commands, for what the next one hears.

        Args:
            watch: so far. mode: after the tick. command: of it. drives: as they were before it. k: its number.
            excursion: (N,) where the digits are [m].
        """
        acts, goes = mode in (Mode.ACTIVE, Mode.RELAX), mode == Mode.ACTIVE
        unknown = nothing(len(command.torque))
        goal, stands = unknown, watch.stuck
        if goes:
            goal, stands = self._followed(watch, self.model.excursion_of(command.q), excursion)
        return watch._replace(
            asked=command.torque / self.model.space.spool if acts else unknown,
            wanted=command.tension if goes else unknown,
            goal=goal,
            stuck=stands,
            owed=watch.owed if mode in MUTE else asked(watch.owed, [drive.phase >= READY for drive in drives], k),
        )

    def _followed(self, watch: WatchState, goal: Vector, excursion: Vector | None) -> tuple[Vector, stuck.Stuck]:
        """(N,) goals as a motor can follow them [m], and readings that stand: where a goal jumps, a motor that has not
        moved yet is not stuck.

        While a reading moves this is the goal itself, so that what counts is how far the goal has gone since it stands:
        friction may have stopped the motor short of it. Nor is one stuck that rests where it was to go while this is
        still on its way: from there on it is where the digit is. If it leaps there, no motor had to follow.
        """
        stands = watch.stuck
        share, least = 1.0 - math.exp(-self.model.period / FOLLOW_S), SLOW_M_S * self.model.period
        there = nothing(len(goal)) if excursion is None else excursion
        moved, leaps = _led(watch.goal, goal, there, stands.ticks, share, least)
        if np.count_nonzero(leaps):
            stands = stuck.leapt(stands, leaps, there - watch.goal)
        return moved, stands


@kernel("vector", "vector", "vector", "counts", "real", "real")
def _led(
    before: Vector, goal: Vector, excursion: Vector, ticks: NDArray[np.int64], share: float, least: float
) -> tuple[Vector, NDArray[np.bool_]]:
    """Lead each motor to its goal as it can follow; see ``Guard._followed``.

    Args:
        before: (N,) where it was led in the last tick [m]; NaN if nowhere.
        goal: (N,) [m]. excursion: (N,) where the digits are [m]; NaN if unknown.
        ticks: (2 N + J,) for how long each reading stands, those of the motors first.
        share: of the way to the goal in a tick. least: way in a tick [m].

    Returns:
        (N,) goals as the motors can follow them [m], and where these leap to a digit that has arrived.
    """
    moved, leaps = goal.copy(), np.zeros(len(goal), dtype=np.bool_)
    for n in range(len(goal)):
        if math.isnan(before[n]):
            continue
        way = goal[n] - before[n]
        if abs(way) > least and ticks[n] != 0:
            moved[n] = before[n] + math.copysign(max(share * abs(way), least), way)
        if abs(goal[n] - excursion[n]) < ARRIVED_M:
            moved[n] = excursion[n]
            leaps[n] = abs(excursion[n] - before[n]) > LEAP_M
    return moved, leaps


def _heard(state: State) -> bool:
    drives: tuple[DriveState, ...] = state.drives
    sensors: SensorState = state.sensors
    return any(drive.phase != Phase.SILENT for drive in drives) or any(group.frames for group in sensors.groups)
