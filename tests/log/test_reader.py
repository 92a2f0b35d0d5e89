"""The reader returns exactly the values that were recorded in a log.

For a damaged log, the reader raises a LogError, after a short time and with little memory.
"""

import contextlib
import itertools
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import synthetic_run
import varied_run
from hostile_logs import hostile_files
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from handctl.core.tick_types import TELEMETRY_AXES, TELEMETRY_FIELDS
from handctl.errors import LogError
from handctl.log.read.logfile import LogErrorContext
from handctl.log.read.reader import RunLog
from handctl.log.tick_packing import pack_tick_record
from handctl.log.tick_record import TickRecord
from handctl.log.write.recorder import Recorder
from handctl.printing import printable_text


@pytest.fixture(scope="module")
def varied_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lively") / "run.mcap"
    run = varied_run.varied_header(deterministic=False)
    recorder = Recorder.start(path, run)
    for tick in varied_run.varied_ticks(run):
        assert recorder.send_record(pack_tick_record(*tick))
        time.sleep(0.003)
    recorder.close("finished")
    return path


def test_ticks_come_back_exactly(varied_log: Path) -> None:
    with RunLog(varied_log) as log:
        ticks = list(log.ticks())
    for (tick_in, out), tick in zip(
        varied_run.varied_ticks(varied_run.varied_header()), ticks, strict=True
    ):
        expected = TickRecord(
            tick_in, out.frames, out.mode, out.phase, out.action, out.events, out.state_hash
        )
        assert tick == expected


def test_chunks_are_kept_up_to_a_limit(varied_log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with RunLog(varied_log) as log:
        expected_ticks = list(log.ticks())
        assert len(log._kept_chunks) == len(log.scan.chunks) > 3
    largest_size = max(size for size, _ in log._kept_chunks.values())
    limit = 2 * largest_size
    monkeypatch.setattr("handctl.log.read.reader._CACHE_BYTES", limit)
    with RunLog(varied_log) as log:
        for _ in range(2):
            for tick, expected_tick in zip(log.ticks(), expected_ticks, strict=True):
                assert tick == expected_tick
                sizes = [size for size, _ in log._kept_chunks.values()]
                assert sum(sizes) == log._kept_bytes <= limit


@pytest.mark.parametrize("uses_cache", [True, False])
def test_every_field_comes_back_bit_for_bit(
    varied_log: Path, uses_cache: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not uses_cache:
        monkeypatch.setattr("handctl.log.read.reader._CACHE_BYTES", 0)
    recorded_telemetry = [
        out.telemetry for _, out in varied_run.varied_ticks(varied_run.varied_header())
    ]
    with RunLog(varied_log) as log:
        for name in TELEMETRY_FIELDS:
            expected = np.array([getattr(telemetry, name) for telemetry in recorded_telemetry])
            assert log.field(name).tobytes() == expected.tobytes(), name
            assert log.field(name).shape == (len(log), len(log.names(name)))


def test_a_log_without_the_latest_fields_is_read(
    varied_log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fields can be missing in a log of an older version.

    For example, logs of version 0.1 do not have q_sigma.

    All values of a missing field are NaN.
    """
    recorded_telemetry = [
        out.telemetry for _, out in varied_run.varied_ticks(varied_run.varied_header())
    ]
    monkeypatch.setitem(TELEMETRY_AXES, "coming", "joint")
    for module in ("tick_batch", "read.reader"):
        monkeypatch.setattr(f"handctl.log.{module}.TELEMETRY_FIELDS", (*TELEMETRY_FIELDS, "coming"))
    monkeypatch.setattr(
        "handctl.log.tick_batch.ORIGINAL_TELEMETRY_FIELD_COUNT", len(TELEMETRY_FIELDS)
    )
    with RunLog(varied_log) as log:
        assert log.fields == TELEMETRY_FIELDS
        assert np.isnan(log.field("coming")).all()
        assert log.field("coming").shape == (len(log), len(log.header.joints))
        expected = np.array([telemetry.q_sigma for telemetry in recorded_telemetry])
        assert log.field("q_sigma").tobytes() == expected.tobytes()


def test_reader_returns_times_gaps_events_and_phases_as_written(varied_log: Path) -> None:
    ticks = list(varied_run.varied_ticks(varied_run.varied_header()))
    with RunLog(varied_log) as log:
        assert log.k.tolist() == [tick_in.k for tick_in, _ in ticks]
        assert log.late_ns.tolist() == [tick_in.late_ns for tick_in, _ in ticks]
        np.testing.assert_allclose(log.times, [tick_in.t_ns / 1e9 for tick_in, _ in ticks])
        assert log.mode.tolist() == [out.mode for _, out in ticks]
        assert log.action.tolist() == [out.action for _, out in ticks]
        expected = [(tick_in.k, event) for tick_in, out in ticks for event in out.events]
        assert [(event.k, event.event) for event in log.events] == expected
        assert [phase.name for phase in log.phases] == ["idle", "close", "h\u00e4lt", ""]
        ticks_before_gaps = [a.k for (a, _), (b, _) in itertools.pairwise(ticks) if b.k - a.k > 1]
        assert [gap.last_tick_before for gap in log.gaps] == ticks_before_gaps
        assert len(ticks_before_gaps) == 7
        assert int(log.end["missed"]) == 21


def test_the_header_comes_back(varied_log: Path) -> None:
    run = varied_run.varied_header(deterministic=False)
    with RunLog(varied_log) as log:
        for name in (
            "hand_toml",
            "joints",
            "tendons",
            "motors",
            "digits",
            "buses",
            "period_ns",
            "offset_ns",
            "gains",
        ):
            assert getattr(log.header, name) == getattr(run, name), name
        assert log.header.metadata == run.metadata
        assert log.header.attachments.items() >= run.attachments.items()
        assert not log.warning


def test_the_error_of_an_unknown_field_lists_all_fields(small_log: Path) -> None:
    with RunLog(small_log) as log, pytest.raises(LogError, match="tension_sigma"):
        log.field("tenshun\x1b[2J")


def _log_content(path: Path) -> tuple[bytes, bytes]:
    with RunLog(path) as log:
        ticks = repr([*log.ticks(), log.header, log.metadata, log.events, log.phases, log.gaps])
        return ticks.encode("utf-8", "surrogatepass"), b"".join(
            log.field(name).tobytes() for name in TELEMETRY_FIELDS
        )


@pytest.mark.parametrize("seed", range(4))
def test_a_changed_bit_is_detected_or_harmless(small_log: Path, tmp_path: Path, seed: int) -> None:
    raw, expected = small_log.read_bytes(), _log_content(small_log)
    random = np.random.default_rng(seed)
    errors: list[str] = []
    damaged_log = tmp_path / "bad.mcap"
    for _ in range(60):
        data = bytearray(raw)
        data[random.integers(len(data))] ^= 1 << random.integers(8)
        damaged_log.write_bytes(data)
        start = time.process_time()
        try:
            assert _log_content(damaged_log) == expected
        except LogError as error:
            errors.append(str(error))
        assert time.process_time() - start < 1.0
    assert len(errors) > 40
    assert all("bad.mcap, byte " in error_text for error_text in errors)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_changed_file_without_an_end_never_does_worse_than_log_error(
    small_log: Path, tmp_path: Path, data: st.DataObject
) -> None:
    log_bytes = bytearray(small_log.read_bytes())
    del log_bytes[data.draw(st.integers(9, len(log_bytes))) :]
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(log_bytes) - 1))
        log_bytes[at : at + 8] = data.draw(
            st.sampled_from([b"\xff", b"\0" * 8, b"\xff" * 8, b"\x7f" * 4, b"\x06"])
        )
    damaged_log = tmp_path / "bad.mcap"
    damaged_log.write_bytes(log_bytes)
    with contextlib.suppress(LogError):
        _log_content(damaged_log)


_PROBE_PROGRAM = """
import resource, sys, time
from pathlib import Path
from handctl.errors import LogError
from handctl.log.read.reader import RunLog
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
begin = time.process_time()
try:
    with RunLog(Path(sys.argv[1])) as log:
        list(log.ticks()), log.field("q"), log.events
    print("accepted")
except LogError as error:
    print("refused", error)
print(time.process_time() - begin)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def test_hostile_files_end_in_one_error_soon_and_in_little_memory(
    small_log: Path, tmp_path: Path
) -> None:
    hostile_log = tmp_path / "bad\x1b[2J.mcap"
    for name, data in hostile_files(small_log).items():
        hostile_log.write_bytes(data)
        done = subprocess.run(
            [sys.executable, "-c", _PROBE_PROGRAM, hostile_log],
            capture_output=True,
            text=True,
            check=True,
        )
        verdict, seconds, kibibytes = done.stdout.splitlines()
        assert verdict.startswith("refused"), name
        assert "\x1b" not in verdict
        assert float(seconds) < 1.0 * max(1, len(data) / 2**20), name
        assert int(kibibytes) < 256 << 10, name


def test_names_from_a_log_are_escaped_on_the_terminal() -> None:
    assert printable_text("a\x1b[2J\n\u202eb\u00e4") == "a\\x1b[2J\\n\\u202eb\u00e4"
    assert printable_text("\ud800") == "\\ud800"
    assert len(printable_text("x" * 10_000)) < 300


def test_a_log_of_another_program_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "other")
        channel = writer.register_channel(
            "/x", "json", writer.register_schema("x", "jsonschema", b"{}")
        )
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(LogError, match="no run of handctl"):
        RunLog(path)


def test_a_pipe_or_directory_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, tmp_path / "missing"):
        with pytest.raises(LogError):
            RunLog(path)


def test_a_log_of_another_version_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mcap"
    synthetic_run.write_synthetic_run(path, synthetic_run.synthetic_header(rate_hz=50), 0.1)
    monkeypatch.setattr("handctl.log.read.reader.LOG_SCHEMA_VERSION", 2)
    with pytest.raises(LogError, match="version 1"):
        RunLog(path)


def test_missing_part_of_a_log_is_named() -> None:
    with (
        pytest.raises(LogError, match="damaged log: '/tick' is missing"),
        LogErrorContext("a.mcap"),
    ):
        raise KeyError("/tick")
