"""Test the verification of gains.

If the loops oscillate with new gains, the run returns to the old gains, and the log shows the
change.
"""

from pathlib import Path

import pytest

from handctl.cli.tuning.tune_verify import _gains_label, return_text
from handctl.core.gains.gains import Gains, MotionGains, TensionGains
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.exercise import ExerciseProgram
from handctl.replay.execute import execute_log
from handctl.session.plan import RunPlan, default_rate
from handctl.session.run import make_controller, run_lockstep
from handctl.session.simulate import SimulatorSettings
from handctl.tune.gains_verification import VerifyObserver, scores_by_round

CALM_GAINS = Gains(
    motion=MotionGains(force_N=12.0, disturbance_rejection=0.5), tension=TensionGains(force_N=2.7)
)
UNSTABLE_GAINS = Gains(motion=MotionGains(force_N=450.0), tension=TensionGains(force_N=300.0))


def _verify_gains(new: Gains, log: Path) -> VerifyObserver:
    hand = load_hand("jamia")
    rate = default_rate(hand)
    plan = RunPlan(hand, CALM_GAINS, rate, (0.5,))
    amplitudes = (0.2, 0.2)
    observer = VerifyObserver(hand, CALM_GAINS, new, amplitudes=amplitudes, old_rounds=1)
    with SimulatorSettings(hand, homed=True).lockstep_clock(plan.period_ns) as clock:
        run_lockstep(
            plan,
            make_controller(plan, ExerciseProgram(amplitudes), None, True),
            log,
            clock,
            observer,
        )
    return observer


@pytest.mark.parametrize(
    ("new", "goes_back"),
    [pytest.param(CALM_GAINS, False, marks=pytest.mark.nightly), (UNSTABLE_GAINS, True)],
)
def test_ringing_gains_are_rolled_back(new: Gains, goes_back: bool, tmp_path: Path) -> None:
    observer = _verify_gains(new, tmp_path / "run.mcap")
    assert (observer.rollback is not None) == goes_back
    with RunLog(tmp_path / "run.mcap") as log:
        requests = [event for event in log.events if event.event.text == "asked: gains"]
        assert len(requests) == 1 + goes_back
        assert len(scores_by_round(log, observer.hand, None, 0)) == 2
        assert execute_log(log).differing_ticks == 0
    if observer.rollback:
        assert "oscillate" in observer.rollback.why
        assert observer.rollback.k < requests[1].k <= observer.rollback.k + 2


def test_a_report_names_the_gains_of_each_round() -> None:
    assert [_gains_label(i, None) for i in range(5)] == ["old", "old", "new", "new", "new"]
    assert [_gains_label(i, {"amplitude": 0.6}) for i in range(5)] == [
        "old",
        "old",
        "new",
        "new, then old",
        "old again",
    ]


def test_the_page_about_tuning_quotes_the_report() -> None:
    page = Path(__file__).parents[2] / "docs" / "how-to" / "tuning.md"
    text = " ".join(page.read_text(encoding="utf-8").split())
    why = "motor torques oscillate by 60.9 N m/s, limit 60.0"
    quote = return_text({"t_s": 13.298, "k": 6649, "amplitude": 0.3, "why": why})
    assert f'"{quote}"' in text
    later_rounds = {_gains_label(i, {"amplitude": 0.3}) for i in range(2, 5)}
    assert all(f'"{label}"' in text for label in later_rounds)
