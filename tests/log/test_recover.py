"""From a log that was cut off at any byte, ``log recover`` recovers exactly the complete chunks."""

import random
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
import synthetic_run
from other_log_readers import read_messages

from handctl.errors import ConfigError, LogError
from handctl.log.read.logfile import LogFile
from handctl.log.read.reader import RunLog
from handctl.log.read.record_scan import RecordScan, scan_records
from handctl.log.read.recover import RecoveryReport, RecoveryStatus, recover_log

SAMPLE_COUNT = 500


@pytest.fixture(scope="module")
def smallest_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a complete log of at most 68 KiB, and return its path.

    The tests cut the returned log off at every byte. The log has eight chunks. The log contains no
    URDF, so the file is small.
    """
    path = tmp_path_factory.mktemp("log") / "least.mcap"
    attachments = {
        "gains.toml": b"[motion]\nposition_error_m = 6e-4\n",
        "initial_state": bytes(range(64)),
    }
    synthetic_run.write_synthetic_run(
        path, synthetic_run.synthetic_header(rate_hz=4, attachments=attachments), 1.75
    )
    assert 60 << 10 < path.stat().st_size <= 68 << 10
    return path


def _scan_log(path: Path) -> RecordScan:
    file, scan = LogFile(path), RecordScan()
    scan_records(file, scan)
    file.close()
    return scan


@pytest.mark.parametrize("seed", range(3))
def test_a_scan_in_steps_equals_a_scan_at_once(seed: int, small_log: Path, tmp_path: Path) -> None:
    whole_content, path, scan = small_log.read_bytes(), tmp_path / "growing.mcap", RecordScan()
    source = random.Random(seed)
    for size in sorted(source.randrange(8, len(whole_content)) for _ in range(20)):
        path.write_bytes(whole_content[:size])
        file = LogFile(path)
        scan_records(file, scan)
        file.close()
        assert scan == _scan_log(path)
        assert scan.problem.startswith(f"ends at byte {size}") or scan.is_complete
    file = LogFile(small_log)
    scan_records(file, scan)
    file.close()
    assert scan == _scan_log(small_log)
    assert scan.is_complete
    assert scan.problem == ""


def _recover_bytes(log_bytes: bytes, work_folder: Path) -> tuple[RecoveryReport, Path]:
    cut, out = work_folder / "cut.mcap", work_folder / "out.mcap"
    cut.write_bytes(log_bytes)
    out.unlink(missing_ok=True)
    return recover_log(cut, out), out


def _chunk_starts(path: Path) -> dict[int, int]:
    """Return a dictionary from n to the number of /tick messages in the first n chunks of a log."""
    scan, ticks = _scan_log(path), {0: 0}
    with RunLog(path) as log:
        for n in range(1, len(scan.chunks) + 1):
            log._chunks = scan.chunks[:n]
            log.__dict__.pop("_chunk_index", None)
            ticks[n] = len(log)
    return ticks


@pytest.mark.parametrize(
    "every",
    [False, pytest.param(True, marks=[pytest.mark.nightly, pytest.mark.timeout(3600)])],
    ids=["some", "every"],
)
def test_a_cut_gives_the_exact_prefix(smallest_log: Path, tmp_path: Path, every: bool) -> None:
    raw, scan, ticks = (
        smallest_log.read_bytes(),
        _scan_log(smallest_log),
        _chunk_starts(smallest_log),
    )
    assert len(scan.chunks) == 8
    with RunLog(smallest_log) as log:
        tension, k = log.field("tension"), log.k
    cut_positions: Iterable[int] = range(8, len(raw) + 1)
    if not every:
        chunk_borders = {chunk.end + step for chunk in scan.chunks for step in (-1, 0, 1)}
        cut_positions = (
            np.random.default_rng(0).choice(
                len(raw) - 8, SAMPLE_COUNT - len(chunk_borders), replace=False
            )
            + 8
        )
        cut_positions = sorted({*cut_positions.tolist(), *chunk_borders})
    for cut in cut_positions:
        complete = sum(chunk.end <= cut for chunk in scan.chunks)
        recovery, out = _recover_bytes(raw[:cut], tmp_path)
        if not complete:
            assert recovery.status == RecoveryStatus.NOTHING
            assert not out.exists()
            continue
        assert recovery.chunks == complete
        with RunLog(tmp_path / "cut.mcap") as direct_log, RunLog(out) as log:
            assert bool(direct_log.warning) == (cut < len(raw))
            assert not log.warning
            for run_log in (direct_log, log):
                assert run_log.k.tolist() == k[: ticks[complete]].tolist()
                assert run_log.field("tension").tobytes() == tension[: ticks[complete]].tobytes()


def test_a_recovered_file_is_readable_by_others_and_marked_as_recovered(
    small_log: Path, tmp_path: Path
) -> None:
    raw, scan = small_log.read_bytes(), _scan_log(small_log)
    recovery, out = _recover_bytes(raw[: scan.chunks[6].end + 5], tmp_path)
    assert recovery.status == RecoveryStatus.LOSSY
    assert recovery.lost_ranges[-1][1] == scan.chunks[6].end + 5
    recovered_messages = read_messages(out)
    assert len(recovered_messages) == recovery.messages
    last_time = max(message.log_time for message in recovered_messages if message.topic == "/tick")
    whole_messages = [
        message for message in read_messages(small_log) if message.log_time <= last_time
    ]
    assert sorted(recovered_messages) == sorted(whole_messages)
    with RunLog(out) as log, RunLog(small_log) as whole_log:
        assert "without an end mark" in log.end["recovered"]
        assert log.header == whole_log.header
        assert len(list(log.ticks())) == len(log)


def test_a_complete_file_is_copied_unchanged(small_log: Path, tmp_path: Path) -> None:
    recovery, out = _recover_bytes(small_log.read_bytes(), tmp_path)
    assert (recovery.status, recovery.lost_ranges, recovery.problem) == (
        RecoveryStatus.WHOLE,
        (),
        "",
    )
    assert read_messages(out) == read_messages(small_log)
    with RunLog(out) as log, RunLog(small_log) as whole_log:
        assert log.end == whole_log.end
        assert log.header == whole_log.header


def test_one_damaged_chunk_is_left_out_and_the_rest_copied(small_log: Path, tmp_path: Path) -> None:
    raw, scan = bytearray(small_log.read_bytes()), _scan_log(small_log)
    damaged_chunk = scan.chunks[4]
    raw[damaged_chunk.data_offset + 50] ^= 0xFF
    recovery, out = _recover_bytes(bytes(raw), tmp_path)
    assert recovery.status == RecoveryStatus.LOSSY
    assert recovery.chunks == len(scan.chunks) - 1
    assert recovery.lost_ranges[0] == (damaged_chunk.offset, damaged_chunk.end)
    with RunLog(out) as log:
        assert len(log.gaps) == 1
        assert len(list(log.ticks())) == len(log)
    with pytest.raises(LogError):
        RunLog(tmp_path / "cut.mcap")


@pytest.mark.parametrize("damaged_part", ["attachment", "metadata", "chunk's header"])
def test_a_damaged_record_affects_no_other(
    small_log: Path, tmp_path: Path, damaged_part: str
) -> None:
    raw, scan = bytearray(small_log.read_bytes()), _scan_log(small_log)
    (_, _, content), values = scan.attachments["hand.urdf"], scan.metadata["handctl.run"]
    at = {
        "attachment": raw.index(content) + 100,
        "metadata": raw.index(min(values).encode()) - 1,
        "chunk's header": scan.chunks[3].offset + 9 + 23,
    }[damaged_part]
    raw[at] ^= 0x80
    recovery, out = _recover_bytes(bytes(raw), tmp_path)
    assert recovery.status == RecoveryStatus.LOSSY
    assert recovery.chunks == len(scan.chunks) - (damaged_part == "chunk's header")
    start, end = recovery.lost_ranges[0]
    assert start < at < end
    recovered_messages = _scan_log(out)
    assert not recovered_messages.problem
    assert scan.attachments.keys() - recovered_messages.attachments.keys() == (
        {"hand.urdf"} if damaged_part == "attachment" else set()
    )


def test_a_damaged_summary_loses_no_message(small_log: Path, tmp_path: Path) -> None:
    raw = bytearray(small_log.read_bytes())
    raw[-60] ^= 1
    recovery, out = _recover_bytes(bytes(raw), tmp_path)
    assert recovery.status == RecoveryStatus.WHOLE
    assert "summary" in recovery.problem
    assert read_messages(out) == read_messages(small_log)


def test_an_existing_file_is_not_overwritten(small_log: Path, tmp_path: Path) -> None:
    existing_file = tmp_path / "precious.mcap"
    existing_file.write_text("precious")
    with pytest.raises(ConfigError, match="is there already"):
        recover_log(small_log, existing_file)
    assert existing_file.read_text() == "precious"


def test_another_file_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"no log at all")
    with pytest.raises(LogError, match="not an MCAP file"):
        recover_log(tmp_path / "x", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_log_with_only_its_header_gives_nothing_but_the_names(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    synthetic_run.write_synthetic_run(path, synthetic_run.synthetic_header(rate_hz=50), 0.5)
    first_chunk = _scan_log(path).chunks[0]
    recovery, out = _recover_bytes(path.read_bytes()[: first_chunk.end], tmp_path)
    assert (recovery.status, recovery.chunks) == (RecoveryStatus.LOSSY, 1)
    with RunLog(out) as log:
        assert len(log) == 0
        assert log.field("tension").shape == (0, 4)
        assert log.header.joints[0] == "index_j1"
        assert log.events == []
