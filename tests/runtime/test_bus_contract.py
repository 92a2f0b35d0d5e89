"""Run the tests of the bus contract on all buses that need no hardware. tests/vcan runs the same tests on SocketCAN."""

import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

from handctl.errors import BusError, ConfigError
from handctl.runtime.buses.bus_opening import open_bus
from tests.runtime.bus_contract import *  # noqa: F403 - the tests
from tests.runtime.bus_contract import BusUnderTest
from tests.runtime.bus_hub import RUN_DIR_VARIABLE, hub_process


@pytest.fixture(scope="module")
def hub_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("run")
    with hub_process("contract", folder):
        yield folder


@pytest.fixture(params=["local", "virtual"])
def bus_under_test(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[BusUnderTest]:
    if request.param == "local":
        monkeypatch.setenv(RUN_DIR_VARIABLE, str(request.getfixturevalue("hub_folder")))
        bus = BusUnderTest("local:contract")
    else:
        bus = BusUnderTest(f"virtual:{uuid.uuid4()}")
    yield bus
    bus.close()


@pytest.mark.parametrize(
    ("bus_text", "expected_message"),
    [
        ("nonsense", "local:NAME"),
        ("local:", "local:NAME"),
        ("local:nobody", "type: handctl sim --bus local:nobody"),
        ("socketcan:nowhere9", "type: sudo ip link|modprobe can-raw"),
        ("nosuchinterface:0", "an interface of python-can"),
        ("slcan:/dev/no-such-port@115200", "an interface of python-can"),
    ],
)
def test_a_bus_that_cannot_be_opened_is_one_line_with_the_command_to_type(
    bus_text: str, expected_message: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(RUN_DIR_VARIABLE, str(tmp_path))
    with pytest.raises((BusError, ConfigError), match=expected_message) as caught:
        open_bus(bus_text, 0, 1_000_000)
    assert "\n" not in str(caught.value)
    assert bus_text in str(caught.value)
