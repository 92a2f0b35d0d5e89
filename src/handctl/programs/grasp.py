"""The program that carries out a task file: move, close until contact, hold, release."""

import math
from dataclasses import dataclass, replace

import numpy as np

from handctl.core.estimate import Estimate, Measured
from handctl.core.estimation.tip import tip_lever
from handctl.core.law.allocation import allocate
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.law.trajectory import Curve, duration_for
from handctl.core.model import HandModel
from handctl.core.types import Event, Vector
from handctl.hand.dynamics import static_torque
from handctl.programs.contact import needed
from handctl.programs.grip import Grip, GripPlan, hold
from handctl.programs.program import TIGHTEN_S, TIGHTEN_TIMEOUT_S, Progress, coordinates, loose, motion_to, tighten
from handctl.programs.task import SHORTEST_MOVE_S, Close, Follow, Hold, Move, Release, Task, for_digit

FOLLOW_START_DEG = 4.0
"""How far a digit may be from where its curve begins."""
SETTLE_AFTER_CLOSE_S = 0.3
"""A digit that found nothing may come to rest before the next phase."""
RELEASED_WITHIN_N, RELEASE_TIMEOUT_S = 2.0, 10.0
"""A digit has let go when its tensions are so near to what they shall fall to; it is waited for so long, if not."""


@dataclass(frozen=True, slots=True)
class TaskProgram:
    """Runs a task; step 0 takes up the slack, step n is the task's phase n - 1."""

    task: Task

    def begin(self, model: HandModel) -> Progress:
        """Limp until the hand is armed."""
        return Progress.begin(len(model.digits), "start")

    def advance(
        self, model: HandModel, progress: Progress, estimate: Estimate, measured: Measured, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """One tick of the task; see ``Program``."""
        if progress.finished:
            return progress, ()
        if progress.phase == "start":
            progress = replace(progress, since=t, phase="tighten", goals=tighten(model))
            return progress, (Event("info", "phase", "", "tighten: taking up slack"),)
        if progress.phase == "tighten" and progress.step == 0:
            return self._tighten(model, progress, estimate, t)
        progress, events = self._watch_contact(model, progress, estimate, t)
        progress, slipped = self._hold_on(model, progress, estimate, t)
        events += slipped
        if self._phase_over(model, progress, estimate, t):
            events += self._not_released(model, progress, estimate)
            progress, entered = self._enter(model, progress, estimate, t)
            events += entered
        return progress, events

    def _tighten(
        self, model: HandModel, progress: Progress, estimate: Estimate, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """Wait until all tendons were taut for a while; noise in which now and then one looks loose delays it."""
        slack = loose(model, estimate)
        ticks = max(0, progress.touching[0] + (-1 if slack else 1))
        progress = replace(progress, touching=(ticks, *progress.touching[1:]))
        if ticks * model.period >= TIGHTEN_S:
            return self._enter(model, replace(progress, touching=(0,) * len(model.digits)), estimate, t)
        if t - progress.since > TIGHTEN_TIMEOUT_S:
            text = f"not taut after {TIGHTEN_TIMEOUT_S:g} s: {', '.join(slack) or 'now one tendon, now another'}"
            return replace(progress, finished=True, failure=text), (Event("error", "tighten", "", text),)
        return progress, ()

    def _enter(
        self, model: HandModel, progress: Progress, estimate: Estimate, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """Begin the next phase of the task, or finish."""
        step = progress.step + 1
        if step > len(self.task.phase):
            return replace(progress, finished=True, phase="end"), (Event("info", "phase", "", "task complete"),)
        phase = self.task.phase[step - 1]
        free = isinstance(phase, Move | Follow) or (step > 1 and isinstance(self.task.phase[step - 2], Release))
        contact = (False,) * len(model.digits) if free else progress.contact
        progress = replace(progress, step=step, since=t, phase=phase.name, contact=contact)
        names = model.hand.digit_names
        if isinstance(phase, Follow) and (away := _far_from(model, phase, estimate)):
            return replace(progress, finished=True, failure=away), (Event("error", "phase", "", away),)
        goals = tuple(self._goal(model, progress, d, names[d], estimate, t) for d in range(len(names)))
        events = [Event("info", "phase", "", phase.name)]
        if isinstance(phase, Hold) and not any(contact):
            events.append(Event("warn", "phase", "", f"{phase.name}: no digit is in contact"))
        grip = Grip.of(model, goals, estimate, t) if isinstance(phase, Hold) and any(contact) else None
        untouched = (0,) * len(names)
        progress = replace(progress, goals=goals, touching=untouched, grip=grip)
        return replace(progress, closing=_closing(phase, progress)), tuple(events)

    def _goal(self, model: HandModel, progress: Progress, d: int, name: str, estimate: Estimate, t: float) -> DigitGoal:
        """Goal of one digit at the beginning of the present phase."""
        phase, old, digit = self.task.phase[progress.step - 1], progress.goals[d], model.digits[d]
        if isinstance(phase, Move):
            angle = for_digit(phase.angle_deg, name)
            return old if angle is None else motion_to(digit, estimate, np.radians(angle), phase.duration_s, t)
        if isinstance(phase, Follow):
            angles = phase.angle_deg.get(name)
            if angles is None:
                return old
            curve = Curve.through(phase.time_s, tuple(map(math.radians, angles)), digit.coupling.shape[1])
            return DigitGoal(Kind.MOTION, curve, since=t)
        if isinstance(phase, Close):
            angle = for_digit(phase.angle_deg, name)
            if angle is None or progress.contact[d]:
                return old
            way = float(np.abs(np.radians(angle) - coordinates(digit, estimate)).max())
            duration = duration_for(way, math.radians(phase.speed_deg_s), SHORTEST_MOVE_S)
            return motion_to(digit, estimate, np.radians(angle), duration, t)
        if not progress.contact[d]:
            return old
        if isinstance(phase, Release):
            target = np.full(len(digit.reduced_moment_arms), phase.tension_N)
            return DigitGoal(Kind.TENSION, tension=target, rate=phase.rate_N_per_s)
        wanted = self._hold_tension(model, phase, d, name, estimate)
        return old if wanted is None else DigitGoal(Kind.TENSION, tension=wanted, rate=phase.rate_N_per_s)

    def _hold_tension(self, model: HandModel, phase: Hold, d: int, name: str, estimate: Estimate) -> Vector | None:
        """Tension targets (n_t,) of a held digit [N], from a tension or from a tip-equivalent force."""
        digit, tendons = model.digits[d], model.digit_tendons[d]
        if phase.tension_N is not None:
            tension = for_digit(phase.tension_N, name)
            return None if tension is None else np.full(tendons.stop - tendons.start, tension)
        assert phase.tip_force_N is not None
        force = for_digit(phase.tip_force_N, name)
        if force is None:
            return None
        q = estimate.q[digit.joints]
        torque = digit.coupling.T @ np.asarray(static_torque(digit, q)) + force * tip_lever(digit, q)
        return allocate(digit.reduced_moment_arms, torque, model.floor[tendons], model.ceiling[tendons])[0]

    def _hold_on(
        self, model: HandModel, progress: Progress, estimate: Estimate, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """While holding, keep the grip and answer slip."""
        phase = self.task.phase[progress.step - 1]
        if progress.grip is None or not isinstance(phase, Hold):
            return progress, ()
        grip, goals, events = hold(model, progress.grip, _plan(model, phase), progress.goals, estimate, t)
        if grip is progress.grip and goals is progress.goals:
            return progress, events
        return replace(progress, grip=grip, goals=goals), events

    def _watch_contact(
        self, model: HandModel, progress: Progress, estimate: Estimate, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """While closing, find the digits that have met something and let them hold."""
        phase = self.task.phase[progress.step - 1]
        if not isinstance(phase, Close):
            return progress, ()
        gains = model.gains.contact
        forces = estimate.grown.tolist()
        goals, contact, touching = list(progress.goals), list(progress.contact), list(progress.touching)
        events: list[Event] = []
        for d, tendons in enumerate(model.digit_tendons):
            closing = goals[d].kind == Kind.MOTION and not contact[d]
            enough = closing and forces[d] > needed(goals[d], model.digits[d].joint_count, gains.threshold_N, t)
            touching[d] = touching[d] + 1 if enough else 0
            if touching[d] >= gains.ticks:
                contact[d] = True
                start = np.maximum(estimate.tension[tendons], phase.contact_tension_N)
                goals[d] = DigitGoal(Kind.TENSION, tension=start, rate=model.gains.tension.rate_N_per_s)
                name = model.hand.digit_names[d]
                events.append(Event("info", "contact", name, f"{name} touches, {forces[d]:.2f} N at its tip"))
        if not events and tuple(touching) == progress.touching:
            return progress, ()
        changed = replace(progress, goals=tuple(goals), contact=tuple(contact), touching=tuple(touching))
        return replace(changed, closing=_closing(phase, changed)), tuple(events)

    def _phase_over(self, model: HandModel, progress: Progress, estimate: Estimate, t: float) -> bool:
        phase, elapsed = self.task.phase[progress.step - 1], t - progress.since
        if isinstance(phase, Move | Hold):
            return elapsed >= phase.duration_s
        if isinstance(phase, Follow):
            return elapsed >= phase.time_s[-1]
        if isinstance(phase, Close):
            moving = [goal for goal in progress.goals if goal.kind == Kind.MOTION and goal.trajectory is not None]
            longest = max((goal.trajectory.duration for goal in moving if goal.trajectory), default=0.0)
            return elapsed >= min(longest + SETTLE_AFTER_CLOSE_S, phase.timeout_s) if moving else True
        late = elapsed > RELEASE_TIMEOUT_S
        return elapsed >= phase.settle_s and (late or not _pulling(model, progress, phase, estimate))

    def _not_released(self, model: HandModel, progress: Progress, estimate: Estimate) -> tuple[Event, ...]:
        """At the end of a release, which digits have not let go in their time."""
        phase = self.task.phase[progress.step - 1]
        if not isinstance(phase, Release):
            return ()
        waited = max(phase.settle_s, RELEASE_TIMEOUT_S)
        text = f"{phase.name}: above {phase.tension_N:g} N after {waited:g} s, and going on"
        return tuple([Event("warn", "phase", name, text) for name in _pulling(model, progress, phase, estimate)])


def _closing(phase: Move | Follow | Close | Hold | Release, progress: Progress) -> tuple[bool, ...]:
    """Return per digit whether it closes until it touches; empty in other phases."""
    if not isinstance(phase, Close):
        return ()
    rows = zip(progress.goals, progress.contact, strict=True)
    return tuple([goal.kind == Kind.MOTION and not known for goal, known in rows])


def _pulling(model: HandModel, progress: Progress, phase: Release, estimate: Estimate) -> list[str]:
    """Names of the digits that hold a tension, and still more of it than a release leaves them."""
    most = phase.tension_N + RELEASED_WITHIN_N
    rows = zip(model.hand.digit_names, progress.goals, model.digit_tendons, strict=True)
    return [
        name for name, goal, tendons in rows if goal.kind == Kind.TENSION and estimate.tension[tendons].max() >= most
    ]


def _plan(model: HandModel, phase: Hold) -> GripPlan:
    """What a hold says of its grip, along the tendons."""
    limit = np.full(model.tendon_count, np.nan)
    if phase.slip_limit_N is not None:
        for name, tendons in zip(model.hand.digit_names, model.digit_tendons, strict=True):
            value = for_digit(phase.slip_limit_N, name)
            limit[tendons] = math.nan if value is None else value
    return GripPlan(1e3 * phase.stiffness_N_per_mm, limit)


def _far_from(model: HandModel, phase: Follow, estimate: Estimate) -> str:
    """Which digit is not where a curve begins, in a line; empty if all are."""
    for digit, name in zip(model.digits, model.hand.digit_names, strict=True):
        if name not in phase.angle_deg:
            continue
        begin, here = phase.angle_deg[name][0], np.degrees(coordinates(digit, estimate))
        if np.abs(here - begin).max() > FOLLOW_START_DEG:
            return f"{name} is at {here.mean():.1f} deg, but the trajectory begins at {begin:g} deg: move there first"
    return ""
