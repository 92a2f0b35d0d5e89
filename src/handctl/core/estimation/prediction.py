"""Prediction of the tension filter to the present, by filterpy.

The package of filterpy imports ``scipy.stats`` for likelihoods, which are not used here. That import takes as long as
all others of a run, so that it is put off until somebody uses a distribution.
"""

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np

from handctl.core import block as s
from handctl.core.estimation.covariance import HELD_TORQUE_S
from handctl.core.model import HandModel
from handctl.core.schema import Block, Layout


class _Later:
    """A distribution of ``scipy.stats`` that is imported when it is used."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, method: str) -> Callable[..., Any]:
        return lambda *given, **named: self._use(lambda real: getattr(real, method)(*given, **named))

    def __call__(self, *given: Any, **named: Any) -> Any:
        """Return the distribution with these parameters."""
        return self._use(lambda real: real(*given, **named))

    def _use(self, use: Callable[[Any], Any]) -> Any:
        """Use the distribution; while filterpy is imported, which tries one call, nothing is computed."""
        stats: Any = importlib.import_module("scipy.stats")
        return None if isinstance(getattr(stats, self._name), _Later) else use(getattr(stats, self._name))


@contextmanager
def _without_stats() -> Iterator[None]:
    """Stand in for ``scipy.stats`` during an import."""
    if "scipy.stats" in sys.modules:
        yield
        return
    stand_in: Any = ModuleType("scipy.stats")
    stand_in.norm, stand_in.multivariate_normal = _Later("norm"), _Later("multivariate_normal")
    sys.modules["scipy.stats"] = stand_in
    try:
        yield
    finally:
        del sys.modules["scipy.stats"]


with _without_stats():
    from filterpy.kalman import predict_steadystate


def predict(model: HandModel, layout: Layout, block: Block, missed: int = 0) -> None:
    """Predict the states of all tendons; of ticks that were skipped nothing was planned.

    Args:
        model: the hand. layout: of the block. block: the state, changed.
        missed: ticks that were skipped before this one.
    """
    n, first = model.tendon_count, layout.start("tendon")
    states, inputs = block[first : first + 7 * n], block[first + 7 * n : first + 9 * n]
    F, B = model.filter.transition(layout.table(block, "tendon_int")[s.KIND].tobytes())
    x = predict_steadystate(states, F, inputs, B)
    if missed:
        held = np.concatenate((inputs[:n], np.zeros(n)))
        for _ in range(min(missed, round(HELD_TORQUE_S / model.period))):
            x = predict_steadystate(x, F, held, B)
    states[:] = x
