"""Test which files pytest imports in the stages of `make test` that run only the tests on the real clock.

A stage of `make test` with only tests on the real clock imports only the files that contain such
tests.
"""

import re
from pathlib import Path

import pytest

from tests import conftest

REPOSITORY = Path(__file__).parents[2]
TEST_WITH_HIDDEN_MARKER = """import pytest
CLOCK = getattr(pytest.mark, "realtime")
@CLOCK
def test_run() -> None:
    pass
"""


def test_the_stages_select_what_the_makefile_selects() -> None:
    marker_expressions = re.findall(
        r'-m "?([^"$]*?)"? \$\(PYTEST_FLAGS\)', (REPOSITORY / "Makefile").read_text()
    )
    assert {*conftest.REAL_CLOCK_MARKER_EXPRESSIONS} == {
        selection for selection in marker_expressions if not selection.startswith("not ")
    }


@pytest.mark.parametrize(
    ("text", "expected"), [("@pytest.mark.alone\n", True), ("x = 'realtime'\n", False)]
)
def test_files_are_distinguished_by_their_markers(
    tmp_path: Path, text: str, expected: bool
) -> None:
    path = tmp_path / "test_one.py"
    path.write_text(text)
    assert conftest.has_real_clock_tests(path) is expected


def test_all_files_that_the_guests_run_are_collected() -> None:
    assert all(
        conftest.has_real_clock_tests(path)
        for path in conftest.VCAN_TESTS_FOLDER.rglob("test_*.py")
    )


def test_a_test_on_the_real_clock_that_would_be_left_out_is_an_error(
    pytester: pytest.Pytester,
) -> None:
    pytester.makeconftest(
        "from tests.conftest import pytest_collection_modifyitems, pytest_ignore_collect"
    )
    pytester.makepyfile(test_one=TEST_WITH_HIDDEN_MARKER)
    result = pytester.runpytest_inprocess(
        "-p", "no:cacheprovider", "-o", "markers=realtime\nalone\nnightly"
    )
    assert "tests on the real clock, but none of" in result.stdout.str() + result.stderr.str()
    assert result.ret == pytest.ExitCode.USAGE_ERROR
