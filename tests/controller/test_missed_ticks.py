"""Test ticks that the controller has missed.

Planned motions continue during missed ticks. The module test_estimator_gate tests the effect of
missed ticks on the filter.
"""

import pytest

from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.programs.live_session import LiveProgram
from tests.controller.controller_bench import make_controller_bench

FAST_SPEED_RAD_S = 28.0
"""Speed of a rotor that pays out its tendon [rad/s]. The drive of the rotor can report speeds up to 30 rad/s."""


@pytest.mark.parametrize("missed_ticks", [0, 1, 4])
def test_a_fast_rotor_does_not_jump_because_ticks_were_skipped(
    jamia: HandModel, missed_ticks: int
) -> None:
    run = make_controller_bench(jamia, LiveProgram())
    run.run_until_mode(HandMode.ACTIVE)
    run.run(0.2)
    advance_tendons = run.toy_hand._advance_tendons

    def pay_out_and_advance() -> None:
        advance_tendons()
        run.toy_hand.spool_travel[0] -= (
            FAST_SPEED_RAD_S * run.toy_hand.spool_radius[0] * run.toy_hand.period_s
        )

    run.toy_hand._advance_tendons = pay_out_and_advance  # type: ignore[method-assign]
    for missed_before_tick in (0, 0, missed_ticks, 0, 0):
        run.tick(missed_ticks=missed_before_tick)
    assert not [event.text for event in run.events if event.text[:3] == "N05"]
    run.toy_hand.spool_travel[0] -= (
        3.0 * FAST_SPEED_RAD_S * run.toy_hand.spool_radius[0] * run.toy_hand.period_s
    )
    run.tick()
    run.tick()
    assert [event for event in run.events if event.text[:4] == "N05a"], (
        "positive control: a step that no rotor makes"
    )
