"""Provide logs for the viewer as fixtures, and check whether the present machine can draw pictures."""

import os
import sys
from pathlib import Path

import pytest

from handctl.errors import ConfigError
from handctl.view.rerun_conversion import write_rrd
from handctl.view.viewer import software_vulkan

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "log")]

os.environ.setdefault("RUST_LOG", "error")

LOG_DURATION_S = 3.0


@pytest.fixture(scope="session", params=["jamia", "jamia11"])
def log_path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the log of a generated run with a start date, and return its path.

    A test with this fixture runs once for each packaged hand.
    """
    import synthetic_run

    path = tmp_path_factory.mktemp("view") / f"{request.param}.mcap"
    synthetic_run.write_synthetic_run(
        path,
        synthetic_run.synthetic_header(request.param, 100, offset_ns=1_760_000_000_123_456_789),
        LOG_DURATION_S,
    )
    return path


@pytest.fixture(scope="session")
def jamia_log_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the log of a generated run of the hand jamia, and return its path."""
    import synthetic_run

    path = tmp_path_factory.mktemp("view") / "run.mcap"
    synthetic_run.write_synthetic_run(
        path, synthetic_run.synthetic_header(rate_hz=100), LOG_DURATION_S
    )
    return path


@pytest.fixture(scope="session")
def recording_path(log_path: Path) -> Path:
    """Convert the log `log_path` to a Rerun recording, and return the path of the recording."""
    from rrd_entities import run_info_of

    rrd_path = log_path.with_suffix(".rrd")
    write_rrd(log_path, run_info_of(log_path), rrd_path)
    return rrd_path


@pytest.fixture(scope="session")
def vulkan_environment() -> dict[str, str]:
    """Return the environment variables of a process that draws pictures.

    Without a Vulkan driver, skip the test. On a machine that must have a Vulkan driver, let the
    test fail.
    """
    try:
        return software_vulkan()
    except ConfigError as error:
        if os.environ.get("HANDCTL_REQUIRE_VULKAN") == "1":
            pytest.fail(str(error))
        pytest.skip(str(error))
