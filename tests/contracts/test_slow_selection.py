"""Test which slow tests pytest leaves out of an incomplete test run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.slow_tests import (
    MAX_COST_OF_CHEAPEST_TEST_S,
    REAL_CLOCK_BUDGET_S,
    TEST_FUNCTION_BUDGET_S,
    choose_slow_tests,
    read_slow_test_costs,
)

REPOSITORY = Path(__file__).parents[2]


def test_a_function_keeps_its_first_cases_up_to_the_budget() -> None:
    rows = [(f"a.py::one[{i}]", 0.4 * TEST_FUNCTION_BUDGET_S, 0.0, False) for i in range(4)]
    assert set(choose_slow_tests(rows)) == {"a.py::one[2]", "a.py::one[3]"}


def test_a_file_keeps_its_cheapest_test_unless_it_takes_long() -> None:
    rows = [("a.py::one", 3.0, 0.0, False), ("a.py::two", 2.0, 0.0, False)]
    rows += [("b.py::one", 1.1 * MAX_COST_OF_CHEAPEST_TEST_S, 0.0, False)]
    assert set(choose_slow_tests(rows)) == {"a.py::one", "b.py::one"}


def test_each_listed_function_exists() -> None:
    """A renamed slow test would run in every `make test`, because the list of slow tests contains only its old name.

    Earlier defect: 36 lines of the list of slow tests named functions that had been renamed.
    """
    listed = {re.split(r"\[", test, maxsplit=1)[0] for test in read_slow_test_costs()}
    missing_tests = []
    for test in sorted(listed):
        file, *_, function = test.split("::")
        path = REPOSITORY / file
        if not path.exists() or f"def {function}(" not in path.read_text(encoding="utf-8"):
            missing_tests.append(test)
    assert missing_tests == []


def test_a_test_that_waits_long_is_slow() -> None:
    rows = [
        ("a.py::one", 0.0, 0.9 * REAL_CLOCK_BUDGET_S, True),
        ("a.py::two", 0.0, 1.1 * REAL_CLOCK_BUDGET_S, True),
    ]
    rows += [("a.py::three", 0.0, 9.0, False)]
    assert set(choose_slow_tests(rows)) == {"a.py::two"}


def test_parameters_with_brackets_and_lines_belong_to_one_function() -> None:
    rows = [(f"a.py::one[x[{i}]\n]", 0.6 * TEST_FUNCTION_BUDGET_S, 0.0, False) for i in range(2)]
    assert set(choose_slow_tests(rows)) == {"a.py::one[x[1]\n]"}


def test_only_a_sample_leaves_slow_tests_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Collect the tests of this file with pytest.

    The list of slow tests contains two tests of this file.
    """
    code = (
        "import sys, pathlib, pytest, tests.slow_tests; tests.slow_tests.SLOW_TESTS_FILE = pathlib.Path(sys.argv[1]); "
        + ("sys.exit(pytest.main(['--collect-only', '-q', '-p', 'no:cacheprovider', sys.argv[2]]))")
    )
    name = "tests/contracts/test_slow_selection.py::test_a_file_keeps_its_cheapest_test_unless_it_takes_long"
    long_test = "tests/contracts/test_slow_selection.py::test_a_test_that_waits_long_is_slow"
    (tmp_path / "slow.txt").write_text(f"# head\n2.0 {name}\n4.0 {long_test}\n")
    output_by_limit = {}
    for limit_s in ("0", "3", "inf"):
        monkeypatch.setenv("HANDCTL_SLOW_S", limit_s)
        monkeypatch.delenv("HANDCTL_NIGHTLY", raising=False)
        words = [sys.executable, "-c", code, str(tmp_path / "slow.txt"), __file__]
        output_by_limit[limit_s] = subprocess.run(
            words, capture_output=True, text=True, check=True, cwd=REPOSITORY
        ).stdout
    run = [(name in text, long_test in text) for text in output_by_limit.values()]
    assert run == [(False, False), (True, False), (True, True)]
    assert "test_a_function_keeps_its_first_cases_up_to_the_budget" in output_by_limit["0"]
