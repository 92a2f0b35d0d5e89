"""Connect the motor clients of other projects to simulated drives on a local bus.

The tests in tests/vcan/inside run the same clients on SocketCAN.
"""

import subprocess
from collections.abc import Iterator

import can
import pytest

from tests.drives import foreign_clients
from tests.drives.bench_process import run_simulated_drives

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # damiao-motor's "bustype"
]
LOCAL_BUS_NAME = "clients"


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator["subprocess.Popen[str]"]:
    with run_simulated_drives(f"local:{LOCAL_BUS_NAME}", *request.param) as process:
        yield process


@pytest.mark.parametrize("bench", [["mit", "--ids", "1,2"]], indirect=True, ids=["mit"])
@pytest.mark.usefixtures("bench")
def test_damiao_motor_library_controls_the_simulated_motor() -> None:
    foreign_clients.use_damiao_motor("local", LOCAL_BUS_NAME)


@pytest.mark.parametrize("bench", [["odrive", "--ids", "0,1"]], indirect=True, ids=["odrive"])
@pytest.mark.usefixtures("bench")
def test_odrive_can_controls_the_simulated_drive() -> None:
    foreign_clients.use_odrive_can(can.Bus(interface="local", channel=LOCAL_BUS_NAME))


@pytest.mark.parametrize("bench", [["cia402", "--ids", "32,33"]], indirect=True, ids=["cia402"])
@pytest.mark.usefixtures("bench")
def test_canopen_library_reads_the_simulated_drive() -> None:
    foreign_clients.use_canopen("local", LOCAL_BUS_NAME)


@pytest.mark.parametrize("bench", [["mit", "--ids", "1,2"]], indirect=True, ids=["mit"])
@pytest.mark.usefixtures("bench")
def test_damiao_motor_in_its_other_modes() -> None:
    foreign_clients.use_damiao_modes("local", LOCAL_BUS_NAME)


@pytest.mark.parametrize("bench", [["odrive", "--ids", "0,1"]], indirect=True, ids=["odrive"])
@pytest.mark.usefixtures("bench")
def test_odrive_can_in_its_other_modes() -> None:
    foreign_clients.use_odrive_can_modes(can.Bus(interface="local", channel=LOCAL_BUS_NAME))


@pytest.mark.parametrize("bench", [["cia402", "--ids", "32,33"]], indirect=True, ids=["cia402"])
@pytest.mark.usefixtures("bench")
def test_canopen_in_its_other_modes() -> None:
    foreign_clients.use_canopen_modes("local", LOCAL_BUS_NAME)
