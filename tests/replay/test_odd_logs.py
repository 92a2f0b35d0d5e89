"""Test the re-execution of unusual logs.

An unusual log has gaps, contains values that handctl refuses, or comes from a run that ended early.
"""

import json
import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import short_runs

from handctl.cli.main import main
from handctl.core.plain_data import serialized_bytes
from handctl.core.tick_types import TickEvent, TickIn, TickOut
from handctl.drives.frame import EXTENDED_FLAG
from handctl.errors import LogError
from handctl.log.header import RunHeader
from handctl.log.read.reader import RunLog
from handctl.log.tick_packing import pack_tick_record
from handctl.log.tick_record import RECORD_FRAMING_STRUCT, SNAPSHOT_HEAD_STRUCT
from handctl.log.write.log_writer import LogWriter
from handctl.replay.limits_judgement import judge_by_limits
from handctl.replay.log_execution import execute_log
from handctl.replay.motion_replay import (
    active_interval,
    compare_replay,
    count_missing_ticks,
    followed_duration_s,
    playback_program,
    recorded_targets,
)
from handctl.replay.tick_difference import TelemetryColumns, are_outputs_equal, differing_fields

TickList = list[tuple[TickIn, TickOut]]
STOP_REQUEST = '{"do": "stop"}'


@pytest.fixture(scope="module")
def grasp_ticks(golden_folder: Path) -> tuple[RunHeader, TickList]:
    """Return the header and the ticks of the golden grasp."""
    ticks: TickList = []
    with RunLog(golden_folder / "jamia-grasp.mcap") as log:
        execute_log(log, observer=lambda entry, out: ticks.append((entry, out)))
        return log.header, ticks


def write_ticks(log_path: Path, run_header: RunHeader, ticks: TickList) -> Path:
    writer = LogWriter(log_path, run_header, lambda *arguments: None, 1)
    for entry, out in ticks:
        writer.add_tick(pack_tick_record(entry, out)[RECORD_FRAMING_STRUCT.size :])
    writer.finish("finished", 0)
    return log_path


def remove_tick_range(ticks: TickList, first_index: int, last_index: int) -> TickList:
    return [tick for tick in ticks if not first_index <= tick[0].k <= last_index]


def test_a_short_gap_is_bridged_without_a_jump(
    grasp_ticks: tuple[RunHeader, TickList], tmp_path: Path, golden_folder: Path
) -> None:
    header, ticks = grasp_ticks
    log_with_gap = write_ticks(tmp_path / "holey.mcap", header, remove_tick_range(ticks, 260, 268))
    with RunLog(golden_folder / "jamia-grasp.mcap") as log, RunLog(log_with_gap) as other_log:
        whole_recorded_targets, result = (
            recorded_targets(log, 0.005),
            recorded_targets(other_log, 0.005),
        )
        assert (count_missing_ticks(log), count_missing_ticks(other_log)) == (0, 9)
    assert result.q.shape == whole_recorded_targets.q.shape
    expected = ~np.isnan(whole_recorded_targets.q)
    assert (
        np.abs(result.ddq - whole_recorded_targets.ddq)[expected].max()
        < np.abs(whole_recorded_targets.ddq[expected]).max()
    )
    assert np.abs(result.q - whole_recorded_targets.q)[expected].max() < math.radians(0.5)


def test_a_long_gap_is_refused_with_its_times(
    grasp_ticks: tuple[RunHeader, TickList], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header, ticks = grasp_ticks
    path = write_ticks(tmp_path / "holey.mcap", header, remove_tick_range(ticks, 260, 300))
    with (
        RunLog(path) as log,
        pytest.raises(LogError, match=r"no ticks between 1\.295 and 1\.505 s"),
    ):
        playback_program(log, 0.005, replays_tensions=False)
    assert main(["replay", "drive", str(path), "--bus", "local:nobody", "--dry-run"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["replay", "execute", str(path)]) == 1
    assert "ticks 260 to 300 are missing in the log" in capsys.readouterr().out
    assert main(["log", "info", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["missing"] == 41


def test_a_cut_log_that_repeats_is_lossy(
    golden_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truncated_log = tmp_path / "cut.mcap"
    truncated_log.write_bytes((golden_folder / "jamia-grasp.mcap").read_bytes()[:100_000])
    assert main(["replay", "execute", str(truncated_log), "--within", "1e-9", "--json"]) == 3
    out, err = capsys.readouterr()
    assert json.loads(out)["warning"]
    assert err.count("\n") == 1


def test_a_stopped_replay_is_compared_up_to_its_end(golden_folder: Path, tmp_path: Path) -> None:
    rate = 250.0
    with RunLog(golden_folder / "jamia-grasp.mcap") as original_log:
        program, (start, end) = (
            playback_program(original_log, 1 / rate, replays_tensions=False),
            active_interval(original_log),
        )
        short_runs.record_lockstep_run(
            tmp_path / "late.mcap", program, rate_hz=rate, requests={1000: (STOP_REQUEST,)}
        )
        short_runs.record_lockstep_run(
            tmp_path / "early.mcap", program, rate_hz=rate, requests={400: (STOP_REQUEST,)}
        )
        with RunLog(tmp_path / "late.mcap") as replayed_log:
            started = next(
                change.t_ns * 1e-9 for change in replayed_log.phases if change.name == "playback"
            )
            assert followed_duration_s(original_log, replayed_log) == pytest.approx(
                1000 / rate - started, abs=2 / rate
            )
            assert 0.2 < followed_duration_s(original_log, replayed_log) < end - start - 0.5
            result = compare_replay(original_log, replayed_log)
        assert max(row["rms"] for row in result["tendon_N"].values()) < 1.0
        with RunLog(tmp_path / "early.mcap") as replayed_log:
            assert (
                followed_duration_s(original_log, replayed_log),
                compare_replay(original_log, replayed_log),
            ) == (0.0, {})


def with_event(added_event: TickEvent) -> Callable[[TickOut], TickOut]:
    return lambda out: out._replace(events=(added_event,))


def with_changed_frame(**frame_changes: int) -> Callable[[TickOut], TickOut]:
    return lambda out: out._replace(
        frames=(out.frames[0]._replace(**frame_changes), *out.frames[1:])
    )


@pytest.mark.parametrize(
    "edit_output",
    [
        with_event(TickEvent("warn", "phase", "", "hold")),
        with_event(TickEvent("info", "mode", "", "hold")),
        with_event(TickEvent("info", "phase", "thumb", "hold")),
        with_changed_frame(flags=4),
        with_changed_frame(can_id=EXTENDED_FLAG | 1),
        with_changed_frame(t_ns=5),
    ],
)
def test_every_difference_is_named(
    grasp_ticks: tuple[RunHeader, TickList],
    tmp_path: Path,
    edit_output: Callable[[TickOut], TickOut],
) -> None:
    header, ticks = grasp_ticks
    entry, out = next(tick for tick in ticks if tick[1].frames)
    base = out._replace(
        events=(TickEvent("info", "phase", "", "hold"),), frames=(out.frames[0]._replace(can_id=1),)
    )
    with RunLog(write_ticks(tmp_path / "one.mcap", header, [(entry, base)])) as log:
        logged_tick, numbers = next(log.ticks()), next(log.packed_telemetry())
    now = edit_output(base)
    assert are_outputs_equal(logged_tick, numbers, base)
    assert not are_outputs_equal(logged_tick, numbers, now)
    (result,) = differing_fields(TelemetryColumns.from_header(header), logged_tick, numbers, now)
    assert result.logged != result.computed


@pytest.mark.parametrize(("tick_count", "has_equal_hashes"), [(0, True), (3, True), (3, False)])
def test_a_short_log_of_another_version_has_no_snapshots(
    grasp_ticks: tuple[RunHeader, TickList],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    tick_count: int,
    has_equal_hashes: bool,
) -> None:
    """If the hash of the first state is equal, the states of the other version have the same fields."""
    header, ticks = grasp_ticks
    older_header = replace(header, metadata=header.metadata | {"code": "0123456789ab"})
    hashes = {} if has_equal_hashes else {"state_hash": bytes(8)}
    path = write_ticks(
        tmp_path / "short.mcap",
        older_header,
        [(entry, out._replace(**hashes)) for entry, out in ticks[:tick_count]],
    )
    assert main(["replay", "execute", str(path)]) == (0 if has_equal_hashes else 4)
    assert f"{tick_count} ticks, 0 differ" in capsys.readouterr().out


@pytest.mark.parametrize("edits_frame", [False, True])
def test_states_of_another_version_are_not_compared(
    grasp_ticks: tuple[RunHeader, TickList],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    edits_frame: bool,
) -> None:
    """If all other outputs are equal, the exit code is 4. If a frame differs, the exit code is 1."""
    header, ticks = grasp_ticks
    path = tmp_path / "older.mcap"
    metadata = header.metadata | {"version": "0.0.9", "code": "0123456789ab"}
    writer = LogWriter(path, replace(header, metadata=metadata), lambda *arguments: None, 1)
    for entry, out in ticks:
        older_output = out._replace(state_hash=bytes(8))
        if edits_frame and entry.k == 300:
            older_output = with_changed_frame(can_id=1)(older_output)
        record = pack_tick_record(entry, older_output)
        writer.add_tick(record[RECORD_FRAMING_STRUCT.size :])
        if entry.k % 100 == 99:
            head = SNAPSHOT_HEAD_STRUCT.pack(entry.k, entry.t_ns, len(b"another schema"))
            writer.add_snapshot(head + b"another schema" + serialized_bytes(()))
    writer.finish("finished", 0)
    command_words = ["replay", "execute", str(path)]
    assert main(command_words) == (1 if edits_frame else 4)
    output = capsys.readouterr().out
    assert "the states were not compared" in output
    assert "handctl 0.0.9, code 0123456789ab" in output
    assert ("frames[0]" in output) == edits_frame
    main([*command_words, "--json"])
    content = json.loads(capsys.readouterr().out)
    assert (content["same"], content["states_compared"]) == (False, False)
    assert content["differing"] == (1 if edits_frame else 0)
    # With a tolerance, the states are not judged, but a frame with another identifier is.
    assert main([*command_words, "--within", "1e-9"]) == (1 if edits_frame else 0)


def test_values_that_the_controller_refuses_are_refused_by_every_replay(
    grasp_ticks: tuple[RunHeader, TickList], tmp_path: Path
) -> None:
    header, ticks = grasp_ticks
    setup = json.loads(header.attachments["setup.json"])
    changed_setup = json.dumps(setup | {"zero_rad": [1e308] * 4}).encode()
    changed_header = replace(header, attachments=header.attachments | {"setup.json": changed_setup})
    path = write_ticks(tmp_path / "bad.mcap", changed_header, ticks)
    (tmp_path / "limits.toml").write_text("schema = 1\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for replay in (execute_log, lambda log: judge_by_limits(log, tmp_path / "limits.toml")):
            with (
                RunLog(path) as log,
                pytest.raises(LogError, match=r"the controller refuses|zero_rad 0"),
            ):
                replay(log)
