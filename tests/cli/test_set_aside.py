"""The demo repeated in slower time: logs of a failed attempt are renamed, logs of earlier runs stay."""

import pytest

from handctl.cli.runs import demo
from handctl.session.plan import commission_log

FIRST, SECOND = "run.commission.mcap", "run.commission-2.mcap"


@pytest.mark.parametrize("left_behind", [(), (FIRST,), (FIRST, SECOND)])
def test_only_the_late_attempt_is_renamed(tmp_path, left_behind):
    for name in left_behind:
        (tmp_path / name).write_text("of an earlier run")
    log = tmp_path / "run.mcap"
    commissioning = commission_log(log)
    commissioning.write_text("late")
    log.write_text("late")
    demo._rename_late_logs(log, commissioning, 1.0)
    assert not log.exists()
    assert commission_log(log) == commissioning
    assert {p.name for p in tmp_path.iterdir()} == {*left_behind, "run-at-1.mcap", "run-at-1.commission.mcap"}
    assert (tmp_path / "run-at-1.commission.mcap").read_text() == "late"


def test_no_log_is_replaced(tmp_path):
    (tmp_path / "run-at-0.5.commission.mcap").write_text("of an earlier run")
    late = tmp_path / "run.commission.mcap"
    late.write_text("late")
    demo._rename_late_logs(tmp_path / "run.mcap", late, 0.5)
    assert (tmp_path / "run-at-0.5.commission.mcap").read_text() == "of an earlier run"
    assert (tmp_path / "run-at-0.5-2.commission.mcap").read_text() == "late"
