"""LeRobot's bus class for RobStride motors commands simulated motors in MIT mode.

The test needs an environment with lerobot.
"""

import pytest

from tests.drives.bench_process import run_simulated_drives

pytest.importorskip(
    "lerobot", reason="needs an environment of its own: lerobot_robot_handctl/README.md"
)
pytestmark = pytest.mark.realtime
LOCAL_BUS_NAME = "lerobot"


def test_lerobot_controls_simulated_robstride_motors(monkeypatch: pytest.MonkeyPatch) -> None:
    from tests.drives.lerobot_client import use_lerobot_robstride

    with run_simulated_drives(f"local:{LOCAL_BUS_NAME}", "robstride_mit", "--ids", "1,2"):
        use_lerobot_robstride("local", LOCAL_BUS_NAME, monkeypatch, (1, 2))
