"""A load cell without its wire, through the whole controller."""

from dataclasses import replace

import numpy as np
import pytest

from handctl.controller.live import LiveProgram
from handctl.controller.model import HandModel
from handctl.controller.types import Mode
from tests.controller.bench import bench


@pytest.mark.parametrize("tare", [-3.0, 0.0, 5.0])
def test_a_wire_that_breaks_is_found_behind_every_tare(jamia: HandModel, tare: float) -> None:
    """The channel is empty, which is no tension however the cell is tared."""
    model, n = jamia, jamia.tendon_count
    run = bench(model, LiveProgram())
    run.controller = replace(run.controller, tare=np.full(n, tare))
    run.peer.bias[:] = tare
    run.until(Mode.ACTIVE)
    run.run(0.5)
    run.peer.bias[1] = -100.0
    told = [event.text[:3] for _ in range(4) for event in run.tick().events if event.name == "fault"]
    assert "T06" in told
    assert run.state.mode == Mode.RELAX
