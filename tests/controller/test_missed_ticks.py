"""Test ticks that the controller skips.

Motions continue meanwhile. test_estimator_gate tests the effect on the filter.
"""

import pytest

from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.programs.live_session import LiveProgram
from tests.controller.bench import bench

FAST_RAD_S = 28.0
"""Speed of a rotor that pays out its tendon [rad/s]. The drive can report speeds up to 30 rad/s."""


@pytest.mark.parametrize("skip", [0, 1, 4])
def test_a_fast_rotor_does_not_jump_because_ticks_were_skipped(jamia: HandModel, skip: int) -> None:
    run = bench(jamia, LiveProgram())
    run.until(HandMode.ACTIVE)
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
    assert [event for event in run.events if event.text[:4] == "N05a"], (
        "positive control: a step that no rotor makes"
    )
