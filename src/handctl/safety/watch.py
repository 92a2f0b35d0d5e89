"""What safety remembers between ticks, and what it makes of one tick's raw facts before they are judged."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.choose import chosen
from handctl.safety import counts, jumps, residuals, ropes, stuck
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
        step_most: (N + J,) largest step of a motor's and a joint's position in a tick [rad].
    """

    limits: Limits
    joints: tuple[str, ...]
    rotor: residuals.Rotor
    stiffness: Vector
    spool: Vector
    arms: Vector
    spool_to_joints: Vector
    step_most: Vector

    @property
    def period(self) -> float:
        """Control period [s]."""
        return self.rotor.period

    def initial(self) -> "WatchState":
        """Nothing known."""
        n, j = len(self.spool), len(self.joints)
        return WatchState(
            position=jumps.Accepted.initial(n + j),
            filtered=residuals.Filtered.initial(n),
            stuck=stuck.Stuck.initial(2 * n + j, 2),
            taut=np.zeros(n),
            slip_from=np.full(n, np.nan),
            asked=np.full(n, np.nan),
            wanted=np.full(n, np.nan),
            goal=np.full(n, np.nan),
            ropes=ropes.Ropes(),
            counts=counts.Counts(),
        )


class WatchState(NamedTuple):
    """What is remembered; all but the counts begins anew whenever the hand is armed.

    Attributes:
        position: last accepted positions of motors and joints, (N + J,).
        filtered: residuals.
        stuck: readings that stand, of motors, load cells and joints, (2 N + J,).
        taut: (N,) time for which the rope has been taut [s].
        slip_from: (N,) joint against spool when it became so [m].
        asked, wanted, goal: (N,) motor force [N], tension [N] and excursion [m] that the last tick commanded.
        ropes: taut, slack and cut.
        counts: losses and the like.
    """

    position: jumps.Accepted
    filtered: residuals.Filtered
    stuck: stuck.Stuck
    taut: Vector
    slip_from: Vector
    asked: Vector
    wanted: Vector
    goal: Vector
    ropes: ropes.Ropes
    counts: counts.Counts

    def key(self) -> bytes:
        """Bytes that change with the state."""
        own = (self.taut, self.slip_from, self.asked, self.wanted, self.goal)
        arrays = [array.tobytes() for array in (*self.position, *self.filtered, *self.stuck, *own)]
        return b"".join(arrays) + repr((*self.ropes, *self.counts)).encode()


class Seen(NamedTuple):
    """One tick's raw facts, (N,) each unless said otherwise, NaN where nothing came.

    Attributes:
        tension: load cells [N]. travel: cable at the spool [m]. speed: estimated [m/s].
        force: that the motors made, at the cable [N].
        excursion: by joint encoders [m]. joints: (J,) [rad].
        cut: whether the torque has been taken away.
    """

    tension: Vector
    travel: Vector
    speed: Vector
    force: Vector
    excursion: Vector
    joints: Vector
    cut: bool


def screen(watcher: Watcher, state: WatchState, motors: Vector, joints: Vector) -> tuple[WatchState, Vector, Vector]:
    """Look at positions before anything else does; how far each jumped, (N,) and (J,), 0 where it did not."""
    position, jump = jumps.screen(state.position, np.concatenate((motors, joints)), watcher.step_most)
    return state._replace(position=position), jump[: len(motors)], jump[len(motors) :]


def counted(
    watcher: Watcher, state: WatchState, raw: Signals, misshapen: tuple[bool, ...], strange: tuple[int, int], k: int
) -> tuple[WatchState, Signals]:
    """Count what came and did not come; ``strange``: frames of nobody's, and refused goals."""
    late = (*[age > 0 for age in raw.motor_age], max(raw.sensor_age, default=0) > 0)
    lost = late if raw.armed and not raw.missed else (False,) * len(late)
    new = counts.step(state.counts, lost, misshapen, *strange, k, 1.0 / watcher.period)
    if new == state.counts == counts.Counts():
        return state, raw
    nodes = watcher.limits.nodes
    shapes = tuple([(nodes[i], float(counts.lately(bits))) for i, bits in enumerate(new.misshapen) if bits & 1])
    return state._replace(counts=new), raw._replace(
        lost=counts.number(new.lost),
        halved=tuple([nodes[i] for i, bits in enumerate(new.lost) if counts.halved(bits)]),
        misshapen=shapes,
        unknown=new.unknown,
        refused=len(new.refused) if strange[1] else 0,
    )


def watched(watcher: Watcher, state: WatchState, raw: Signals, seen: Seen) -> tuple[WatchState, Signals]:
    """Filter and remember; only under torque, or just after it."""
    names = watcher.limits.tendons
    if seen.cut:
        cell = seen.tension.tolist()
        state = state._replace(ropes=ropes.cut(state.ropes, cell))
        return state, raw._replace(limp=ropes.limp(state.ropes, names, cell, watcher.period))
    if not raw.armed:
        return watcher.initial()._replace(counts=state.counts), raw
    cell, wanted = seen.tension.tolist(), state.wanted.tolist()
    state, slip = _slip(watcher, state, seen)
    rope = residuals.Rope(seen.travel / watcher.spool, seen.speed, seen.tension, seen.force, state.asked, slip)
    filtered = residuals.step(watcher.rotor, state.filtered, rope)
    tense = ropes.step(state.ropes, filtered.low[residuals.TENSION].tolist(), wanted)
    state = state._replace(filtered=filtered, ropes=tense)
    state, stands = _stands(watcher, state, seen)
    size = np.abs(filtered.low).tolist()
    return state, raw._replace(
        slack=ropes.slack(tense, names, watcher.period),
        snapped=ropes.snapped(tense, names, cell, wanted, seen.speed.tolist(), watcher.period),
        residual=tuple(residuals.unexplained(watcher.rotor, filtered).tolist()),
        disobeyed=tuple(size[residuals.ASKED]),
        friction=tuple(residuals.friction(filtered).tolist()),
        slip=tuple(size[residuals.SLIP]),
        derailed=tuple(np.abs(slip).tolist()),
        noise=tuple(size[residuals.JERK]),
        stuck_motor=stands[0],
        stuck_joint=stands[1],
        stuck_cell=stands[2],
    )


def _slip(watcher: Watcher, state: WatchState, seen: Seen) -> tuple[WatchState, Vector]:
    """(N,) joint encoders against the spool since the rope became taut, as a mean joint angle [deg]."""
    taut = state.taut + watcher.period * (seen.tension > ropes.TAUT_N)
    taut[seen.tension < ropes.SLACK_N] = 0.0
    apart = seen.travel - seen.tension / watcher.stiffness - seen.excursion
    begin = chosen(np.isnan(state.slip_from), apart, state.slip_from)
    begin[taut <= SLIP_SETTLE_S] = np.nan
    return state._replace(taut=taut, slip_from=begin), (apart - begin) / watcher.arms * DEG


def _stands(watcher: Watcher, state: WatchState, seen: Seen) -> tuple[WatchState, tuple[Named, Named, Named]]:
    """Readings that stand although they must move: motors, joints, load cells."""
    low, period, limits, n = state.filtered.low, watcher.period, watcher.limits, len(seen.travel)
    quick = low[residuals.TENSION]
    witnesses = np.full((2, 2 * n + len(seen.joints)), np.nan)
    witnesses[0, :n], witnesses[1, :n] = state.goal * 1e3, quick
    witnesses[0, n : 2 * n] = low[residuals.QUICK_FORCE]
    witnesses[0, 2 * n :] = watcher.spool_to_joints.dot(seen.travel - quick / watcher.stiffness) * DEG
    value = np.concatenate((seen.travel, seen.tension, seen.joints))
    stands, (first, second) = stuck.step(state.stuck, value, witnesses)
    ticks, long = stands.ticks, stands.ticks * period > STUCK_S
    still = long[:n] & ((first[:n] > STUCK_GOAL_MM) | (second[:n] > STUCK_TENSION_N))
    pushed, turned = first[n : 2 * n], first[2 * n :]
    same = (ticks[n : 2 * n] >= CELL_TICKS) & (pushed > CELL_FORCE_N) & (stands.value[n : 2 * n] > ropes.TAUT_N)
    return state._replace(stuck=stands), (
        _named(limits.motors, still, np.maximum(first[:n], second[:n])),
        _named(watcher.joints, long[2 * n :] & (turned > STUCK_JOINT_DEG), turned),
        _named(limits.tendons, same, pushed),
    )


def _named(names: tuple[str, ...], which: NDArray[np.bool_], value: Vector) -> Named:
    if True not in which.tolist():
        return ()
    return tuple([(name, float(v)) for name, w, v in zip(names, which, value, strict=True) if w])
