"""Run motor clients of other projects with the simulated drives on real SocketCAN."""

import can
import pytest

from tests.drives import foreign_clients
from tests.drives.bench_process import run_simulated_drives

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
VCAN_BUS_SPEC = "socketcan:vcan0"


def test_damiao_motor_controls_the_simulated_motor() -> None:
    with run_simulated_drives(VCAN_BUS_SPEC, "mit", "--ids", "1,2"):
        foreign_clients.use_damiao_motor("socketcan", "vcan0")


def test_odrive_can_controls_the_simulated_drive() -> None:
    with run_simulated_drives(VCAN_BUS_SPEC, "odrive", "--ids", "0,1"):
        foreign_clients.use_odrive_can(can.Bus(interface="socketcan", channel="vcan0"))


def test_canopen_controls_the_simulated_drive() -> None:
    with run_simulated_drives(VCAN_BUS_SPEC, "cia402", "--ids", "32,33"):
        foreign_clients.use_canopen("socketcan", "vcan0")
