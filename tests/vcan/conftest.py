"""Run the tests in the folder inside/ in three guest systems that have real vcan interfaces.

Pytest reports each test of a guest system as if the test had run in the pytest process of the host.

A guest system (guest) is either a network namespace or a virtual machine of user-mode Linux. In the
guest, ``conftest.py`` writes each report of pytest to the file that HANDCTL_VCAN_REPORTS names. If
HANDCTL_REQUIRE_VCAN is 1, a skipped test counts as failed.
"""

import json
import os
import sys
import tempfile
from collections import defaultdict
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.vcan import uml_guest

GUEST_TESTS_FOLDER = Path(__file__).parent / "inside"
REPORTS_FILE = os.environ.get("HANDCTL_VCAN_REPORTS")
VCAN_IS_REQUIRED = os.environ.get("HANDCTL_REQUIRE_VCAN") == "1"
GUEST_TIMEOUT_S = 1500.0
TEST_FILES_BY_GUEST = (
    ("test_run.py", "test_drive.py", "test_bus_doctor.py"),
    ("test_protocols.py", "test_foreign_clients.py", "test_python_can.py"),
)
"""Test files that two of the guest systems run.

All other test files run in a third guest system. The three groups of test files take about the same
time. A guest system has one core and uses less than half of the core's time, because hands run in
slowed time.
"""
ReportsByTest = dict[str, list[pytest.TestReport]]
_reports_key = pytest.StashKey[ReportsByTest]()


def pytest_itemcollected(item: pytest.Item) -> None:
    item.add_marker("realtime")
    item.add_marker("alone")
    if item.path.is_relative_to(GUEST_TESTS_FOLDER):
        item.add_marker("vcan")
        if not REPORTS_FILE:
            item.add_marker(
                pytest.mark.timeout(0), append=False
            )  # the first test of a guest system waits until all tests of the guest have run


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if REPORTS_FILE:
        data = item.config.hook.pytest_report_to_serializable(config=item.config, report=report)
        with open(REPORTS_FILE, "a", encoding="utf-8") as file:
            file.write(json.dumps(data) + "\n")
        return report
    return _report_unless_required(report)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> bool | None:
    if REPORTS_FILE or not item.path.is_relative_to(GUEST_TESTS_FOLDER):
        return None
    if _reports_key not in item.session.stash:
        guest_items = [
            guest_item
            for guest_item in item.session.items
            if guest_item.path.is_relative_to(GUEST_TESTS_FOLDER)
        ]
        item.session.stash[_reports_key] = _run_in_guests(guest_items)
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for report in item.session.stash[_reports_key][item.nodeid]:
        item.ihook.pytest_runtest_logreport(report=_report_unless_required(report))
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _run_in_guests(items: Sequence[pytest.Item]) -> ReportsByTest:
    """Run each test in the guest system that is assigned to its test file, and return the reports of all tests."""
    kind, reason = uml_guest.vcan_access()
    if not kind:
        return {
            item.nodeid: [_make_report(item, "skipped", (str(item.path), 0, reason))]
            for item in items
        }
    parts_of: dict[int, list[pytest.Item]] = defaultdict(list)
    for item in items:
        group = next(
            (i for i, names in enumerate(TEST_FILES_BY_GUEST) if item.path.name in names),
            len(TEST_FILES_BY_GUEST),
        )
        parts_of[group].append(item)
    groups = list(parts_of.values())
    with ThreadPoolExecutor(len(groups)) as guests:
        reports_of_guests = list(guests.map(_run_in_guest, groups))
    return {
        nodeid: reports
        for reports_of_guest in reports_of_guests
        for nodeid, reports in reports_of_guest.items()
    }


def _run_in_guest(items: Sequence[pytest.Item]) -> ReportsByTest:
    """Run tests in one guest system, and return the reports of the tests. A test without a report counts as failed."""
    output: list[str] = []
    with tempfile.TemporaryDirectory(prefix="handctl-vcan-reports-") as folder:
        file = Path(folder) / "reports"
        status = uml_guest.run_with_vcan(
            _pytest_command(items),
            {"HANDCTL_VCAN_REPORTS": str(file)},
            GUEST_TIMEOUT_S,
            output.append,
        )
        lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    reports = _read_reports(lines, items[0].config)
    tail = "\n".join(
        [f"the guest ended with status {status} and without a word about this test", *output[-50:]]
    )
    for item in items:
        if not any(report.when == "teardown" for report in reports[item.nodeid]):
            reports[item.nodeid].append(_make_report(item, "failed", tail))
    return reports


def _pytest_command(items: Sequence[pytest.Item]) -> list[str]:
    ids = [str(item.config.rootpath / item.nodeid) for item in items]
    return [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--tb=short", *ids]


def _read_reports(lines: Sequence[str], config: pytest.Config) -> ReportsByTest:
    reports: ReportsByTest = defaultdict(list)
    for line in lines:
        report = config.hook.pytest_report_from_serializable(config=config, data=json.loads(line))
        if report.skipped and isinstance(report.longrepr, list):
            report.longrepr = tuple(
                report.longrepr
            )  # JSON has no tuples, but the summary of pytest needs tuples
        reports[report.nodeid].append(report)
    return reports


def _make_report(
    item: pytest.Item, outcome: str, reason: str | tuple[str, int, str]
) -> pytest.TestReport:
    data = {
        "nodeid": item.nodeid,
        "location": item.location,
        "outcome": outcome,
        "longrepr": reason,
    }
    return pytest.TestReport(**data, keywords={}, when="call", sections=[])  # type: ignore[arg-type]


def _report_unless_required(report: pytest.TestReport) -> pytest.TestReport:
    is_nightly_only = "HANDCTL_NIGHTLY" in str(report.longrepr)
    if (
        VCAN_IS_REQUIRED
        and report.skipped
        and not is_nightly_only
        and not hasattr(report, "wasxfail")
    ):
        report.outcome = "failed"
        report.longrepr = f"HANDCTL_REQUIRE_VCAN=1, but this test was skipped: {report.longrepr}"
    return report
