"""Chooses the tests that `make test` leaves to CI and to the night, from their measured processor time.

    make test SLOW_S=inf PYTEST_FLAGS=--durations-file=times.jsonl      # writes the time of each test
    python -m tests.slow times.jsonl                                    # writes tests/slow_tests.txt

A run leaves out the listed tests whose cost is above ``HANDCTL_SLOW_S``: `make test` sets 0, CI sets 3. `make nightly`
and a plain pytest run all of them. In a sample each test function keeps its first cases up to ``FUNCTION_S``, and each
file keeps at least its cheapest test, so that a sample still enters every file.
"""

import json
import re
import resource
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

SLOW_TESTS = Path(__file__).parent / "slow_tests.txt"
FUNCTION_S = 1.0
"""Processor time that the cases of one test function may take in `make test` [s]."""
CHEAP_S = 0.1
"""Processor time of a case that is never slow [s]."""
CLOCK_S = 12.0
"""Longest time of a test on the real clock in `make test` [s]. Such a test mostly waits."""


def slow_tests(limit_s: float) -> frozenset[str]:
    """Return the node identifiers of the listed tests that cost more than a limit [s]."""
    lines = SLOW_TESTS.read_text(encoding="utf-8").splitlines()
    rows = [line.partition(" ") for line in lines if not line.startswith("#")]
    return frozenset(test for cost_s, _, test in rows if float(cost_s) > limit_s)


def processor_time() -> float:
    """Return the processor time of this process and of its children that have ended [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


class Durations:
    """Plugin that appends the processor time and the elapsed time of each test to a file.

    Attributes:
        path: a line of JSON per test: node identifier, processor time [s], elapsed time [s].
    """

    def __init__(self, path: Path) -> None:
        """Append to a file, which processes of xdist share."""
        self.path = path

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Measure one test with its fixtures."""
        processor, elapsed = processor_time(), time.monotonic()
        result = yield
        row = [item.nodeid, round(processor_time() - processor, 3), round(time.monotonic() - elapsed, 3)]
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        return result


def choose(rows: list[tuple[str, float, float]]) -> dict[str, float]:
    """Choose the slow tests, and return the time of each [s].

    Args:
        rows: node identifier, processor time and elapsed time [s] of each test, in the order of the run.
    """
    files: dict[str, list[tuple[float, str]]] = {}
    spent: dict[str, float] = {}
    slow: dict[str, float] = {}
    for test, processor, elapsed in rows:
        cost = max(processor, elapsed * FUNCTION_S / CLOCK_S)
        function = re.sub(r"\[.*", "", test, flags=re.DOTALL)
        files.setdefault(test.partition("::")[0], []).append((cost, test))
        spent[function] = spent.get(function, 0.0) + cost
        if spent[function] > FUNCTION_S and cost > CHEAP_S:
            slow[test] = cost
    for tests in files.values():
        if all(test in slow for _, test in tests):
            del slow[min(tests)[1]]
    return slow


def main(path: Path) -> None:
    """Write the list from a file of durations."""
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    slow = choose(rows)
    head = "# Written by `python -m tests.slow`: seconds, test. `make test` leaves these to longer runs."
    lines = [head, *(f"{slow[test]:.1f} {test}" for test in sorted(slow))]
    SLOW_TESTS.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sample_s = sum(processor for test, processor, _ in rows if test not in slow)
    print(f"{len(slow)} of {len(rows)} tests are slow; the sample takes {sample_s:.0f} s of a core")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
