"""Test the check of a recorded run against safety limits that differ from those of the run."""

from pathlib import Path

import pytest

from handctl.errors import ConfigError
from handctl.log.read.reader import RunLog
from handctl.replay.limits_judgement import judge_by_limits


def write_limits(limits_folder: Path, limits_text: str) -> Path:
    path = limits_folder / "limits.toml"
    path.write_text("schema = 1\n" + limits_text)
    return path


def test_the_original_limits_find_the_faults_of_the_run(
    golden_folder: Path, tmp_path: Path
) -> None:
    with RunLog(golden_folder / "jamia-fault.mcap") as log:
        judgement = judge_by_limits(log, write_limits(tmp_path, ""))
        assert judgement.ticks == len(log)
    assert judgement.stopped_tick_count == judgement.ticks_stopped_by_old_limits > 0
    assert [(stop.fault, stop.instance) for stop in judgement.stopping_faults][:2] == [
        ("B17", "index_motor"),
        ("B02", "index_motor"),
    ]
    assert all(stop.occurs_in_logged_run for stop in judgement.stopping_faults)


def test_a_lower_tension_limit_stops_at_the_first_reading_above_the_limit(
    golden_folder: Path, tmp_path: Path
) -> None:
    with RunLog(golden_folder / "jamia-grasp.mcap") as log:
        judgement = judge_by_limits(
            log, write_limits(tmp_path, "tension_trip_N = { thumb_tendon = 20 }")
        )
        raw = log.field("tension_raw")[:, log.header.tendons.index("thumb_tendon")]
        first_tick_above_limit = int(log.k[raw > 20.0][0])
        tick_count_after_stop = int((log.k >= first_tick_above_limit).sum())
    assert judgement.stopping_faults[0][:1] == (first_tick_above_limit,)
    assert {
        (stop.fault, stop.instance, stop.occurs_in_logged_run) for stop in judgement.stopping_faults
    } == {("T03", "thumb_tendon", False)}
    assert judgement.stopping_faults[0].value > 20.0
    assert (judgement.stopped_tick_count, judgement.ticks_stopped_by_old_limits) == (
        tick_count_after_stop,
        0,
    ), "the stop is latched until the operator clears it"


def test_wider_limits_would_not_have_stopped_the_run(golden_folder: Path, tmp_path: Path) -> None:
    with RunLog(golden_folder / "jamia-fault.mcap") as log:
        judgement = judge_by_limits(log, write_limits(tmp_path, "silent_ms = 10000"))
    assert {stop.fault for stop in judgement.stopping_faults} <= {"B03a", "B03b"}, (
        "only the number of losses stops the run"
    )
    assert judgement.stopped_tick_count < judgement.ticks_stopped_by_old_limits


def test_an_unknown_tendon_is_refused(golden_folder: Path, tmp_path: Path) -> None:
    with (
        RunLog(golden_folder / "jamia-fault.mcap") as log,
        pytest.raises(ConfigError, match="pinky"),
    ):
        judge_by_limits(log, write_limits(tmp_path, "tension_trip_N = { pinky = 20 }"))
