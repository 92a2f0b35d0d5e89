"""Prediction of the filter states to the present tick, by the package filterpy."""

import numpy as np

from handctl.core import state_block as s
from handctl.core.block_schema import BlockArray, BlockLayout
from handctl.core.deferred_imports import deferred_imports
from handctl.core.estimation.filter_covariance import MAX_TORQUE_HOLD_TIME_S
from handctl.core.estimation.filter_types import INPUT_COUNT, STATE_COUNT
from handctl.core.hand_model import HandModel

with deferred_imports():
    from filterpy.kalman import KalmanFilter


class FilterPrediction:
    """Prediction of the states of the tension filter for all tendons of a hand.

    The filter of filterpy contains the states of all tendons only during a prediction. Between two
    predictions, the states are in the state block.
    """

    def __init__(self, model: HandModel, layout: BlockLayout) -> None:
        """Compute the positions of the filter states and of the filter inputs in the state block.

        Args:
            model: model of the hand.
            layout: layout of the state block.
        """
        n = model.tendon_count
        first_state = layout.starts["tendon"]
        first_input = first_state + STATE_COUNT * n
        first_kind = layout.starts["tendon_int"] + n * s.FILTER_KIND
        self._tendon_count = n
        self._states = slice(first_state, first_input)
        self._inputs = slice(first_input, first_input + INPUT_COUNT * n)
        self._kinds = slice(first_kind, first_kind + n)
        self._transition = model.filter_design.transition
        self._filter = KalmanFilter(dim_x=1, dim_z=1)
        # The gains of the filter are constant, so it needs no covariance. ``predict`` sets x, F and
        # B, which have the size of the hand.
        self._filter.P = np.empty((0, 0))
        self._kinds_of_filter = b""
        self._max_missed_ticks = round(MAX_TORQUE_HOLD_TIME_S / model.period)

    def predict(self, block: BlockArray, missed_ticks: int = 0) -> None:
        """Predict the filter states of all tendons to the next tick.

        For missed ticks, the prediction uses the motor force of the last tick, and assumes no
        planned change of tension.

        Args:
            block: state block, modified in place.
            missed_ticks: ticks missed before the present tick.
        """
        tension_filter = self._filter
        kinds = block[self._kinds].tobytes()
        if kinds != self._kinds_of_filter:
            tension_filter.F, tension_filter.B = self._transition(kinds)
            self._kinds_of_filter = kinds
        inputs = block[self._inputs]
        tension_filter.x = block[self._states]
        tension_filter.predict_steadystate(inputs)
        if missed_ticks:
            n = self._tendon_count
            constant_inputs = np.concatenate((inputs[:n], np.zeros(n)))
            for _ in range(min(missed_ticks, self._max_missed_ticks)):
                tension_filter.predict_steadystate(constant_inputs)
        block[self._states] = tension_filter.x
