"""What one tick shows to safety: ages, errors, frames that should not be, and what the watcher makes of the rest."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from handctl.controller.computed_torque import Command
from handctl.controller.estimator import Estimate, Measured
from handctl.controller.model import HandModel
from handctl.controller.program import TARE_PHASE
from handctl.controller.state import State
from handctl.controller.types import Event, Mode, TickIn
from handctl.drives.contract import Drive, DriveState, Phase
from handctl.drives.frame import EXTENDED, REMOTE, Frame
from handctl.drives.sensor_node import SensorNode, SensorState
from handctl.safety.residuals import Rotor
from handctl.safety.signals import (
    LEAST_SILENT,
    LEAST_STALLED,
    LOAD_CELLS,
    SILENT_S,
    STALLED_S,
    Limits,
    Named,
    Signals,
    ticks_for,
)
from handctl.safety.watch import JUMP_MARGIN, Seen, Watcher, WatchState, counted, screen, watched

ACTING = (Mode.ARMING, Mode.ACTIVE, Mode.RELAX)
CUT_OFF = (Mode.CUT, Mode.DISARM)
"""Modes in which torque may act, and in which none must act any more."""
FAULT = Phase.FAULT
"""As a name of this module: looking a member up in its enumeration costs more than comparing it."""
JOINT_RATE_RAD_S = 60.0
"""Faster than any joint of a hand. Source: spool speed of the packaged hands over their smallest moment arm."""
OWED = 0xFF
"""Ticks back, as bits, from which an answer may still come: a host that is busy for some milliseconds gets several at
once."""
NOISE_TIMES, NOISE_STEPS = 9.0, 6.0
"""A noise burst has so many times the variance of: drive torque on the bare rotor, and so many counts of rounding."""


@dataclass(frozen=True, slots=True)
class Guard:
    """What never changes.

    Attributes:
        model: the hand. drives: per motor. sensors: the node.
        watcher: of safety.
        strict: per motor, whether each command has exactly one answer.
        cyclic_ns: per motor, how often feedback comes by itself [ns]; 0 if every tick asks for it.
    """

    model: HandModel
    drives: tuple[Drive, ...]
    sensors: SensorNode
    watcher: Watcher
    strict: tuple[bool, ...]
    cyclic_ns: tuple[int, ...]

    @staticmethod
    def of(model: HandModel, drives: tuple[Drive, ...], sensors: SensorNode) -> "Guard":
        """The guard of a hand."""
        strict = tuple(drive.answers_once for drive in drives)
        cyclic_ns = tuple(round(drive.feedback_period_s * 1e9) for drive in drives)
        return Guard(model, drives, sensors, make_watcher(model, drives, sensors), strict, cyclic_ns)

    def screen(self, state: State, measured: Measured) -> tuple[WatchState, Measured, Named]:
        """Drop positions that cannot be, before anything else sees them; only under torque."""
        if state.mode not in ACTING:
            return state.watch, measured, ()
        spool = self.model.space.spool
        watch, motors, joints = screen(self.watcher, state.watch, measured.travel / spool, measured.joints)
        if not np.count_nonzero(motors) and not np.count_nonzero(joints):
            return watch, measured, ()
        read = np.where(joints > 0.0, np.nan, measured.joints)
        travel = np.where(motors > 0.0, np.nan, measured.travel)
        dropped = measured._replace(travel=travel, joints=read, excursion=self.model.excursion_of(read))
        names = (*self.watcher.limits.motors, *self.watcher.joints)
        jumps = zip(names, (*motors.tolist(), *joints.tolist()), strict=True)
        return watch, dropped, tuple((name, size) for name, size in jumps if size > 0.0)

    def look(
        self,
        before: State,
        state: State,
        entry: TickIn,
        measured: Measured,
        estimate: Estimate,
        strange: tuple[Frame, ...],
        foreign: tuple[str, ...],
        jumped: Named,
        told: Iterable[Event],
    ) -> tuple[WatchState, Signals]:
        """Facts of this tick for safety.

        Args:
            before: state before the tick. state: with what was received in it, and screened.
            entry: of the tick.
            measured, estimate: of the tick.
            strange: frames that are nobody's. foreign: identifiers that only this host may send.
            jumped: positions that were dropped.
            told: events of this tick's requests.
        """
        raw = self._raw(before, state, entry, measured, foreign, jumped)
        shapes = self._misshapen(before, state, strange)
        refused = sum(event.level == "warn" for event in told)
        watch, raw = counted(self.watcher, state.watch, raw, shapes, (len(strange), refused), entry.k)
        torque = np.array([drive.torque for drive in state.drives])
        tared = state.progress.phase != TARE_PHASE  # until then a load cell may read anything
        seen = Seen(
            tension=measured.tension if tared else np.full_like(measured.tension, np.nan),
            travel=measured.travel,
            speed=estimate.speed,
            force=np.where(np.isnan(measured.travel), np.nan, torque / self.model.space.spool),
            excursion=measured.excursion,
            joints=measured.joints,
            cut=state.mode in CUT_OFF,
        )
        return watched(self.watcher, watch, raw, seen)

    def _raw(
        self,
        before: State,
        state: State,
        entry: TickIn,
        measured: Measured,
        foreign: tuple[str, ...],
        jumped: Named,
    ) -> Signals:
        period_ns = round(self.model.period * 1e9)
        drives = state.drives
        return Signals(
            armed=state.mode in ACTING,
            missed=entry.k - before.k - 1,
            late=entry.late_ns / period_ns,
            motor_age=tuple(
                [
                    _ticks_since(drive.feedback_t_ns, entry.t_ns - cyclic, period_ns)
                    for drive, cyclic in zip(drives, self.cyclic_ns, strict=True)
                ]
            ),
            sensor_age=tuple(
                [_ticks_since(t_ns, entry.t_ns, period_ns) for t_ns in self.sensors.tension_times(state.sensors)]
            ),
            tension=tuple(measured.tension.tolist()),
            drive_errors=tuple(
                [
                    (drive.name, known.error, drive.cause(known.error))
                    for drive, known in zip(self.drives, drives, strict=True)
                    if known.phase == FAULT
                ]
            ),
            temperature=tuple([drive.temperature for drive in drives]),
            foreign=foreign,
            io=tuple([(event.kind, event.where, event.number) for event in entry.io_events]),
            frames=len(entry.frames),
            heard=_heard(state),
            twice=self._twice(before, state, entry),
            stale=self._stale(before, state, entry),
            jumped=jumped,
        )

    def _twice(self, before: State, state: State, entry: TickIn) -> Named:
        """Nodes that answered more often than they were asked."""
        found = []
        for i, (drive, old, new) in enumerate(zip(self.drives, before.drives, state.drives, strict=True)):
            extra = new.feedback_count - old.feedback_count
            if extra > 1 and self.strict[i] and extra > self._owed(before, i, entry, old, new):
                payloads = [f.data for f in entry.frames if f.bus == drive.bus and f.can_id in drive.node_ids]
                found.append((drive.name, float(payloads[-1] != payloads[-2])))
        for can_id, was, now in zip(self.sensors.ids, before.sensors.groups, state.sensors.groups, strict=True):
            if now.frames > was.frames + 1:
                payloads = [f.data for f in entry.frames if f.bus == self.sensors.bus and f.can_id == can_id]
                found.append((LOAD_CELLS, float(payloads[-1] != payloads[-2])))
        return tuple(found)

    def _owed(self, before: State, motor: int, entry: TickIn, old: DriveState, new: DriveState) -> int:
        """Answers that may come in one tick: its own, and those that were late in the last few.

        A bus without stamps of its own gives a frame the time at which it was taken off, after the tick's beginning:
        there one that came a little after the tick before cannot be told from a fresh one, so one more is owed.
        """
        period_ns = round(self.model.period * 1e9)
        taken_off = new.feedback_t_ns >= entry.t_ns
        since = entry.t_ns // period_ns - old.feedback_t_ns // period_ns
        ticks = max(1, since + 1 if taken_off else (entry.t_ns - old.feedback_t_ns) // period_ns)
        lost = before.watch.counts.lost
        return ticks + ((lost[motor] & OWED).bit_count() if lost else 0)

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

    def _misshapen(self, before: State, state: State, strange: tuple[Frame, ...]) -> tuple[bool, ...]:
        """Per node, whether a frame of a wrong shape came."""
        old, new = before.drives, state.drives
        shapes = [was.misread != now.misread for was, now in zip(old, new, strict=True)]
        shapes.append(before.sensors.misread != state.sensors.misread)
        for frame in strange:
            if not frame.can_id & (EXTENDED | REMOTE):
                continue
            plain = frame.can_id & 0x7FF
            for i, drive in enumerate(self.drives):
                shapes[i] |= frame.bus == drive.bus and plain in drive.node_ids
            shapes[-1] |= frame.bus == self.sensors.bus and plain in self.sensors.node_ids
        return tuple(shapes)

    def commanded(self, watch: WatchState, mode: Mode, command: Command) -> WatchState:
        """Remember what this tick commands, for what the next one measures."""
        acts = mode in (Mode.ACTIVE, Mode.RELAX)
        nothing = np.full(len(command.torque), np.nan)
        return watch._replace(
            asked=command.torque / self.model.space.spool if acts else nothing,
            wanted=command.tension if mode == Mode.ACTIVE else nothing,
            goal=self.model.excursion_of(command.q) if mode == Mode.ACTIVE else nothing,
        )


def make_watcher(model: HandModel, drives: tuple[Drive, ...], sensors: SensorNode) -> Watcher:
    """The watcher of a hand."""
    hand, space = model.hand, model.space
    rates = [hand.motor_of(name).velocity_range_rad_s for name in hand.tendon_names]
    arms = np.abs(hand.moment_arms)
    limits = Limits(
        tendons=hand.tendon_names,
        tension_trip=tuple(tendon.tension_trip_N for tendon in hand.tendon),
        tension_rail=sensors.tension_rail,
        tension_low=sensors.tension_low,
        drive_limit=tuple(tendon.drive_limit_N for tendon in hand.tendon),
        motors=tuple(drive.name for drive in drives),
        silent_ticks=ticks_for(SILENT_S, model.period, LEAST_SILENT),
        stalled_ticks=ticks_for(STALLED_S, model.period, LEAST_STALLED),
        noise_most=_noise_most(model),
    )
    return Watcher(
        limits=limits,
        joints=hand.joints,
        rotor=Rotor(space.motor_mass, space.motor_damping, space.coulomb, model.period),
        stiffness=space.stiffness,
        spool=space.spool,
        arms=arms.sum(axis=1),
        spool_to_joints=model.excursion_to_joints,
        step_most=np.array(
            [JUMP_MARGIN * model.period * rate for rate in (*rates, *[JOINT_RATE_RAD_S] * len(hand.joints))]
        ),
    )


def _noise_most(model: HandModel) -> float:
    """Mean squared jerk of a motor's position that only noise makes [rad^2]: the drive's torque both ways, rounding."""
    space, period = model.space, model.period
    torque = float((model.torque_limit / space.spool / space.motor_mass / space.spool).max())
    rounding = NOISE_STEPS * float((space.encoder_step / space.spool).max()) ** 2
    return NOISE_TIMES * ((0.1 * torque * period**2) ** 2 + rounding)


def _heard(state: State) -> bool:
    drives: tuple[DriveState, ...] = state.drives
    sensors: SensorState = state.sensors
    return any(drive.phase != Phase.SILENT for drive in drives) or any(group.frames for group in sensors.groups)


def _ticks_since(t_ns: int, now_ns: int, period_ns: int) -> int:
    """Whole ticks by which a reading is overdue; one that came within the last period is on time."""
    return max(0, (now_ns - t_ns) // period_ns) if t_ns >= 0 else 1_000_000
