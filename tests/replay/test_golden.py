"""Re-execute all golden logs. A change of the code for other hands changes no bit of their telemetry.

Regression: a sum of products in another order changed the last bits of ``q_sigma`` in jamia11-grasp.
"""

from pathlib import Path

import pytest

from handctl.cli.main import main

GOLDEN = sorted((Path(__file__).parents[2] / "logs" / "golden").glob("*.mcap"))


@pytest.mark.parametrize("log", GOLDEN, ids=[log.stem for log in GOLDEN])
def test_a_golden_log_is_re_executed_without_a_difference(log: Path) -> None:
    assert main(["replay", "execute", str(log)]) == 0
