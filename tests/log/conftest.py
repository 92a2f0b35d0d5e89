"""Provide short logs as fixtures for the tests of the folder ``tests/log``."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def small_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a complete log with about twelve MCAP chunks, and return its path."""
    import synthetic_run

    path = tmp_path_factory.mktemp("log") / "small.mcap"
    synthetic_run.write_synthetic_run(path, synthetic_run.synthetic_header(rate_hz=10), 2.5)
    return path


@pytest.fixture(scope="session")
def run_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a log of two seconds at 500 Hz, and return its path."""
    import synthetic_run

    path = tmp_path_factory.mktemp("log") / "run.mcap"
    synthetic_run.write_synthetic_run(path, synthetic_run.synthetic_header(rate_hz=500), 2.0)
    return path
