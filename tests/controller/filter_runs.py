"""States, sensors and single ticks for tests of the tension filter."""

import numpy as np

from handctl.core.estimation import estimator
from handctl.core.estimation.estimator import Estimate, Measured
from handctl.core.estimation.filter_stack import STATES, Regime, S, X
from handctl.core.estimation.filter_state import FilterState
from handctl.core.model import HandModel
from tests.controller.synthetic import nothing_read


def resting(model: HandModel, tension: float, closed: float) -> tuple[np.ndarray, np.ndarray]:
    """State (N, 7) of a hand at rest with all joints at ``closed`` [rad], and the motor forces that hold it there."""
    x = np.zeros((model.tendon_count, STATES))
    x[:, S] = model.hand.moment_arms @ np.full(len(model.hand.joints), closed)
    x[:, X] = x[:, S] + tension / model.space.stiffness
    return x, np.full(model.tendon_count, tension)


def step(
    model: HandModel, state: FilterState, measured: Measured, force: np.ndarray, contact: tuple[bool, ...]
) -> tuple[FilterState, Estimate]:
    """A tick in which no change of tension is intended."""
    return estimator.step(model, state, measured, force, np.zeros(model.tendon_count), contact)


def readings(model: HandModel, x: np.ndarray, tension: np.ndarray, excursion: bool = False) -> Measured:
    """What noiseless sensors read of a state (N, 7) with these tensions; joint encoders only if asked."""
    return nothing_read(model)._replace(
        travel=x[:, X].copy(),
        tension=tension,
        excursion=x[:, S] if excursion else np.full(len(x), np.nan),
    )


def all_in(model: HandModel, regime: Regime, x: np.ndarray) -> FilterState:
    """Every tendon in one regime, digits off their stops."""
    return FilterState.of(x.ravel(), regime, stopped=False)


def nowhere(model: HandModel) -> tuple[bool, ...]:
    """No digit is in contact."""
    return (False,) * len(model.digits)
