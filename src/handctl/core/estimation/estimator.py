"""The tension filter in motion: load cell and encoder (and joint encoders) to tension, excursion and contact force.

All tendons are one linear filter, run with filterpy's steady-state ``predict``; its ``update`` is written out, because
the innovation is known already. A missing measurement has none, and neither has a saturated one: from then on the
covariance is carried along until it is steady again. A single one that is too far off to be true is left out. The
result is the prediction to the present instant: the measurements of a tick were taken one period earlier, just before
the previous command acted. Ticks that were skipped are predicted one by one, too: meanwhile the motors held what
they had been told, and nothing was planned.
"""

from typing import NamedTuple

import numpy as np
from filterpy.kalman import predict_steadystate
from numpy.typing import NDArray

from handctl.choose import Array, known, nothing, zeros
from handctl.core.estimation import covariance, take_up
from handctl.core.estimation.filter_stack import MEASUREMENTS, STATES, D, E, O, Regime, S, Stacked, V, W, X, kinds
from handctl.core.estimation.filter_state import FilterState
from handctl.core.estimation.innovation import caution, gate, watch
from handctl.core.estimation.statics import LoadStatics, load_statics
from handctl.core.model import HandModel
from handctl.core.types import Vector

FREE, HELD, SLACK = (int(regime) for regime in Regime)
STOP_BAND_M = (2e-5, 1e-4)
"""Excursion below which a digit may be on its open stop: to come to rest there, and to stay [m]."""
STOP_PULL = (0.8, 1.05)
"""Pull, as a share of what the springs ask, below which it is: to come to rest, so little that friction cannot hold
it just above the stop, and to stay."""
HELD_TORQUE_S = 0.05
"""Longest time without a command that is predicted; then the drives' watchdogs have let go."""
LOOSE_M = 2e-4
"""Rope that must hang loose for its load cell to show nothing but its error."""


class Measured(NamedTuple):
    """Measurements of one tick, (N,) each; NaN where missing.

    Attributes:
        travel: encoder, cable travel at the spool [m].
        tension: load cell, tared [N].
        excursion: from joint encoders [m].
        joints: (J,) the joint encoders themselves [rad].
        railed: tendons whose load cell is at an end of its range: that is no measurement.
        read: whether any joint encoder was read.
        position: (N,) encoder, at the spool [rad]; the filter does not look at it.
    """

    travel: Vector
    tension: Vector
    excursion: Vector
    joints: Vector
    railed: tuple[int, ...] = ()
    read: bool = True
    position: Vector = nothing(0)


class Estimate(NamedTuple):
    """The present instant, (N,) each unless said otherwise.

    Attributes:
        tension: at the load cell [N]; 0 in slack.
        sigma: its standard deviation [N].
        travel, speed: cable at the spool [m], [m/s].
        excursion, rate: at the joints [m], [m/s].
        motor_disturbance: force on the motor that the model lacks [N].
        external: load force that the model lacks, positive against closing: contact [N].
        offset: stretch offset [m].
        cell_error: load-cell error, as last seen in slack [N].
        innovation: load cell minus prediction [N]; NaN if missing.
        nis: normalised innovation squared of encoder and load cell; NaN if missing.
        slack: boolean.
        q, dq: (J,) joint angles [rad] and rates [rad/s].
        q_sigma: (J,) standard deviation of the angles [rad]; NaN before ``posture`` has seen to it.
    """

    tension: Vector
    sigma: Vector
    travel: Vector
    speed: Vector
    excursion: Vector
    rate: Vector
    motor_disturbance: Vector
    external: Vector
    offset: Vector
    cell_error: Vector
    innovation: Vector
    nis: Vector
    slack: NDArray[np.bool_]
    q: Vector
    dq: Vector
    q_sigma: Vector


def start(model: HandModel, state: FilterState, travel: Vector) -> FilterState:
    """Begin, once every load cell has been read: hand open, ropes slack.

    Args:
        model: the hand.
        state: not started.
        travel: (N,) last reading of each encoder, cable travel at the spool [m]; NaN, and it does not begin yet.
    """
    if np.isnan(travel).any():
        return state
    x = np.zeros((model.tendon_count, STATES))
    x[:, X] = travel
    return state._replace(x=x.ravel(), started=True)


def step(
    model: HandModel,
    state: FilterState,
    measured: Measured,
    force: Vector,
    rate: Vector,
    contact: tuple[bool, ...],
    friction_state: Vector | None = None,
    missed: int = 0,
) -> tuple[FilterState, Estimate]:
    """Take in the measurements of one tick and predict to the present.

    Args:
        model: the hand.
        state: from the last tick; one that is not started, see ``start``, stays as it is.
        measured: taken at the last tick's instant.
        force: (N,) motor force at the cable that acted since, without what friction takes [N].
        rate: (N,) at which the tension was meant to change since [N/s]; it counts where a digit moves freely.
        contact: per digit, whether it is known to touch.
        friction_state: (N,) how far friction is developed where that is known, 1 winding, -1 paying out; NaN elsewhere.
        missed: ticks that were skipped since.

    Returns:
        state for the next tick, and the estimate now.
    """
    if not state.started:
        unknown = nothing(model.tendon_count)
        return state, _estimate(model, state, state.x, unknown, unknown, zeros(model.tendon_count))
    before = kinds(state.regimes, state.wary)
    filters = model.filter.stacked(before)
    z = _usable(state, filters, measured)
    worth, innovation = None, z - filters.H.dot(state.x)
    if missed or state.covariance is not None or covariance.missing(filters, z):
        worth = covariance.update(model.filter.spread(before), state.covariance, z)
    sure: Stacked | covariance.Update = worth or filters
    innovation, surprise, believed = gate(filters, sure.cell_sigma, state.surprise, innovation)
    used = known(innovation.copy())
    x = state.x + filters.K.dot(used) if worth is None else worth.corrected(state.x, filters, used)
    for i, change in believed:
        x[STATES * i + S] -= change / model.space.stiffness[i]
    tension = filters.tension.dot(x)
    statics = load_statics(model, x.reshape(-1, STATES), tension, friction_state)
    judged = _regimes(model, state, x, tension, statics, measured, contact)
    nis = _nis(sure.information, innovation)
    usual = nis if worth is not None or not filters.doubted else _nis(filters.usual_information, innovation)
    mean, doubtful = watch(model.period, state.nis, state.doubtful, usual)
    lately, wary = caution(model.period, state.lately, state.wary, usual)
    now = kinds(judged.regimes, wary)
    filters = model.filter.stacked(now)
    if judged.x is not x:
        x = judged.x
        statics = load_statics(model, x.reshape(-1, STATES), filters.tension.dot(x), friction_state)
    external = _unexplained(model, judged, filters, statics)
    x = predict_steadystate(x, filters.F, _interleaved(force, rate), filters.B)
    skipped = min(missed, round(HELD_TORQUE_S / model.period))
    for _ in range(skipped):
        x = predict_steadystate(x, filters.F, _interleaved(force, zeros(len(force))), filters.B)
    P = None if worth is None else _carried(model, before, now, worth, 1 + skipped)
    after = judged._replace(
        x=x, surprise=surprise, nis=mean, doubtful=doubtful, lately=lately, wary=wary, covariance=P, started=True
    )
    return after, _estimate(model, after, x, innovation[1::MEASUREMENTS], nis, external)


def _carried(
    model: HandModel, before: tuple[int, ...], now: tuple[int, ...], worth: covariance.Update, periods: int
) -> Array | None:
    """The covariance of the next tick's prediction; None once it is the steady one."""
    changed = [i for i, (was, kind) in enumerate(zip(before, now, strict=True)) if was != kind]
    return covariance.carried(model.filter.spread(now), worth.after, changed, periods)


def _usable(state: FilterState, filters: Stacked, measured: Measured) -> Vector:
    """(3N,) measurements, NaN where none: lost, at an end of the range, or of a rope neither taut nor loose."""
    z = _interleaved(measured.travel, measured.tension, measured.excursion)
    for i in measured.railed:
        z[MEASUREMENTS * i + 1] = np.nan
    if SLACK in state.regimes:
        x = state.x.reshape(-1, STATES)
        loose = (x[:, X] - x[:, S] - x[:, O] < -LOOSE_M) & state.measured
        z[1::MEASUREMENTS][filters.slack & ~loose] = np.nan
    return z


def _interleaved(*columns: Vector) -> Vector:
    """Columns (N,) as one vector, tendon after tendon."""
    return np.array(columns).T.reshape(-1)


def _regimes(
    model: HandModel,
    state: FilterState,
    x: Vector,
    tension: Vector,
    statics: LoadStatics,
    measured: Measured,
    contact: tuple[bool, ...],
) -> FilterState:
    """Judge slack, stops and contact, and set the offset when a rope becomes taut.

    The vector of the state returned is ``x`` itself only if nothing in it or its regime has changed.
    """
    cells, tensions, excursions = measured.tension.tolist(), tension.tolist(), x[S::STATES].tolist()
    still_taut = min(tensions) >= take_up.SLACK_BELOW_N and min(excursions) >= STOP_BAND_M[0]
    if still_taut and True not in state.stopped and state.regimes == _touching(model, contact):
        return state._replace(x=x, turning=(0,) * len(cells))  # taut before and now, and nowhere near a stop
    errors = x[E::STATES].tolist()
    pull, resistance = statics.eager.tolist(), statics.resistance.tolist()
    regimes, stopped, turning = list(state.regimes), list(state.stopped), list(state.turning)
    ropes, table = state.measured, None
    for tendons, touches in zip(model.digit_tendons, contact, strict=True):
        for i in range(tendons.start, tendons.stop):
            near = regimes[i] == SLACK and ropes[i] and take_up.near(x[STATES * i : STATES * (i + 1)])
            turning[i] = take_up.turning(regimes[i], turning[i], tensions[i], cells[i], errors[i], near)
            if take_up.has_turned(regimes[i], turning[i]):
                turning[i] = 0
                if regimes[i] == SLACK:
                    table = x.reshape(-1, STATES).copy() if table is None else table
                    take_up.take_up(table[i], float(model.space.stiffness[i]), cells[i], stopped[i])
                    excursions[i] = float(table[i, S])
                    ropes = (*ropes[:i], True, *ropes[i + 1 :])
                regimes[i] = FREE if regimes[i] == SLACK else SLACK
            was, stopped[i] = stopped[i], _at_stop(stopped[i], excursions[i], pull[i], resistance[i])
            if regimes[i] == SLACK:
                continue
            if stopped[i] and not was:
                table = x.reshape(-1, STATES).copy() if table is None else table
                _on_stop(table[i])
            regimes[i] = HELD if touches or stopped[i] else FREE
    judged = tuple(regimes)
    vector = x if table is None else table.reshape(-1)
    if vector is x and judged != state.regimes:
        vector = x.copy()
    return state._replace(
        x=vector, regimes=judged, stopped=tuple(stopped), turning=tuple(turning), measured=ropes
    )


def _touching(model: HandModel, contact: tuple[bool, ...]) -> tuple[int, ...]:
    """Regimes of taut ropes, away from every stop."""
    return tuple([HELD if contact[digit] else FREE for digit in model.digit_of])


def _on_stop(x: Vector) -> None:
    """The digit has come to rest on its open stop: its excursion is known to be zero, the rest was offset."""
    x[O] += x[S]
    x[S] = x[W] = 0.0


def _at_stop(was: bool, excursion: float, pull: float, resistance: float) -> bool:
    """Whether springs hold the digit on its open stop against the tendon."""
    return bool(excursion < STOP_BAND_M[was] and pull < resistance * STOP_PULL[was])


def _unexplained(model: HandModel, state: FilterState, filters: Stacked, statics: LoadStatics) -> Vector:
    """(N,) load force that the model lacks, positive against closing [N]; nothing in slack and on the open stop."""
    external = statics.pull - statics.resistance - model.space.load_damping * state.x[W::STATES]
    if SLACK not in state.regimes and True not in state.stopped:
        return external
    return np.where(filters.slack | state.stopped, 0.0, external)


def _nis(information: tuple[Array, ...], innovation: Vector) -> Vector:
    """(N,) normalised innovation squared of encoder and load cell; NaN where one is missing."""
    encoder, cell = innovation[0::MEASUREMENTS], innovation[1::MEASUREMENTS]
    own, mixed, other = information
    return np.asarray((own * encoder + mixed * cell) * encoder + other * (cell * cell))


def _estimate(
    model: HandModel, state: FilterState, x: Vector, innovation: Vector, nis: Vector, external: Vector
) -> Estimate:
    """Args: x: (7N,) prediction. innovation: (N,) of the load cells, NaN where missing. nis, external: (N,)."""
    chosen, P = kinds(state.regimes, state.wary), state.covariance
    filters = model.filter.stacked(chosen)
    table = x.reshape(-1, STATES)
    q, dq = joint_angles(model, table[:, S], table[:, W])
    return Estimate(
        np.maximum(filters.tension.dot(x), 0.0),
        filters.sigma if P is None else covariance.sigma(model.filter.spread(chosen), P),
        table[:, X],
        table[:, V],
        table[:, S],
        table[:, W],
        table[:, D],
        external,
        table[:, O],
        table[:, E],
        innovation,
        nis,
        filters.slack,
        q,
        dq,
        nothing(len(q)),
    )


def joint_angles(model: HandModel, excursion: Vector, rate: Vector) -> tuple[Vector, Vector]:
    """Joint angles (J,) [rad] and rates (J,) [rad/s] of excursions (N,) [m] and rates (N,) [m/s], q = B R_r^+ s."""
    return model.excursion_to_joints.dot(excursion), model.excursion_to_joints.dot(rate)
