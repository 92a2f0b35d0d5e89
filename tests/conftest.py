"""What holds for all tests: the size of property runs, which tests wait for the night, and which are tried again."""

import os
import signal
import tempfile
import time

import pytest
from hypothesis import HealthCheck, settings

from tests.stalls import StallMeter

pytest_plugins = ("pytester",)
NIGHTLY = os.environ.get("HANDCTL_NIGHTLY") == "1"
CALM = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""No time limit for one example: the cores are shared, and time is not what these tests are about."""

settings.register_profile("every run", CALM, derandomize=True, database=None, max_examples=100)
settings.register_profile("nightly", CALM, max_examples=2000, print_blob=True)
settings.load_profile("nightly" if NIGHTLY else "every run")

SLOWER = 0.5
CALM_S, PATIENCE_S = 1.0, 15.0
LATEST_S = 900.0
"""For all tries of a test together; one of its own is nearer."""

signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
"""A shell's background job begins with SIGINT ignored, one of nohup with SIGHUP, and so would every program that these
tests start."""
if "HANDCTL_RUN_DIR" not in os.environ:
    RUN_DIR = tempfile.TemporaryDirectory(prefix="handctl-", ignore_cleanup_errors=True)
    """Buses and truths of these tests alone, whatever else runs on this machine; gone with this process."""
    os.environ["HANDCTL_RUN_DIR"] = RUN_DIR.name


class Repeats:
    """A test of the real clock gets another try if the machine stood still while it failed; three tries in all.

    Where a test slows time, each try slows it more (``slower``): a stall means less then, a defect just as much.

    Attributes:
        meter: from the first such test on.
        told: which tests were tried again, and how long the machine had stood still [s].
    """

    def __init__(self) -> None:
        self.told: list[tuple[str, float]] = []
        self.meter: StallMeter | None = None
        self._test, self._began = "", 0.0

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        if item.get_closest_marker("realtime"):
            self.meter = self.meter or StallMeter()
            self._test, self._began = item.nodeid, time.monotonic()

    def stood_still(self, error: BaseException | None) -> bool:
        """Whether the machine did so since the present try began; also asked of one that passed, without an error."""
        longest = self.meter.longest_since(self._began) if self.meter and error else 0.0
        if longest:
            self.told.append((self._test, longest))
            self.await_calm()
        return longest > 0.0

    def await_calm(self) -> None:
        """Wait until the machine has not stood still for a second, but not for long: stalls come in crowds."""
        assert self.meter
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            begin = time.monotonic()
            time.sleep(CALM_S)
            if not self.meter.longest_since(begin):
                return

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        for item in items:
            if item.get_closest_marker("realtime"):
                item.add_marker(pytest.mark.flaky(reruns=2, condition=self.stood_still))
                item.add_marker(pytest.mark.timeout(LATEST_S))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        for test, longest in self.told:
            terminalreporter.write_line(f"failed while the machine stood still for {longest * 1e3:.0f} ms: {test}")

    def pytest_unconfigure(self) -> None:
        if self.meter:
            self.meter.close()


@pytest.fixture
def slower(request: pytest.FixtureRequest) -> float:
    """What a test of the clock multiplies its time scale by: one in its first try, less in each that follows."""
    return float(SLOWER ** (getattr(request.node, "execution_count", 1) - 1))


def pytest_configure(config: pytest.Config) -> None:
    if "HANDCTL_VCAN_REPORTS" not in os.environ:  # in a guest of one core every process waits for the others
        config.pluginmanager.register(Repeats(), "repeats")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if NIGHTLY:
        return
    for item in items:
        if item.get_closest_marker("nightly"):
            item.add_marker(pytest.mark.skip(reason="runs with HANDCTL_NIGHTLY=1 (make nightly)"))
