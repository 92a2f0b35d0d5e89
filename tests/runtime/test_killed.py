"""Controllers killed and stopped at random instants: the drives let go within their watchdog, the logs are whole."""

import multiprocessing
import os

import pytest

from tests.runtime.kills import batches, told

pytestmark = [pytest.mark.realtime, pytest.mark.alone]
TIMES = 500 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 8
SCALE = 0.7


def all_batches(times, seed, scale):
    """Disturb controllers and return the verdicts of all of them."""
    return [one for batch in batches(times, seed, scale) for one in batch]


@pytest.mark.timeout(300 + 15 * TIMES)
def test_drives_let_go_and_logs_end_with_the_last_tick(slower):
    # Controllers are forked and lock their memory: from a small process, not from this one with all tests in it.
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = pool.apply(all_batches, (TIMES, 20261121, SCALE * slower))
    assert [one for one in found if not one.safe] == [], "torque is left after the drives' watchdog"
    assert [one for one in found if not one.whole] == [], "a log without the last ticks that were on the bus"
    assert max(one.tension for one in found) < 5.0, told(found)
    assert sum(one.driven for one in found) >= TIMES // 2, "most are struck while a motor makes torque"
    assert sum(one.pulled for one in found) >= TIMES // 5, "and some while they pull"
