"""Gains that ring are sent back by the watch, in the run, and the log says so."""

from pathlib import Path

import pytest

from handctl.cli.tuning.tune_verify import _who
from handctl.controller.bus_load import bus_loads
from handctl.core.gains.gains import Gains, MotionGains, TensionGains
from handctl.hand.load import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.exercise import Exercise
from handctl.replay.execute import execute
from handctl.session.plan import Plan, fastest
from handctl.session.run import make_controller, run_lockstep
from handctl.session.simulate import Simulator
from handctl.tune.verify import VerifyObserver, scores

CALM = Gains(motion=MotionGains(force_N=12.0, disturbance_rejection=0.5), tension=TensionGains(force_N=2.7))
WILD = Gains(motion=MotionGains(force_N=450.0), tension=TensionGains(force_N=300.0))


def _verified(new: Gains, log: Path) -> VerifyObserver:
    hand = load_hand("jamia")
    rate = fastest(bus_loads(hand))
    plan = Plan(hand, CALM, rate, (0.5,))
    amplitudes = (0.2, 0.2)
    watch = VerifyObserver(hand, CALM, new, amplitudes=amplitudes, old_rounds=1)
    with Simulator(hand, homed=True).clock(plan.period_ns) as clock:
        run_lockstep(plan, make_controller(plan, Exercise(amplitudes), None, True), log, clock, watch)
    return watch


@pytest.mark.parametrize(("new", "goes_back"), [pytest.param(CALM, False, marks=pytest.mark.nightly), (WILD, True)])
def test_gains_that_ring_are_sent_back(new: Gains, goes_back: bool, tmp_path: Path) -> None:
    watch = _verified(new, tmp_path / "run.mcap")
    assert (watch.returned is not None) == goes_back
    with RunLog(tmp_path / "run.mcap") as log:
        asked = [event for event in log.events if event.event.text == "asked: gains"]
        assert len(asked) == 1 + goes_back
        assert len(scores(log, watch.hand, None, 0)) == 2
        assert execute(log).differing == 0
    if watch.returned:
        assert "ring" in watch.returned.why
        assert watch.returned.k < asked[1].k <= watch.returned.k + 2


def test_a_report_says_whose_gains_each_round_was_done_with() -> None:
    assert [_who(i, None) for i in range(5)] == ["old", "old", "new", "new", "new"]
    assert [_who(i, {"amplitude": 0.6}) for i in range(5)] == ["old", "old", "new", "new, then old", "old again"]
