"""Prediction of the filter states to the present tick, by the package filterpy."""

import numpy as np

from handctl.core import state_block as s
from handctl.core.block_schema import BlockArray, BlockLayout
from handctl.core.deferred_imports import deferred_imports
from handctl.core.estimation.filter_covariance import MAX_TORQUE_HOLD_TIME_S
from handctl.core.hand_model import HandModel

with deferred_imports():
    from filterpy.kalman import predict_steadystate


def predict_filter_states(
    model: HandModel, layout: BlockLayout, block: BlockArray, missed_ticks: int = 0
) -> None:
    """Predict the states of the tension filter for all tendons to the next tick.

    For missed ticks, the prediction uses the motor force of the last tick, and assumes no planned
    change of tension.

    Args:
        model: model of the hand.
        layout: layout of the state block.
        block: state block, modified in place.
        missed_ticks: ticks missed before the present tick.
    """
    n = model.tendon_count
    first_element = layout.start("tendon")
    states = block[first_element : first_element + 7 * n]
    inputs = block[first_element + 7 * n : first_element + 9 * n]
    first_kind_element = layout.start("tendon_int") + n * s.FILTER_KIND
    F, B = model.filter_design.transition(
        block[first_kind_element : first_kind_element + n].tobytes()
    )
    x = predict_steadystate(states, F, inputs, B)
    if missed_ticks:
        constant_inputs = np.concatenate((inputs[:n], np.zeros(n)))
        for _ in range(min(missed_ticks, round(MAX_TORQUE_HOLD_TIME_S / model.period))):
            x = predict_steadystate(x, F, constant_inputs, B)
    states[:] = x
