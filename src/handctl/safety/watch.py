"""What safety remembers between ticks, and what it makes of one tick's raw facts before they are judged."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.choose import chosen, nothing, only, zeros
from handctl.safety.detectors import answers, correlation, counts, jumps, replays, residuals, ropes, stuck, swings
from handctl.safety.faults.node import DISOBEYED_N, SLIP_WARN_DEG
from handctl.safety.faults.tendon import DERAILED_DEG, FRICTION_WARN_N, RESIDUAL_WARN_N
from handctl.safety.signals import Limits, Named, Signals

Vector = NDArray[np.float64]

JUMP_MARGIN = 1.5
STUCK_S, STUCK_GOAL_MM, STUCK_TENSION_N = 0.1, 0.5, 8.0
"""A motor's position may stand so long while its goal moves by so much, or the tension (rope stretch is 80 um)."""
STUCK_JOINT_DEG = 10.0
CELL_TICKS, CELL_FORCE_N = 40, 5.0
"""A load cell may repeat one count so often while the motor's force moves by so much; its noise is eight counts."""
SLIP_SETTLE_S = 0.1
"""Time after a rope has become taut before joint and spool are compared with how they stood then."""
NO_SHARE = 1e-9
"""A tendon that moves a joint by a smaller share than this of the largest does not move it: rounding of the inverse."""
DERAILED_READINGS = 3
"""In so many readings in a row a rope that left its pulley shows."""
DEG = 180.0 / np.pi


@dataclass(frozen=True, slots=True)
class Watcher:
    """Constants of one hand.

    Attributes:
        limits: thresholds and names.
        joints: names, (J,).
        rotor: motors at the cable.
        stiffness: (N,) of the ropes [N/m]. spool: (N,) radius [m]. arms: (N,) sum of a tendon's moment arms [m].
        spool_to_joints: (J, N) joint angles that excursions stand for [rad/m].
        step_most: (N,) largest step of a motor's position in a period, and (J,) of a joint's [rad].
        every: (2 N + J,) how often motors, load cells and joints are read [s].
        suspicion: (8, N) see ``residuals.suspicion``.
        patience: (2 N + J,) readings of each that may be the same before anybody asks why.
        stir: (2, 2 N + J) how far its witnesses may move meanwhile; what rests is asked in vain in every tick else.
        moves: (J, N) tendons from whose excursions each joint angle follows.
        largest: (N,) force that a drive's own limit allows [N].
        start: what is remembered at first.
    """

    limits: Limits
    joints: tuple[str, ...]
    rotor: residuals.Rotor
    stiffness: Vector
    spool: Vector
    arms: Vector
    spool_to_joints: Vector
    step_most: tuple[Vector, Vector]
    every: Vector = field(init=False)
    suspicion: Vector = field(init=False)
    patience: NDArray[np.int64] = field(init=False)
    stir: Vector = field(init=False)
    moves: NDArray[np.bool_] = field(init=False)
    largest: Vector = field(init=False)
    start: "WatchState" = field(init=False)

    def __post_init__(self) -> None:
        n, j, never, noise = len(self.spool), len(self.joints), np.inf, self.limits.noise_most
        fine = (RESIDUAL_WARN_N, never, DISOBEYED_N, never, never, SLIP_WARN_DEG, noise, FRICTION_WARN_N)
        every = np.concatenate((self.rotor.motor_period, np.full(n, self.period), np.full(j, self.rotor.joint_period)))
        patience = (STUCK_S / every).astype(np.int64)
        patience[n : 2 * n] = np.minimum(patience[n : 2 * n], CELL_TICKS)
        object.__setattr__(self, "every", every)
        object.__setattr__(self, "largest", np.array(self.limits.drive_limit or (never,) * n))
        object.__setattr__(self, "suspicion", residuals.suspicion(self.rotor, np.array(fine)))
        object.__setattr__(self, "patience", patience)
        first = np.repeat([STUCK_GOAL_MM * 1e-3, CELL_FORCE_N, STUCK_JOINT_DEG / DEG], [n, n, j])
        object.__setattr__(self, "stir", np.array([first, np.repeat([STUCK_TENSION_N, never, never], [n, n, j])]))
        size = np.abs(self.spool_to_joints)
        object.__setattr__(self, "moves", size > NO_SHARE * size.max(initial=0.0))
        object.__setattr__(self, "start", WatchState.initial(n, j))

    @property
    def period(self) -> float:
        """Control period [s]."""
        return self.rotor.period

    def initial(self) -> "WatchState":
        """Nothing known."""
        return self.start


class WatchState(NamedTuple):
    """What is remembered; all but the counts begins anew whenever the hand is armed.

    Attributes:
        motors, joints: last accepted positions, (N,) and (J,).
        filtered: residuals.
        stuck: readings that stand, of motors, load cells and joints, (2 N + J,).
        taut: (N,) time for which the rope has been taut [s].
        bears: (N,) tendons that are taut by their filtered tension, so that spool and joints move together.
        slip_from: (N,) joint against spool when it became so [m].
        derailed: (N,) readings in a row in which the two are further apart than any stretch.
        asked, wanted, goal: (N,) motor force [N], tension [N] and excursion [m] that the last tick commanded.
        ropes: taut, slack and cut.
        counts: losses and the like.
        owed: per motor, questions that it has not answered; see ``answers``.
        replays: load-cell readings, and whether they were there before.
        swings: (3, N) see ``swings``.
        followed: commanded against reported force.
    """

    motors: jumps.Accepted
    joints: jumps.Accepted
    filtered: residuals.Filtered
    stuck: stuck.Stuck
    taut: tuple[float, ...]
    bears: NDArray[np.bool_]
    slip_from: Vector
    derailed: Vector
    asked: Vector
    wanted: Vector
    goal: Vector
    ropes: ropes.Ropes
    counts: counts.Counts
    owed: answers.Owed
    replays: replays.Replays
    swings: Vector
    followed: correlation.Correlation

    @staticmethod
    def initial(n: int, j: int) -> "WatchState":
        """Nothing known of n tendons and j joints."""
        return WatchState(
            motors=jumps.Accepted.initial(n),
            joints=jumps.Accepted.initial(j),
            filtered=residuals.Filtered.initial(n),
            stuck=stuck.Stuck.initial(2 * n + j, 2),
            taut=(0.0,) * n,
            bears=np.zeros(n, dtype=np.bool_),
            slip_from=nothing(n),
            derailed=zeros(n),
            asked=nothing(n),
            wanted=nothing(n),
            goal=nothing(n),
            ropes=ropes.Ropes(),
            counts=counts.Counts(),
            owed=((),) * n,
            replays=replays.Replays.initial(n),
            swings=swings.initial(n),
            followed=correlation.Correlation.initial(n),
        )


class Seen(NamedTuple):
    """One tick's raw facts, (N,) each unless said otherwise, NaN where nothing came.

    Attributes:
        tension: load cells [N]. travel: cable at the spool [m]. position: of the motors [rad].
        speed: of the cable, estimated [m/s].
        force: that the motors made, at the cable [N].
        excursion: by joint encoders [m]. joints: (J,) [rad]. read: whether any joint encoder was read.
        cut: whether the torque has been taken away.
    """

    tension: Vector
    travel: Vector
    position: Vector
    speed: Vector
    force: Vector
    excursion: Vector
    joints: Vector
    read: bool
    cut: bool


def screen(
    watcher: Watcher, state: WatchState, position: Vector, joints: Vector | None, missed: int = 0
) -> tuple[WatchState, Vector | None, Vector | None]:
    """Look at positions before anything else does.

    Args:
        watcher: of the hand. state: what is remembered.
        position: (N,) of the motors [rad]. joints: (J,) [rad]; None if none was read.
        missed: ticks that were skipped before this one.

    Returns:
        state, and how far each jumped, (N,) and (J,), 0 where it did not; None where none did.
    """
    most_motor, most_joint = watcher.step_most
    motors, jumped = jumps.screen(state.motors, position, most_motor, missed)
    if joints is None:
        return state._replace(motors=motors, joints=jumps.unread(state.joints, missed)), jumped, None
    accepted, twisted = jumps.screen(state.joints, joints, most_joint, missed)
    return state._replace(motors=motors, joints=accepted), jumped, twisted


def counted(
    watcher: Watcher, state: WatchState, raw: Signals, misshapen: tuple[bool, ...], strange: tuple[int, int], k: int
) -> tuple[WatchState, Signals]:
    """Count what came and did not come; ``strange``: frames of nobody's, and refused goals."""
    late = (*[age > 0 for age in raw.motor_age], max(raw.sensor_age, default=0) > 0)
    lost = late if raw.armed and not raw.missed else (False,) * len(late)
    if state.counts == NONE and strange == (0, 0) and True not in lost and True not in misshapen:
        return state, raw
    new = counts.step(state.counts, lost, misshapen, *strange, k, 1.0 / watcher.period)
    nodes = watcher.limits.nodes
    shapes = tuple([(nodes[i], float(counts.lately(bits))) for i, bits in enumerate(new.misshapen) if bits & 1])
    return state._replace(counts=new), raw._replace(
        lost=counts.number(new.lost),
        halved=tuple([nodes[i] for i, bits in enumerate(new.lost) if counts.halved(bits)]),
        misshapen=shapes,
        unknown=new.unknown,
        refused=len(new.refused) if strange[1] else 0,
    )


NONE = counts.Counts()
"""Nothing was counted."""


def watched(watcher: Watcher, state: WatchState, raw: Signals, seen: Seen) -> tuple[WatchState, Signals]:
    """Filter and remember; only under torque, or just after it."""
    cell = seen.tension.tolist()
    if seen.cut:
        last = state.stuck.value[len(cell) : 2 * len(cell)].tolist()
        state = state._replace(ropes=ropes.cut(state.ropes, cell, last, watcher.period))
        return state, raw._replace(limp=ropes.limp(state.ropes, watcher.limits.tendons, watcher.period))
    if not raw.armed:
        return watcher.start._replace(counts=state.counts, owed=state.owed), raw
    taut, begin, slip = _slip(watcher, state, seen, cell)
    went = (seen.position, seen.speed) if not raw.missed else (nothing(len(cell)),) * 2  # over how long, nobody knows
    rope = residuals.Rope(*went, seen.tension, seen.force, state.asked, slip)
    first = state.filtered is watcher.start.filtered
    filtered = residuals.step(watcher.rotor, residuals.begun(state.filtered, rope) if first else state.filtered, rope)
    tense = ropes.step(state.ropes, filtered.low[residuals.TENSION].tolist(), state.wanted.tolist())
    bears, idle = _bearing(watcher, state, filtered)
    witnesses = _witnesses(watcher, state, filtered, seen)
    value = np.concatenate((seen.travel, seen.tension, seen.joints))
    before = state.stuck
    if idle is not None:
        np.putmask(witnesses[0], idle, np.nan)
        before = stuck.unwitnessed(before, idle)
    stands = stuck.step(before, value, witnesses)
    derailed = (state.derailed + 1.0) * (np.abs(slip) > DERAILED_DEG) if seen.read else state.derailed
    followed = correlation.step(state.followed, state.asked, seen.force, watcher.period, raw.missed)
    state = state._replace(followed=followed, filtered=filtered, stuck=stands, taut=taut, bears=bears)
    state = state._replace(slip_from=begin, derailed=derailed, ropes=tense)
    state = state._replace(
        replays=replays.step(state.replays, seen.tension),
        swings=swings.step(state.swings, seen.tension - state.wanted, watcher.period),
    )
    told = _rope_signals(watcher, state, cell, seen) | _cell_signals(watcher, state) | _drive_signals(watcher, followed)
    if np.count_nonzero(np.abs(filtered.low) > watcher.suspicion):
        told |= _residual_signals(watcher, filtered)
    if seen.read and np.count_nonzero(derailed >= DERAILED_READINGS):
        told["derailed"] = tuple(only(derailed >= DERAILED_READINGS, np.abs(slip)).tolist())
    if np.count_nonzero(stands.ticks >= watcher.patience):
        away = stuck.away(stands, witnesses)
        if np.count_nonzero(away >= watcher.stir):
            told |= _stuck_signals(watcher, stands, away)
    return state, raw._replace(**told) if told else raw


def _drive_signals(watcher: Watcher, followed: correlation.Correlation) -> dict[str, Any]:
    """Return the motors whose torque reports do not follow their commands, if there are any."""
    unfollowed = correlation.unfollowed(followed, watcher.largest, watcher.period)
    if not np.count_nonzero(unfollowed):
        return {}
    return {"unfollowed": _named(watcher.limits.motors, unfollowed, correlation.part(followed))}


def _rope_signals(watcher: Watcher, state: WatchState, cell: list[float], seen: Seen) -> dict[str, Any]:
    """Slack and snapped ropes, if there are any."""
    names, period, speed = watcher.limits.tendons, watcher.period, seen.speed.tolist()
    slack = ropes.slack(state.ropes, names, period)
    snapped = ropes.snapped(state.ropes, names, cell, state.wanted.tolist(), speed, period)
    return {"slack": slack, "snapped": snapped} if slack or snapped else {}


def _cell_signals(watcher: Watcher, state: WatchState) -> dict[str, Any]:
    """Return load cells that repeat what they told before, and tensions that swing, if there are any."""
    names, told = watcher.limits.tendons, dict[str, Any]()
    if old := replays.replayed(state.replays):
        told["replayed"] = tuple([(names[i], float(age)) for i, age in old])
    if quick := swings.swinging(state.swings):
        told["swinging"] = tuple([(names[i], size) for i, size in quick])
    return told


def _residual_signals(watcher: Watcher, filtered: residuals.Filtered) -> dict[str, Any]:
    """What the residuals say."""
    size = np.abs(filtered.low).tolist()
    return {
        "residual": tuple(residuals.unexplained(watcher.rotor, filtered).tolist()),
        "disobeyed": tuple(size[residuals.ASKED]),
        "friction": tuple(residuals.friction(filtered).tolist()),
        "slip": tuple(size[residuals.SLIP]),
        "noise": tuple(size[residuals.JERK]),
    }


def _slip(
    watcher: Watcher, state: WatchState, seen: Seen, cell: list[float]
) -> tuple[tuple[float, ...], Vector, Vector]:
    """How long each rope has been taut [s], joint against spool when it became so [m], and (N,) since [deg]."""
    period, begin, slip = watcher.period, state.slip_from, nothing(len(cell))
    taut = tuple(
        [
            0.0 if force < ropes.SLACK_N else since + period if force > ropes.TAUT_N else since
            for force, since in zip(cell, state.taut, strict=True)
        ]
    )
    if seen.read:
        apart = seen.travel - seen.tension / watcher.stiffness - seen.excursion
        begin = chosen(begin != begin, apart, begin)
    if min(taut) <= SLIP_SETTLE_S:
        begin = chosen(np.array(taut) <= SLIP_SETTLE_S, slip, begin)
    return taut, begin, (apart - begin) / watcher.arms * DEG if seen.read else slip


def _bearing(
    watcher: Watcher, state: WatchState, filtered: residuals.Filtered
) -> tuple[NDArray[np.bool_], NDArray[np.bool_] | None]:
    """Find tendons that bear, and readings for which the spools are no witness.

    While a tendon is slack its spool turns without the joints. A joint encoder at rest is then healthy.

    Returns:
        (N,) tendons that bear tension, with hysteresis; (2 N + J,) joints of a slack tendon, None where none is slack.
    """
    quick = filtered.low[residuals.TENSION]
    bears = (quick > ropes.TAUT_N) | (state.bears & (quick > ropes.SLACK_N))
    if np.count_nonzero(bears) == len(bears):
        return bears, None
    idle = np.zeros(2 * len(bears) + len(watcher.joints), dtype=np.bool_)
    idle[2 * len(bears) :] = np.asarray(watcher.moves[:, ~bears]).any(axis=1)
    return bears, idle


def _witnesses(watcher: Watcher, state: WatchState, filtered: residuals.Filtered, seen: Seen) -> Vector:
    """(2, 2 N + J) what moves if a reading must: of motors goal [m] and tension [N], of load cells the motor's force.

    The second witness of load cells and joints says nothing; that of a joint is what the spool makes of it [rad].
    """
    quick, force = filtered.low[residuals.TENSION], filtered.low[residuals.QUICK_FORCE]
    turned = watcher.spool_to_joints.dot(seen.travel - quick / watcher.stiffness)
    silent = nothing(len(quick) + len(turned))
    return np.concatenate((state.goal, force, turned, quick, silent)).reshape(2, -1)


def _stuck_signals(watcher: Watcher, stands: stuck.Stuck, away: Vector) -> dict[str, Any]:
    """Readings that stand although they must move: motors, joints, load cells."""
    limits, n, ticks = watcher.limits, len(watcher.spool), stands.ticks
    motor, cell, joint = slice(n), slice(n, 2 * n), slice(2 * n, None)
    long = ticks * watcher.every > STUCK_S
    goal, tension, pushed, turned = away[0, motor] * 1e3, away[1, motor], away[0, cell], away[0, joint] * DEG
    still = long[motor] & ((goal > STUCK_GOAL_MM) | (tension > STUCK_TENSION_N))
    same = (ticks[cell] >= CELL_TICKS) & (pushed > CELL_FORCE_N) & (stands.value[cell] > ropes.TAUT_N)
    return {
        "stuck_motor": _named(limits.motors, still, np.maximum(goal, tension)),
        "stuck_joint": _named(watcher.joints, long[joint] & (turned > STUCK_JOINT_DEG), turned),
        "stuck_cell": _named(limits.tendons, same, pushed),
    }


def _named(names: tuple[str, ...], which: NDArray[np.bool_], value: Vector) -> Named:
    return tuple([(name, float(v)) for name, w, v in zip(names, which, value, strict=True) if w])
