"""Small parts of the filter at their limits and with every sign."""

import numpy as np
import pytest

from handctl.core.estimation.estimator import (
    LOOSE_M,
    STOP_BAND_M,
    STOP_PULL,
    Estimate,
    Measured,
    _at_stop,
    _regimes,
    _unexplained,
    _usable,
    step,
)
from handctl.core.estimation.filter_stack import STATES, O, Regime, S, W, X
from handctl.core.estimation.filter_state import FilterState
from handctl.core.estimation.statics import load_statics
from handctl.core.estimation.take_up import EVIDENCE, NEAR_FACTOR, NEAR_M, TAUT_POINTS
from handctl.core.model import HandModel


@pytest.mark.parametrize("was", [False, True])
def test_a_digit_is_on_its_stop_below_its_limits_and_not_at_them(was: bool) -> None:
    band, most = STOP_BAND_M[was], 10.0 * STOP_PULL[was]
    assert _at_stop(was, np.nextafter(band, 0.0), np.nextafter(most, 0.0), 10.0)
    assert not _at_stop(was, band, 0.0, 10.0)
    assert not _at_stop(was, 0.0, most, 10.0)


def filtered(model: HandModel, regime: Regime, **columns: float) -> FilterState:
    """Every tendon in one regime, off its stop; columns of the state by name."""
    x = np.zeros((model.tendon_count, STATES))
    for name, value in columns.items():
        x[:, {"X": X, "S": S, "W": W, "O": O}[name]] = value
    return FilterState.of(x.ravel(), regime, stopped=False)


def test_what_a_moving_digit_s_damping_takes_is_no_contact(model: HandModel) -> None:
    still, moves = (filtered(model, Regime.FREE, S=2e-3, W=rate) for rate in (0.0, 0.05))
    filters, tension = model.filter.stacked(still.regimes), np.full(model.tendon_count, 20.0)
    statics = load_statics(model, still.x.reshape(-1, STATES), tension)
    less = _unexplained(model, moves, filters, statics) - _unexplained(model, still, filters, statics)
    np.testing.assert_allclose(less, -0.05 * model.space.load_damping, rtol=1e-12)
    assert _unexplained(model, still, filters, statics).all(), "20 N are more than springs ask here"


def test_a_slack_rope_bears_no_contact_wherever_its_digit_is(model: HandModel) -> None:
    state = filtered(model, Regime.SLACK, S=2e-3)
    statics = load_statics(model, state.x.reshape(-1, STATES), np.full(model.tendon_count, 20.0))
    assert not _unexplained(model, state, model.filter.stacked(state.regimes), statics).any()


@pytest.mark.parametrize(("x", "s", "o"), [(-3e-4, 0.0, 0.0), (-1e-4, 3e-4, 0.0), (-1e-4, 0.0, 3e-4)])
def test_a_rope_hangs_loose_by_what_its_spool_is_short_of_its_digit(
    model: HandModel, x: float, s: float, o: float
) -> None:
    """Its load cell then shows its error; of a rope that is nearly taut nobody knows."""
    n, read = model.tendon_count, 0.3
    nothing = np.full(n, np.nan)
    measured = Measured(np.zeros(n), np.full(n, read), nothing, np.full(len(model.hand.joints), np.nan))
    for more, usable in ((0.0, True), (LOOSE_M + 1e-5, False)):
        state = filtered(model, Regime.SLACK, X=x + more, S=s, O=o)._replace(measured=(True,) * n)
        z = _usable(state, model.filter.stacked(state.regimes), measured)
        assert np.isfinite(z[1::3]).all() == usable
    state = filtered(model, Regime.SLACK, X=x, S=s, O=o)
    assert np.isnan(_usable(state, model.filter.stacked(state.regimes), measured)[1::3]).all(), (
        "its length is not known"
    )


def judged(model: HandModel, state: FilterState, cell: float) -> FilterState:
    """What a sample of all load cells makes of the regimes, of digits that touch nothing."""
    n = model.tendon_count
    none = np.zeros(n)
    read = Measured(none, np.full(n, cell), np.full(n, np.nan), np.full(len(model.hand.joints), np.nan))
    statics = load_statics(model, state.x.reshape(-1, STATES), none)
    return _regimes(model, state, state.x, none, statics, read, (False,) * len(model.digits))


@pytest.mark.parametrize(
    ("hangs_m", "known", "turns"), [(0.0, True, True), (2 * NEAR_M, True, False), (0.0, False, False)]
)
def test_a_rope_that_is_about_to_be_taut_by_its_encoder_is_so_at_a_sample(
    model: HandModel, hangs_m: float, known: bool, turns: bool
) -> None:
    """If its length is known from a take-up; the count then begins anew."""
    n = model.tendon_count
    above = next(above for above, worth in EVIDENCE if worth * NEAR_FACTOR >= TAUT_POINTS > worth)
    state = filtered(model, Regime.SLACK, X=2e-3 - hangs_m, S=2e-3)._replace(measured=(known,) * n)
    after = judged(model, state, above + 1e-6)
    assert after.regimes == ((Regime.FREE if turns else Regime.SLACK),) * n
    assert (after.turning == (0,) * n) == turns
    assert after.measured == (known,) * n


def test_a_rope_that_became_taut_has_a_known_length(model: HandModel) -> None:
    n = model.tendon_count
    state = filtered(model, Regime.SLACK, S=2e-3)
    for _ in range(TAUT_POINTS):
        state = judged(model, state, EVIDENCE[0][0] + 1.0)
    assert (state.regimes, state.measured) == ((Regime.FREE,) * n, (True,) * n)


def test_a_digit_on_its_stop_is_at_zero_when_its_rope_becomes_taut(model: HandModel) -> None:
    state = filtered(model, Regime.SLACK, S=1e-4)._replace(stopped=(True,) * model.tendon_count)
    after = judged(model, state, EVIDENCE[0][0] + 1e-6)
    assert after.stopped == state.stopped
    assert (after.x[S::STATES] == 0.0).all()
    assert (state.x[S::STATES] == 1e-4).all(), "of the state before nothing is changed"


def test_an_estimate_tells_every_column_before_anything_was_read(model: HandModel) -> None:
    n, j = model.tendon_count, len(model.hand.joints)
    missing = Measured(*(np.full(size, np.nan) for size in (n, n, n, j)))
    no = (False,) * len(model.digits)
    _, estimate = step(model, FilterState.initial(n), missing, np.zeros(n), np.zeros(n), no)
    shapes = {name: np.shape(value) for name, value in zip(Estimate._fields, estimate, strict=True)}
    assert {name for name, shape in shapes.items() if shape == (j,)} >= {"q", "dq"}
    assert all(shape in ((n,), (j,), (len(model.digits),)) for shape in shapes.values()), shapes
