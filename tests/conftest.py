"""What holds for all tests: the size of property runs, and which tests wait for the night."""

import os
import signal
import tempfile

import pytest
from hypothesis import HealthCheck, settings

NIGHTLY = os.environ.get("HANDCTL_NIGHTLY") == "1"
CALM = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""No time limit for one example: the cores are shared, and time is not what these tests are about."""

settings.register_profile("every run", CALM, derandomize=True, database=None, max_examples=100)
settings.register_profile("nightly", CALM, max_examples=2000, print_blob=True)
settings.load_profile("nightly" if NIGHTLY else "every run")

signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
"""A shell's background job begins with SIGINT ignored, one of nohup with SIGHUP, and so would every program that these
tests start."""
if "HANDCTL_RUN_DIR" not in os.environ:
    RUN_DIR = tempfile.TemporaryDirectory(prefix="handctl-", ignore_cleanup_errors=True)
    """Buses and truths of these tests alone, whatever else runs on this machine; gone with this process."""
    os.environ["HANDCTL_RUN_DIR"] = RUN_DIR.name


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if NIGHTLY:
        return
    for item in items:
        if item.get_closest_marker("nightly"):
            item.add_marker(pytest.mark.skip(reason="runs with HANDCTL_NIGHTLY=1 (make nightly)"))
