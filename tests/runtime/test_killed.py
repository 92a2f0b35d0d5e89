"""Controllers killed and stopped at random instants: the drives let go within their watchdog, the logs are whole."""

import os

import pytest

from tests.runtime.kills import batches, told

pytestmark = pytest.mark.realtime
TIMES = 500 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 8
SCALE = 0.7


@pytest.mark.timeout(300 + 15 * TIMES)
def test_drives_let_go_and_logs_end_with_the_last_tick(monkeypatch, tmp_path, slower):
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path))  # put back afterwards
    found = [one for batch in batches(TIMES, 20261121, SCALE * slower) for one in batch]
    assert [one for one in found if not one.safe] == [], "torque is left after the drives' watchdog"
    assert [one for one in found if not one.whole] == [], "a log without the last ticks that were on the bus"
    assert max(one.tension for one in found) < 5.0, told(found)
    assert sum(one.driven for one in found) >= TIMES // 2, "most are struck while a motor makes torque"
    assert sum(one.pulled for one in found) >= TIMES // 5, "and some while they pull"
