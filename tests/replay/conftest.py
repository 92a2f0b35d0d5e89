"""Lets the tests import the maker of short runs next to them."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
GOLDEN = Path(__file__).parents[2] / "logs" / "golden"


@pytest.fixture(scope="session")
def golden() -> Path:
    """Folder of the golden logs."""
    return GOLDEN


@pytest.fixture(scope="session")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A grasp with a fault, an event of the bus and requests, made on this machine."""
    import runs

    from handctl.core.types import IoEvent

    folder = tmp_path_factory.mktemp("fresh")
    told = {300: (IoEvent("enobufs", "main", 2),)}
    asked = {250: ('{"do": "arm"}', "no request"), 450: ('{"do": "stop"}',)}
    log = folder / "fresh.mcap"
    runs.run(log, runs.short_task(folder), rate_hz=200.0, spoil=runs.deaf_index, told=told, asked=asked)
    return log
