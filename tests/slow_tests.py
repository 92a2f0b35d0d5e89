"""Choose the slow tests by their measured processor time.

`make test` leaves out the slow tests. CI or the nightly run executes the slow tests.

    make test SLOW_S=inf PYTEST_FLAGS=--durations-file=times.jsonl           # writes the time of each test
    python -m tests.slow_tests times.jsonl                                    # writes tests/slow_tests.txt

    make unit HANDCTL_SLOW_S=0 PYTEST_FLAGS=--durations-file=times.jsonl    # only the tests of `make test`
    python -m tests.slow_tests times.jsonl --add                              # adds those that have become slow

A test run leaves out the listed tests whose cost is higher than ``HANDCTL_SLOW_S`` [s]. `make test`
sets ``HANDCTL_SLOW_S`` to 0 s. CI sets ``HANDCTL_SLOW_S`` to 3 s for tests in simulated time, and
to 0 s for tests that run in real time. `make nightly` and plain pytest run all listed tests. The
cost of a test is its processor time. For a test that runs in real time, the cost is its elapsed
time. A test run that leaves out tests still executes the first cases of each test function, until
the cost of these cases reaches a time budget. The budget is ``TEST_FUNCTION_BUDGET_S``, or
``REAL_CLOCK_BUDGET_S`` for tests that run in real time. An incomplete test run also executes the
cheapest test of each file, if this test costs no more than ``MAX_COST_OF_CHEAPEST_TEST_S``. Therefore a
test run that leaves out tests executes at least one test of nearly every file.
"""

import json
import re
import resource
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

SLOW_TESTS_FILE = Path(__file__).parent / "slow_tests.txt"
TEST_FUNCTION_BUDGET_S = 0.5
"""Largest total processor time of the cases of one test function in `make test` [s]."""
REAL_CLOCK_BUDGET_S = 3.0
"""Largest total elapsed time of the cases of one real-time test function in `make test` [s]."""
MIN_SLOW_TEST_COST_S = 0.05
"""Cost limit [s]. A test case that costs no more never counts as slow."""
MAX_COST_OF_CHEAPEST_TEST_S = 15.0
"""Largest cost of a file's cheapest test [s].

If the cheapest test of a file costs more, an incomplete test run leaves out the whole file.
"""


def tests_slower_than(limit_s: float) -> frozenset[str]:
    """Return the node identifiers of the listed tests that cost more than a limit [s]."""
    return frozenset(test for test, cost_s in read_slow_test_costs().items() if cost_s > limit_s)


def read_slow_test_costs() -> dict[str, float]:
    """Return the cost of each listed test [s], by its node identifier."""
    lines = SLOW_TESTS_FILE.read_text(encoding="utf-8").splitlines()
    rows = [line.partition(" ") for line in lines if not line.startswith("#")]
    return {test: float(cost_s) for cost_s, _, test in rows}


def processor_time() -> float:
    """Return the processor time of the present process and of its child processes [s].

    The returned time does not include child processes that still run.
    """
    resource_usages = [
        resource.getrusage(usage_kind)
        for usage_kind in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ]
    return sum(usage.ru_utime + usage.ru_stime for usage in resource_usages)


class DurationRecorder:
    """Plugin that appends the processor time and the elapsed time of each test to a file.

    Attributes:
        path: file with one line of JSON for each test: node identifier, processor time [s], elapsed
            time [s], and True for a test on the real clock.
    """

    def __init__(self, path: Path) -> None:
        """Open the file for appending. All processes of pytest-xdist write to the same file."""
        self.path = path
        self._elapsed_s: defaultdict[str, float] = defaultdict(float)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add the elapsed time of one stage of a test (set-up, call or tear-down).

        For a test in a virtual machine, use the time that the test took in the virtual machine.
        """
        self._elapsed_s[report.nodeid] += report.duration

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Measure the times of one test, including its fixtures, and write them to the file."""
        processor_time_before = processor_time()
        result = yield
        times = (processor_time() - processor_time_before, self._elapsed_s.pop(item.nodeid, 0.0))
        is_real_clock = (
            item.get_closest_marker("realtime") is not None
            or item.get_closest_marker("alone") is not None
        )
        row = [item.nodeid, *(round(time_s, 3) for time_s in times), is_real_clock]
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        return result


def choose_slow_tests(rows: list[tuple[str, float, float, bool]]) -> dict[str, float]:
    """Choose the slow tests, and return the cost of each slow test [s].

    Args:
        rows: for each test, its node identifier, processor time and elapsed time [s], and True for
            a test on the real clock, in the order of the run.
    """
    files: dict[str, list[tuple[float, str]]] = {}
    cost_by_function: dict[str, float] = {}
    cost_by_slow_test: dict[str, float] = {}
    for test, processor_time_s, elapsed_s, is_real_clock in rows:
        cost = elapsed_s if is_real_clock else processor_time_s
        function_name = re.sub(r"\[.*", "", test, flags=re.DOTALL)
        files.setdefault(test.partition("::")[0], []).append((cost, test))
        cost_by_function[function_name] = cost_by_function.get(function_name, 0.0) + cost
        if (
            cost_by_function[function_name]
            > (REAL_CLOCK_BUDGET_S if is_real_clock else TEST_FUNCTION_BUDGET_S)
            and cost > MIN_SLOW_TEST_COST_S
        ):
            cost_by_slow_test[test] = cost
    for tests in files.values():
        cost, cheapest = min(tests)
        if (
            all(test in cost_by_slow_test for _, test in tests)
            and cost <= MAX_COST_OF_CHEAPEST_TEST_S
        ):
            del cost_by_slow_test[cheapest]
    return cost_by_slow_test


def main(path: Path, keep_listed_tests: bool) -> None:
    """Write the list of slow tests from a file of durations.

    Args:
        path: file with the times of the tests of a run.
        keep_listed_tests: True to keep the tests that are already listed (option ``--add``). This is
            necessary if the test run has left out listed tests.
    """
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    cost_by_slow_test = choose_slow_tests(rows) | (
        read_slow_test_costs() if keep_listed_tests else {}
    )
    header_line = "# Written by `python -m tests.slow_tests`: seconds, test. `make test` leaves these to longer runs."
    lines = [
        header_line,
        *(f"{cost_by_slow_test[test]:.1f} {test}" for test in sorted(cost_by_slow_test)),
    ]
    SLOW_TESTS_FILE.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sample_processor_time_s = sum(
        processor_time_s
        for test, processor_time_s, _, is_real_clock in rows
        if test not in cost_by_slow_test and not is_real_clock
    )
    real_clock_s = sum(
        elapsed_s
        for test, _, elapsed_s, is_real_clock in rows
        if test not in cost_by_slow_test and is_real_clock
    )
    print(f"{len(cost_by_slow_test)} of {len(rows)} tests are slow")
    print(
        f"a sample takes {sample_processor_time_s:.0f} s of a core, and {real_clock_s:.0f} s on the real clock"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), keep_listed_tests="--add" in sys.argv[2:])
