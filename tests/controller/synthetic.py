"""Estimates and measurements made up for a hand, for what runs on top of the filter."""

import numpy as np

from handctl.core.estimation.estimator import Estimate, Measured
from handctl.core.estimation.filter_stack import STATES, S, V, W, X
from handctl.core.estimation.statics import load_statics
from handctl.core.model import HandModel


def known(model: HandModel, x: np.ndarray) -> Estimate:
    """An estimate that knows a state (N, 7) exactly; taut and untouched."""
    n = model.tendon_count
    q, dq = np.zeros(len(model.hand.joints)), np.zeros(len(model.hand.joints))
    for digit, tendons in zip(model.digits, model.digit_tendons, strict=True):
        q[digit.joints] = digit.excursion_to_joints @ x[tendons, S]
        dq[digit.joints] = digit.excursion_to_joints @ x[tendons, W]
    space = model.space
    tension = space.stiffness * (x[:, X] - x[:, S]) + space.damping * (x[:, V] - x[:, W])
    nothing = np.zeros(n)
    return Estimate(
        tension=np.maximum(tension, 0.0),
        sigma=nothing,
        travel=x[:, X].copy(),
        speed=x[:, V].copy(),
        excursion=x[:, S].copy(),
        rate=x[:, W].copy(),
        motor_disturbance=nothing,
        external=nothing,
        offset=nothing,
        cell_error=nothing,
        innovation=nothing,
        nis=nothing,
        slack=np.zeros(n, dtype=bool),
        q=q,
        dq=dq,
        q_sigma=np.full(len(q), np.nan),
    )


def at_rest(model: HandModel, closed: float) -> np.ndarray:
    """State (N, 7) in balance with springs and weight, all coordinates at ``closed`` [rad]."""
    x = np.zeros((model.tendon_count, STATES))
    for digit, tendons in zip(model.digits, model.digit_tendons, strict=True):
        x[tendons, S] = digit.reduced_moment_arms @ np.full(digit.coupling.shape[1], closed)
    x[:, X] = x[:, S] + load_statics(model, x, np.zeros(len(x))).resistance / model.space.stiffness
    return x


def under(model: HandModel, tension: float | np.ndarray, closed: float = 0.0) -> Estimate:
    """An estimate of a still hand whose tendons carry a tension."""
    return known(model, at_rest(model, closed))._replace(tension=np.full(model.tendon_count, 1.0) * tension)


def slack(model: HandModel) -> Estimate:
    """An estimate of a hand whose tendons carry nothing."""
    return under(model, 0.0)._replace(slack=np.ones(model.tendon_count, dtype=bool))


def nothing_read(model: HandModel) -> Measured:
    """A tick in which no frame came."""
    n, joints = model.tendon_count, len(model.hand.joints)
    return Measured(np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan), np.full(joints, np.nan))
