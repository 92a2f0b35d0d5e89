"""The Python package ``robstride`` reads and sets up the simulated motor in the private protocol of RobStride.

The package ``robstride`` reads and writes parameters and enables the motor, but cannot send control
commands. The package ``robstride`` decodes only one of the two bits of the motor mode, so the test
does not compare the mode.
"""

import can
import pytest

from tests.drives.bench_process import run_simulated_drives

robstride = pytest.importorskip(
    "robstride", reason="not in the group extra: pip install robstride==0.1.0"
)
pytestmark = pytest.mark.realtime
LOCAL_BUS_NAME = "robstride"
WAIT_TIMEOUT_S = 20.0


def test_robstride_package_sets_up_the_simulated_motor() -> None:
    with (
        run_simulated_drives(f"local:{LOCAL_BUS_NAME}", "robstride", "--ids", "5"),
        can.Bus(interface="local", channel=LOCAL_BUS_NAME) as bus,
    ):
        client = robstride.Client(bus, recv_timeout=WAIT_TIMEOUT_S)
        assert client.read_param(5, "run_mode") == robstride.RunMode.Operation
        assert client.read_param(5, "limit_torque") == 5.5
        client.write_param(5, "limit_torque", 0.25)
        assert client.read_param(5, "limit_torque") == 0.25
        client.write_param(5, "run_mode", robstride.RunMode.Speed)
        assert client.read_param(5, "run_mode") == robstride.RunMode.Speed
        client.write_param(5, "run_mode", robstride.RunMode.Operation)
        feedback = client.enable(5)
        assert (feedback.servo_id, feedback.errors) == (5, [])
        assert feedback.torque == pytest.approx(0.0, abs=0.01)
        assert feedback.angle == pytest.approx(client.read_param(5, "mechpos"), abs=0.01)
        assert client.read_param(5, "vbus") == pytest.approx(48.0)
        assert client.disable(5).errors == []
        assert client.error_rate() == 0.0
