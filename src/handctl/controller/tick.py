"""One tick: frames in, frames out, and nothing else. Every fact that can change a decision enters by ``TickIn``.

receive   frames -> drive and sensor states
measure   what is new in this tick
estimate  measurements -> tension, excursion, contact
decide    requests, safety, mode, program -> goals
command   goals -> tension -> motor torque
encode    what each drive shall do -> frames
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from handctl.choose import nothing
from handctl.compiled import prepare
from handctl.controller import retune
from handctl.controller.answers import answer
from handctl.controller.modes import farewell, next_mode, wanted_of_drives
from handctl.controller.monitor.derating import restraints
from handctl.controller.monitor.guard import Guard
from handctl.controller.monitor.motors import Motors
from handctl.controller.monitor.received import Received
from handctl.controller.relaxing import envelope
from handctl.controller.state import State
from handctl.controller.telemetry import telemetry
from handctl.core.estimation import estimator, posture, touch
from handctl.core.estimation.estimator import Estimate, Measured
from handctl.core.estimation.filter_state import FilterState
from handctl.core.estimation.innovation import doubts
from handctl.core.estimation.posture import Posture, Readings
from handctl.core.estimation.touch import Touch
from handctl.core.law import computed_torque
from handctl.core.law.computed_torque import Command, Envelope, LawState
from handctl.core.law.goal import DigitGoal
from handctl.core.model import HandModel
from handctl.core.types import ACTING, Event, Mode, TickIn, TickOut, Vector
from handctl.drives.contract import Drive, DriveState, Phase
from handctl.drives.frame import ERROR, Frame
from handctl.drives.sensors.node import SensorNode, SensorState, saturated
from handctl.programs.program import Program, Progress
from handctl.safety import judge as safety
from handctl.safety.action import Action
from handctl.safety.signals import Limits, Signals

ACTIVE, CUT, DONE, RELAX, SILENT = Mode.ACTIVE, Mode.CUT, Mode.DONE, Mode.RELAX, Mode.SILENT
FAULT, HOLD = Phase.FAULT, Action.HOLD
"""As names of this module: looking a member up in its enumeration costs more than comparing it."""
SENSORS = -1
"""Owner of the sensor node's frames, where drives are owners by index."""


@dataclass(frozen=True, slots=True)
class Controller:
    """All that is constant in a run; ``tick`` is a pure function of it, a state and a ``TickIn``.

    Attributes:
        model: the hand, its gains and designs.
        drives: the motor of each tendon, in the order of the tendons.
        sensors: the sensor node.
        program: what decides the goals.
        guard: what shows each tick to safety.
        tare: (N,) load-cell tare [N].
        zero: (N,) motor zero [rad].
        owners: (bus, identifier) to the index of the drive that sends it, or SENSORS.
        ours: (bus, identifier) of frames that only this host may send.
        arm_at_once: arm as soon as everything has answered, without a request.
        identities: of the drives that tare and zero were found with; empty if unknown.
        designs: of gains that were set in a run.
    """

    model: HandModel
    drives: tuple[Drive, ...]
    sensors: SensorNode
    program: Program
    guard: Guard
    tare: Vector
    zero: Vector
    owners: dict[tuple[int, int], int]
    ours: frozenset[tuple[int, int]]
    arm_at_once: bool = True
    identities: tuple[str, ...] = ()
    designs: retune.Designs = field(default_factory=retune.Designs, compare=False, repr=False)

    @staticmethod
    def of(
        model: HandModel,
        drives: tuple[Drive, ...],
        sensors: SensorNode,
        program: Program,
        tare: Vector,
        zero: Vector,
        arm_at_once: bool = True,
    ) -> "Controller":
        """Put a controller together, with its kernels compiled; see the attributes."""
        prepare()
        owners = {(drive.bus, can_id): i for i, drive in enumerate(drives) for can_id in drive.node_ids}
        owners |= {(sensors.bus, can_id): SENSORS for can_id in sensors.node_ids}
        ours = {(drive.bus, can_id) for drive in drives for can_id in drive.host_ids}
        ours |= {(sensors.bus, can_id) for can_id in sensors.host_ids}
        guard = Guard.of(model, drives, sensors)
        return Controller(model, drives, sensors, program, guard, tare, zero, owners, frozenset(ours), arm_at_once)

    @property
    def limits(self) -> Limits:
        """Thresholds of safety."""
        return self.guard.watcher.limits

    def initial(self) -> State:
        """State before the first tick; the same for the same configuration, so that a log can be executed again."""
        n = self.model.tendon_count
        return State(
            k=-1,
            mode=Mode.SILENT,
            mode_since=0.0,
            goal_time=0.0,
            armed=self.arm_at_once,
            drives=tuple(drive.initial() for drive in self.drives),
            sensors=self.sensors.initial(),
            filter=FilterState.initial(n),
            law=LawState.initial(n),
            progress=self.program.begin(self.model),
            safety=safety.SafetyState(),
            watch=self.guard.watcher.initial(),
            touch=Touch.none(len(self.model.digits)),
            posture=Posture.initial(self.model),
        )

    def cut_frames(self) -> tuple[Frame, ...]:
        """Frames that take the torque of every motor away."""
        return tuple(frame for drive in self.drives for frame in drive.cut())

    def tick(self, state: State, entry: TickIn) -> tuple[State, TickOut]:
        """One tick.

        Args:
            state: from the tick before.
            entry: everything that is new.

        Raises:
            ValueError: a command that cannot be encoded; it never reaches a wire.
        """
        if state.gains is None or state.gains is self.model.gains:
            return self._tick(state, entry)
        return replace(self, model=self.designs.model(self.model, state.gains))._tick(state, entry)

    def _tick(self, state: State, entry: TickIn) -> tuple[State, TickOut]:
        """One tick with the gains that are this controller's."""
        before = state
        state, received = self._take_in(state, entry)
        state, wishes, asked = answer(self.model, self.program, state, received.estimate, entry.requests)
        told = doubts(self.model.hand.tendon_names, before.filter, state.filter)
        told += touch.told(self.model.hand.digit_names, before.touch, state.touch, state.progress.contact)
        watch, signals = self.guard.look(before, state, entry, received, asked)
        measured, estimate = received.measured, received.estimate
        judged, verdict = safety.judge(state.safety, self.limits, signals)
        state = state if judged is state.safety else state._replace(safety=judged)
        t, foreign = entry.t_ns / 1e9, signals.foreign
        state, moved = next_mode(self.model, self.drives, state, verdict.action, wishes, foreign, t, self.identities)
        progress, goal_time, stepped = self._program(state, verdict.action, estimate, measured)
        bounds = envelope(self.model, state, entry.k - before.k)
        law, command = self._command(state, verdict.action, estimate, progress.goals, goal_time, bounds)
        drives, sensors, frames = self._encode(state, entry, command)
        old_law = state.law
        watch = self.guard.commanded(watch, state.mode, command, before.drives, entry.k, estimate.excursion)
        state = state._replace(
            progress=progress, goal_time=goal_time, law=law, drives=drives, sensors=sensors, watch=watch
        )
        state, retuned = self._retune(state, old_law, verdict.action, estimate, command, bounds)
        events = told + asked + tuple(_told(finding) for finding in verdict.findings) + moved + stepped + retuned
        motors = Motors.of(state.drives)
        contact = tuple(map(max, state.progress.contact, state.touch.blocked))
        numbers = telemetry(self.model, motors, contact, measured, estimate, command, entry.t_ns)
        phase = state.progress.phase if state.mode == Mode.ACTIVE else state.mode.name.lower()
        return state, TickOut(frames, state.mode, phase, verdict.action, numbers, events, state.digest(motors))

    def signals(self, state: State, entry: TickIn) -> Signals:
        """What safety judges in a tick, from the state before it; for judging a recorded run by other limits."""
        after, received = self._take_in(state, entry)
        after, _, asked = answer(self.model, self.program, after, received.estimate, entry.requests)
        return self.guard.look(state, after, entry, received, asked)[1]

    def _take_in(self, state: State, entry: TickIn) -> tuple[State, Received]:
        """Frames to drive states, measurements and the estimate."""
        drives, sensors, foreign, strange = self._receive(state, entry)
        motors, counts_before = Motors.of(drives), tuple([drive.feedback_count for drive in state.drives])
        measured, missed = self._measured(state, motors, counts_before, sensors), entry.k - state.k - 1
        watch, measured, jumped = self.guard.screen(state, measured, missed)
        if not state.filter.started and self.sensors.all_read(sensors):  # though perhaps in different ticks
            travel = (np.array(motors.position) - self.zero) * self.model.space.spool
            state = state._replace(filter=estimator.start(self.model, state.filter, travel))
        filters, estimate = self._estimate(state, measured, missed)
        commanded = state.mode in (ACTIVE, RELAX)
        felt = touch.feel(self.model, state.touch, estimate) if commanded else Touch.none(len(self.model.digits))
        state = state._replace(k=entry.k, drives=drives, sensors=sensors, filter=filters, watch=watch, touch=felt)
        if filters.started:
            state, estimate = self._angles(state, estimate, entry)
        return state, Received(motors, counts_before, measured, estimate, foreign, strange, jumped)

    def _receive(
        self, state: State, entry: TickIn
    ) -> tuple[tuple[DriveState, ...], SensorState, tuple[str, ...], tuple[Frame, ...]]:
        """Give each frame to its drive or sensor; identifiers that only we may send are foreign, others strange."""
        drives, sensors, foreign, strange = list(state.drives), state.sensors, list[str](), list[Frame]()
        owner_of = self.owners.get
        for frame in entry.frames:
            can_id, _, _, bus, _ = frame
            owner = owner_of((bus, can_id & ~ERROR))
            if owner is None:
                if (bus, can_id) in self.ours:
                    foreign.append(f"{can_id:#05x}")
                else:
                    strange.append(frame)
            elif owner == SENSORS:
                sensors = self.sensors.receive(sensors, frame)
            else:
                drives[owner] = self.drives[owner].receive(drives[owner], frame)
        return tuple(drives), sensors, tuple(dict.fromkeys(foreign)), tuple(strange)

    def _measured(self, state: State, motors: Motors, counts: tuple[int, ...], sensors: SensorState) -> Measured:
        """Measurements that are new in this tick; NaN for the rest."""
        position = np.array(motors.position)
        if True in [now == was for now, was in zip(motors.feedback_count, counts, strict=True)]:
            np.putmask(position, np.array(motors.feedback_count) == counts, math.nan)
        angle = position - self.zero
        tension, cells = [math.nan] * self.model.tendon_count, self.sensors.new_tensions(state.sensors, sensors)
        for index, value in cells:
            tension[index] = value
        taken_off = self.tare + state.progress.tare if state.progress.tare else self.tare
        read = self.sensors.new_joints(state.sensors, sensors)
        joints, excursion = self._joints(read)
        travel, railed = angle * self.model.space.spool, saturated(cells)
        return Measured(travel, np.array(tension) - taken_off, excursion, joints, railed, bool(read), angle)

    def _joints(self, read: list[tuple[int, float]]) -> tuple[Vector, Vector]:
        """Joint encoders that are new [rad], and the excursions that follow from them [m]; NaN for the rest."""
        count = len(self.guard.watcher.joints)
        if not read:
            return nothing(count), nothing(self.model.tendon_count)
        joints = nothing(count).copy()
        for index, value in read:
            joints[index] = value
        return joints, self.model.excursion_of(joints)

    def _estimate(self, state: State, measured: Measured, missed: int) -> tuple[FilterState, Estimate]:
        law, felt = state.law, zip(state.progress.contact, state.touch.blocked, strict=True)
        held = tuple([(touches and state.mode in ACTING) or blocked for touches, blocked in felt])
        return estimator.step(self.model, state.filter, measured, law.force, law.rate, held, law.friction_state, missed)

    def _angles(self, state: State, estimate: Estimate, entry: TickIn) -> tuple[State, Estimate]:
        """Estimate joint angles from the excursions, from contact and from joint encoders."""
        readings = None
        if posture.places(self.model).reads:
            readings = Readings.of(len(estimate.q), self.sensors.latest_joints(state.sensors), entry.t_ns)
        after, angles = posture.step(self.model, state.posture, estimate, state.touch.tension, entry.k, readings)
        if after is not state.posture:
            state = state._replace(posture=after)
        return state, estimate._replace(q=angles.q, q_sigma=angles.sigma)

    def _program(
        self, state: State, action: Action, estimate: Estimate, measured: Measured
    ) -> tuple[Progress, float, tuple[Event, ...]]:
        """Let the program go on while the hand is active; when safety holds, its time stands still."""
        if state.mode != ACTIVE or action >= HOLD:
            return state.progress, state.goal_time, ()
        t = state.goal_time + self.model.period
        progress, events = self.program.advance(self.model, state.progress, estimate, measured, t)
        return progress, t, events

    def _command(
        self,
        state: State,
        action: Action,
        estimate: Estimate,
        goals: tuple[DigitGoal, ...],
        t: float,
        bounds: Envelope | None,
    ) -> tuple[LawState, Command]:
        """Motor torques of this tick; none unless active or relaxing, and then from the tension that is there."""
        if state.mode not in (ACTIVE, RELAX):
            return LawState.idle(estimate.tension), Command.idle(self.model)
        most, kept = restraints(self.model, self.limits, state, action, estimate.tension)
        return computed_torque.step(self.model, state.law, estimate, goals, t, most, kept, bounds)

    def _retune(
        self,
        state: State,
        before: LawState,
        action: Action,
        estimate: Estimate,
        command: Command,
        bounds: Envelope | None,
    ) -> tuple[State, tuple[Event, ...]]:
        """Design a piece of the gains that are coming; take them over from the next tick on when all is designed."""
        if state.coming is None:
            return state, ()
        if (unfinished := self.designs.advance(self.model, state.coming)) is not None:
            return state._replace(coming=unfinished.coming), unfinished.told
        gains, law = state.coming.gains, state.law
        if state.mode in (Mode.ACTIVE, Mode.RELAX):
            other = self.designs.model(self.model, gains)
            limited = restraints(self.model, self.limits, state._replace(law=before), action, estimate.tension)
            _, changed = computed_torque.step(
                other, before, estimate, state.progress.goals, state.goal_time, *limited, bounds
            )
            law = retune.trimmed(law, (command.torque - changed.torque) / self.model.space.spool)
        return state._replace(gains=gains, coming=None, law=law), retune.changes(self.model.gains, gains)

    def _encode(
        self, state: State, entry: TickIn, command: Command
    ) -> tuple[tuple[DriveState, ...], SensorState, tuple[Frame, ...]]:
        """SYNC for the sensors, then what each drive shall do; a cut goes before everything else, every tick anew."""
        if state.mode in (SILENT, DONE):
            return state.drives, state.sensors, farewell(self.drives, state)
        sensors, sync = self.sensors.sync(state.sensors, entry.k)
        frames = [sync]
        want, drives, t_ns = wanted_of_drives(state.mode), [], entry.t_ns
        clearing = state.clearing and state.mode == Mode.INVENTORY
        told = self.model.told(command.torque)
        for drive, known, torque in zip(self.drives, state.drives, told.tolist(), strict=True):
            if clearing and known.phase == FAULT:
                known, sent = drive.clear(known)
            else:
                known, sent = drive.advance(known, t_ns, want, torque)
            drives.append(known)
            frames += sent
        sent_now = (*self.cut_frames(), sync) if state.mode == CUT else tuple(frames)
        return tuple(drives), sensors, sent_now


def _told(finding: safety.Finding) -> Event:
    fault = finding.fault
    level = "error" if fault.action >= Action.RELAX else "warn"
    text = f"{fault.id} {fault.title}: {finding.instance} ({finding.value:g}): {fault.action.name}"
    return Event(level if fault.action > Action.PASS else "info", "fault", finding.instance, text)
