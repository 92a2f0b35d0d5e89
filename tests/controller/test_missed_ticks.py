"""Ticks that were skipped: what moves goes on meanwhile, for the watch on jumps and for the filter."""

import numpy as np
import pytest

from handctl.controller import estimator
from handctl.controller.filter_design import STATES, Regime, S, V, X
from handctl.controller.filter_state import FilterState
from handctl.controller.live import LiveProgram
from handctl.controller.model import HandModel
from handctl.controller.types import Mode
from tests.controller.bench import bench
from tests.controller.synthetic import nothing_read

FAST_RAD_S = 28.0
"""A rotor that pays out; the drive tells speeds up to 30 rad/s."""


@pytest.mark.parametrize("skip", [0, 1, 4])
def test_a_fast_rotor_does_not_jump_because_ticks_were_skipped(jamia: HandModel, skip: int) -> None:
    run = bench(jamia, LiveProgram())
    run.until(Mode.ACTIVE)
    run.run(0.2)
    moved = run.peer._move

    def paying_out() -> None:
        moved()
        run.peer.x[0] -= FAST_RAD_S * run.peer.spool[0] * run.peer.period_s

    run.peer._move = paying_out  # type: ignore[method-assign]
    for before in (0, 0, skip, 0, 0):
        run.tick(skip=before)
    assert not [event.text for event in run.events if event.text[:3] == "N05"]
    run.peer.x[0] -= 3.0 * FAST_RAD_S * run.peer.spool[0] * run.peer.period_s
    run.tick()
    run.tick()
    assert [event for event in run.events if event.text[:4] == "N05a"], "positive control: a step that no rotor makes"


@pytest.mark.parametrize(("missed", "predicted_s"), [(0, 0.0), (1, None), (4, None), (10_000, 0.05)])
def test_the_filter_predicts_every_tick_that_was_skipped(model, missed: int, predicted_s: float | None) -> None:
    """The motors' force stays, until after 50 ms nobody knows it; a change of tension was planned for one period."""
    state, force = coasting(model)
    rate, nowhere = np.full(model.tendon_count, 50.0), (False,) * len(model.digits)
    after, estimate = estimator.step(model, state, nothing_read(model), force, rate, nowhere, missed=missed)
    once, _ = estimator.step(model, state, nothing_read(model), force, rate, nowhere)
    filters, x = model.filter.stacked(once.regimes), once.x
    for _ in range(missed if predicted_s is None else round(predicted_s / model.period)):
        x = filters.F @ x + filters.B @ np.column_stack((force, np.zeros(model.tendon_count))).ravel()
    np.testing.assert_allclose(after.x, x, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(estimate.travel, after.x[X::STATES])
    assert after[1:5] == once[1:5], "nothing else is judged of what nobody saw"


def coasting(model: HandModel) -> tuple[FilterState, np.ndarray]:
    """Every digit held half closed under 20 N while its rotor winds, and the forces that balance the tension [N]."""
    x = np.zeros((model.tendon_count, STATES))
    x[:, S] = model.hand.moment_arms @ np.full(len(model.hand.joints), 0.5)
    x[:, X], x[:, V] = x[:, S] + 20.0 / model.space.stiffness, 1e-3
    return FilterState.of(x.ravel(), Regime.HELD, stopped=False), np.full(model.tendon_count, 20.0)
