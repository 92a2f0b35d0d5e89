"""``handctl replay drive`` on the real clock: a golden grasp on a simulated hand in another process."""

import json
import tempfile
from pathlib import Path

import numpy as np
import pytest

from handctl.hand.description import load_hand
from handctl.log.reader import RunLog
from handctl.replay.drive import stretch
from tests.replay.runs import SCENE
from tests.runtime.processes import BUS, end, handctl, start_hand
from tests.runtime.test_process import write_calibration

pytestmark = pytest.mark.realtime
GOLDEN = Path(__file__).parents[2] / "logs" / "golden" / "jamia-grasp.mcap"
SCALE = ("--time-scale", "0.7")
SETTLED_S = 0.4


@pytest.fixture
def place(tmp_path, monkeypatch):
    with tempfile.TemporaryDirectory(prefix="h-") as short:
        monkeypatch.setenv("HANDCTL_RUN_DIR", short)
        monkeypatch.chdir(tmp_path)
        (tmp_path / "scene.toml").write_text(SCENE.format(friction=0.5))
        write_calibration(tmp_path / "c.toml", load_hand("jamia"))
        yield tmp_path


def while_held(log, start_s, begin_s, end_s):
    """Mean tensions (N,) between two times after the start of what is repeated [N]."""
    at = (log.times >= start_s + begin_s) & (log.times <= start_s + end_s)
    return log.field("tension")[at].mean(axis=0)


def test_a_golden_grasp_repeats_on_the_local_bus(place):
    simulated = start_hand(place / "x.truth", "--hand", "jamia", "--scene", "scene.toml", *SCALE)
    try:
        words = ("--hand", "jamia", "--bus", BUS, "--calibration", "c.toml", *SCALE)
        done = handctl("replay", "drive", str(GOLDEN), *words, "--log", "again.mcap", "--json")
    finally:
        end(simulated)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    single = 3.0  # at first touch one joint of a digit gives way before the other; the digit's mean does not
    assert {name for name, row in found["joint_deg"].items() if row["peak"] > single} == set()
    assert max(row["rms"] for row in found["joint_deg"].values()) < 0.5
    with RunLog(GOLDEN) as before, RunLog(place / "again.mcap") as after:
        starts = {change.name: change.t_ns * 1e-9 for change in before.phases}
        began, _ = stretch(before)
        held = (starts["hold"] + SETTLED_S - began, starts["release"] - began)
        again = next(change.t_ns * 1e-9 for change in after.phases if change.name == "playback")
        np.testing.assert_allclose(while_held(after, again, *held), while_held(before, began, *held), rtol=0.05)
