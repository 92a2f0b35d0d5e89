"""Run the tests of the bus contract on real SocketCAN interfaces."""

from collections.abc import Iterator

import pytest

from tests.runtime.bus_contract import *  # noqa: F403 - the tests
from tests.runtime.bus_contract import BusUnderTest


@pytest.fixture
def bus_under_test() -> Iterator[BusUnderTest]:
    bus = BusUnderTest("socketcan:vcan0")
    yield bus
    bus.close()
