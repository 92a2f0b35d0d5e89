"""Settings of all tests: property tests, nightly tests, and the repetition of tests that run in real time."""

import os
import signal
import tempfile
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from handctl.blas_kernels import configure_openblas
from tests.computer_pause_meter import ComputerPauseMeter
from tests.slow_tests import DurationRecorder, tests_slower_than

pytest_plugins = ("pytester",)
NIGHTLY = os.environ.get("HANDCTL_NIGHTLY") == "1"
SLOW_TEST_S = float("inf") if NIGHTLY else float(os.environ.get("HANDCTL_SLOW_S", "inf"))
"""Longest duration of a test in an incomplete test run [s]. tests/slow_tests.txt has the durations."""
PROPERTY_TEST_SETTINGS = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""Settings of property tests, which have no time limit per example.

Property tests check results and not durations. Other processes that share the processor cores can
delay an example.
"""

settings.register_profile(
    "every run", PROPERTY_TEST_SETTINGS, derandomize=True, database=None, max_examples=40
)
settings.register_profile("nightly", PROPERTY_TEST_SETTINGS, max_examples=2000, print_blob=True)
settings.load_profile("nightly" if NIGHTLY else "every run")

TIME_SCALE_PER_REPEAT = 0.5
"""Factor by which each repetition of a test reduces its time scale."""
STALL_FREE_TIME_S = 1.0
"""Time that must pass without a stall of the machine before a test is repeated [s]."""
MAX_STALL_WAIT_S = 15.0
"""Longest wait for a time without a stall of the machine before a test is repeated [s]."""
REAL_CLOCK_TIMEOUT_S = 900.0
"""Time limit for a test that runs in real time, including the repetitions of the test [s].

A test can set a shorter time limit.
"""

# With these BLAS kernels, the golden logs repeat to the bit on every x86 processor. numpy reads the
# choice of the kernels when it is imported, so no earlier import of conftest.py is allowed to
# import numpy.
configure_openblas()
# A shell starts its background jobs with SIGINT ignored, and nohup ignores SIGHUP. Restore both
# signals, so that the programs that the tests start do not ignore them.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
# Without stored byte code, each program that the tests start compiles 300 modules. The compilation
# takes half of the start-up time of a program without byte code.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
    BYTE_CODE_FOLDER = tempfile.TemporaryDirectory(
        prefix="handctl-byte-code-", ignore_cleanup_errors=True
    )
    """Folder for the byte code of the programs that tests start.

    At the end of the pytest process, the folder is removed.
    """
    os.environ["PYTHONPYCACHEPREFIX"] = BYTE_CODE_FOLDER.name
if "HANDCTL_RUN_DIR" not in os.environ:
    RUN_DIR = tempfile.TemporaryDirectory(prefix="handctl-", ignore_cleanup_errors=True)
    """Folder for the sockets of buses and the truth files of tests.

    At the end of the pytest process, the folder is removed.
    """
    os.environ["HANDCTL_RUN_DIR"] = RUN_DIR.name


REAL_CLOCK_MARKER_EXPRESSIONS = ("alone", "realtime and not alone")
"""Test selections of `make realtime`. The selections contain only tests that run in real time."""
REAL_CLOCK_MARKERS = ("mark.realtime", "mark.alone")
"""Markers of tests that run in real time.

Every file with tests in real time contains ``mark.realtime`` or ``mark.alone``. The folder
tests/vcan is an exception, because its conftest.py marks all tests.
"""
VCAN_TESTS_FOLDER = Path(__file__).parent / "vcan"


def has_real_clock_tests(path: Path) -> bool:
    """Return True if a file of tests uses a marker for real time, or is in the folder for virtual CAN buses (vcan)."""
    text = path.read_text(encoding="utf-8")
    return path.is_relative_to(VCAN_TESTS_FOLDER) or any(
        mark in text for mark in REAL_CLOCK_MARKERS
    )


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """If only tests in real time are selected, leave out every file without a test in real time.

    To import all test files would take 15 s.
    """
    if config.getoption(
        "markexpr"
    ) not in REAL_CLOCK_MARKER_EXPRESSIONS or not collection_path.match("test_*.py"):
        return None
    return None if has_real_clock_tests(collection_path) else True


class RepeatAfterStallPlugin:
    """Plugin that repeats a test if it runs in real time and has failed.

    The plugin repeats a test only if the machine stalled during the test. A test has at most three
    tries.

    In some tests, simulated time runs slower than real time. In each repetition of a test with slow
    simulated time, the fixture ``time_scale_of_attempt`` slows the simulated time down further. The
    slower simulated time runs, the less effect a stall of the machine has. A defect in the code has
    the same effect at any speed of simulated time.

    Attributes:
        stalls: name of each repeated test, with the longest stall of the machine during the test
            [s].
        pause_meter: stall meter, which starts before the first test that runs in real time.
    """

    def __init__(self) -> None:
        """Create the plugin without a stall meter, because most test runs contain no test in real time."""
        self.stalls: list[tuple[str, float]] = []
        self.pause_meter: ComputerPauseMeter | None = None
        self._test = ""
        self._start = 0.0

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        """Store the time at which a try of a test started."""
        if item.get_closest_marker("realtime"):
            self.pause_meter = self.pause_meter or ComputerPauseMeter()
            self._test = item.nodeid
            self._start = time.monotonic()

    def is_failure_by_stall(self, error: BaseException | None) -> bool:
        """Return True if the present try of a test failed and the machine stalled during the try.

        ``error`` is None if the try passed.
        """
        longest_stall_s = (
            self.pause_meter.longest_stall_since(self._start) if self.pause_meter and error else 0.0
        )
        if longest_stall_s:
            self.stalls.append((self._test, longest_stall_s))
            self.wait_without_stall()
        return longest_stall_s > 0.0

    def wait_without_stall(self) -> None:
        """Wait until the machine has run for ``STALL_FREE_TIME_S`` without a stall.

        The wait ends after ``MAX_STALL_WAIT_S`` at the latest. After a stall of the machine, other
        stalls often follow.
        """
        assert self.pause_meter
        deadline_s = time.monotonic() + MAX_STALL_WAIT_S
        while time.monotonic() < deadline_s:
            sleep_start_s = time.monotonic()
            time.sleep(STALL_FREE_TIME_S)
            if not self.pause_meter.longest_stall_since(sleep_start_s):
                return

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Mark the tests that run in real time as tests that can be repeated."""
        for item in items:
            if item.get_closest_marker("realtime"):
                item.add_marker(pytest.mark.flaky(reruns=2, condition=self.is_failure_by_stall))
                item.add_marker(pytest.mark.timeout(REAL_CLOCK_TIMEOUT_S))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Report each repeated test, and the longest time for which the machine stood still during the test."""
        for test, longest_stall_s in self.stalls:
            terminalreporter.write_line(
                f"failed while the machine stalled for {longest_stall_s * 1e3:.0f} ms: {test}"
            )

    def pytest_unconfigure(self) -> None:
        """Close the stall meter."""
        if self.pause_meter:
            self.pause_meter.close()


@pytest.fixture
def time_scale_of_attempt(request: pytest.FixtureRequest) -> float:
    """Return the factor of a test's time scale: 1 in the first try, and a smaller factor in each repetition."""
    return float(TIME_SCALE_PER_REPEAT ** (getattr(request.node, "execution_count", 1) - 1))


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that stores the processor time of each test in a file."""
    parser.addoption(
        "--durations-file", type=Path, help="append the processor time of each test to this file"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Check the types of all arguments of kernels, and register the plugin that repeats tests.

    The compiled code of a kernel does not check types, so the tests call every kernel through its
    dispatcher. The programs that the tests start call the compiled code, like the programs of a
    user.

    The plugin is not registered in the virtual machine that tests virtual CAN buses (vcan). The
    virtual machine has only one processor core, so its processes delay each other in every test.
    """
    # Imported here, because this module imports numpy, and ``configure_openblas`` must come before.
    from handctl.compiled import KernelCalls

    KernelCalls.check_types = True
    if "HANDCTL_VCAN_REPORTS" not in os.environ:
        config.pluginmanager.register(RepeatAfterStallPlugin(), "repeats")
    if path := config.getoption("--durations-file"):
        config.pluginmanager.register(DurationRecorder(path), "durations_file")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip the nightly tests unless the present test run is a nightly test run.

    If the environment variable ``HANDCTL_SLOW_S`` is set, also leave out the slow tests.
    """
    if not NIGHTLY:
        for item in items:
            if item.get_closest_marker("nightly"):
                item.add_marker(
                    pytest.mark.skip(reason="runs with HANDCTL_NIGHTLY=1 (make nightly)")
                )
    for path in {item.path for item in items if item.get_closest_marker("realtime")}:
        if not has_real_clock_tests(path):
            raise pytest.UsageError(
                f"{path}: tests on the real clock, but none of {REAL_CLOCK_MARKERS} in the source"
            )
    slow_tests = tests_slower_than(SLOW_TEST_S)
    if left_out := [item for item in items if item.nodeid in slow_tests]:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item.nodeid not in slow_tests]
