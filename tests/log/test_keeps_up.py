"""Test that one processor core can record a run in real time.

The recorded run has eleven motors, a control rate of 1 kHz, and raw frames.
"""

import multiprocessing
import os
from pathlib import Path

import pytest

from benchmarks.writers.sustained_recording import measure_sustained

pytestmark = [pytest.mark.realtime, pytest.mark.alone]
DURATION_S = 30.0 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 1.0
FRAMES_PER_TICK = 24
"""Number of frames in a tick: eleven commands, eleven replies, a SYNC frame, and one frame of load cells."""


def test_nothing_is_dropped_and_the_recorder_has_a_core_to_spare(tmp_path: Path) -> None:
    # the control loop locks the memory of its process, so the measurement has its own process
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        result = pool.apply(measure_sustained, (tmp_path / "run.mcap", DURATION_S))
    assert (result["dropped"], result["lost"]) == (0, 0)
    assert result["ticks"] == result["ticks_in_log"] > 0.9 * 1000 * DURATION_S
    assert result["frames_in_log"] == pytest.approx(FRAMES_PER_TICK * result["ticks"], rel=0.001)
    assert result["recorder_core_share"] < 0.5
