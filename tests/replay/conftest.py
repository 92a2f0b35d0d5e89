"""Provide fixtures: the golden logs, and the log of a newly recorded run with faults."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
GOLDEN_FOLDER = Path(__file__).parents[2] / "logs" / "golden"


@pytest.fixture(scope="session")
def golden_folder() -> Path:
    """Return the folder of the golden logs."""
    return GOLDEN_FOLDER


@pytest.fixture(scope="session")
def recorded_grasp_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a grasp on the present machine, and return the path of the log.

    The run contains a fault, a bus event and requests.
    """
    import short_runs

    from handctl.core.tick_types import IoEvent

    folder = tmp_path_factory.mktemp("fresh")
    io_events = {300: (IoEvent("enobufs", "main", 2),)}
    requests = {250: ('{"do": "arm"}', "no request"), 450: ('{"do": "stop"}',)}
    log = folder / "fresh.mcap"
    task, wrap_simulator_function = (
        short_runs.short_task(folder),
        short_runs.drop_index_motor_replies,
    )
    short_runs.record_lockstep_run(
        log,
        task,
        rate_hz=200.0,
        wrap_simulator=wrap_simulator_function,
        io_events=io_events,
        requests=requests,
    )
    return log
