"""Whatever a file was cut down to, exactly the complete chunks before the cut come back."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
import synthetic
from oracle import messages

from handctl.errors import ConfigError, LogError
from handctl.log.read.logfile import LogFile
from handctl.log.read.reader import RunLog
from handctl.log.read.record_scan import RecordScan, scan_records
from handctl.log.read.recover import Recovery, RecoveryStatus, recover

SAMPLE = 500


@pytest.fixture(scope="module")
def least_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole log of 68 KiB at most, so that it can be cut at every byte. Eight chunks fit without its URDF."""
    path = tmp_path_factory.mktemp("log") / "least.mcap"
    attachments = {"gains.toml": b"[motion]\nposition_error_m = 6e-4\n", "initial_state": bytes(range(64))}
    synthetic.write(path, synthetic.header(rate_hz=4, attachments=attachments), 1.75)
    assert 60 << 10 < path.stat().st_size <= 68 << 10
    return path


def _scan(path: Path) -> RecordScan:
    file, found = LogFile(path), RecordScan()
    scan_records(file, found)
    file.close()
    return found


def _recovered(data: bytes, folder: Path) -> tuple[Recovery, Path]:
    cut, out = folder / "cut.mcap", folder / "out.mcap"
    cut.write_bytes(data)
    out.unlink(missing_ok=True)
    return recover(cut, out), out


def _chunk_starts(path: Path) -> dict[int, int]:
    """Number of messages of the topic /tick in the first n chunks."""
    found, ticks = _scan(path), {0: 0}
    with RunLog(path) as log:
        for n in range(1, len(found.chunks) + 1):
            log._chunks = found.chunks[:n]
            log.__dict__.pop("_index", None)
            ticks[n] = len(log)
    return ticks


@pytest.mark.parametrize(
    "every", [False, pytest.param(True, marks=[pytest.mark.nightly, pytest.mark.timeout(3600)])], ids=["some", "every"]
)
def test_a_cut_gives_the_exact_prefix(least_log: Path, tmp_path: Path, every: bool) -> None:
    raw, found, ticks = least_log.read_bytes(), _scan(least_log), _chunk_starts(least_log)
    assert len(found.chunks) == 8
    with RunLog(least_log) as log:
        tension, k = log.field("tension"), log.k
    cuts: Iterable[int] = range(8, len(raw) + 1)
    if not every:
        borders = {chunk.end + step for chunk in found.chunks for step in (-1, 0, 1)}
        chosen = np.random.default_rng(0).choice(len(raw) - 8, SAMPLE - len(borders), replace=False) + 8
        cuts = sorted({*chosen.tolist(), *borders})
    for cut in cuts:
        complete = sum(chunk.end <= cut for chunk in found.chunks)
        recovery, out = _recovered(raw[:cut], tmp_path)
        if not complete:
            assert recovery.status == RecoveryStatus.NOTHING
            assert not out.exists()
            continue
        assert recovery.chunks == complete
        with RunLog(tmp_path / "cut.mcap") as direct, RunLog(out) as log:
            assert bool(direct.warning) == (cut < len(raw))
            assert not log.warning
            for one in (direct, log):
                assert one.k.tolist() == k[: ticks[complete]].tolist()
                assert one.field("tension").tobytes() == tension[: ticks[complete]].tobytes()


def test_a_recovered_file_is_open_to_others_and_says_what_it_is(small_log: Path, tmp_path: Path) -> None:
    raw, found = small_log.read_bytes(), _scan(small_log)
    recovery, out = _recovered(raw[: found.chunks[6].end + 5], tmp_path)
    assert recovery.status == RecoveryStatus.LOSSY
    assert recovery.lost[-1][1] == found.chunks[6].end + 5
    kept = messages(out)
    assert len(kept) == recovery.messages
    last = max(one.log_time for one in kept if one.topic == "/tick")
    whole = [one for one in messages(small_log) if one.log_time <= last]
    assert sorted(kept) == sorted(whole)
    with RunLog(out) as log, RunLog(small_log) as old:
        assert "without an end mark" in log.end["recovered"]
        assert log.header == old.header
        assert len(list(log.ticks())) == len(log)


def test_a_whole_file_stays_what_it_is(small_log: Path, tmp_path: Path) -> None:
    recovery, out = _recovered(small_log.read_bytes(), tmp_path)
    assert (recovery.status, recovery.lost, recovery.problem) == (RecoveryStatus.WHOLE, (), "")
    assert messages(out) == messages(small_log)
    with RunLog(out) as log, RunLog(small_log) as old:
        assert log.end == old.end
        assert log.header == old.header


def test_one_damaged_chunk_is_left_out_and_the_rest_kept(small_log: Path, tmp_path: Path) -> None:
    raw, found = bytearray(small_log.read_bytes()), _scan(small_log)
    hit = found.chunks[4]
    raw[hit.data + 50] ^= 0xFF
    recovery, out = _recovered(bytes(raw), tmp_path)
    assert recovery.status == RecoveryStatus.LOSSY
    assert recovery.chunks == len(found.chunks) - 1
    assert recovery.lost[0] == (hit.offset, hit.end)
    with RunLog(out) as log:
        assert len(log.gaps) == 1
        assert len(list(log.ticks())) == len(log)
    with pytest.raises(LogError):
        RunLog(tmp_path / "cut.mcap")


@pytest.mark.parametrize("what", ["attachment", "metadata", "chunk's header"])
def test_a_damaged_record_costs_no_other(small_log: Path, tmp_path: Path, what: str) -> None:
    raw, found = bytearray(small_log.read_bytes()), _scan(small_log)
    (_, _, content), values = found.attachments["hand.urdf"], found.metadata["handctl.run"]
    at = {
        "attachment": raw.index(content) + 100,
        "metadata": raw.index(min(values).encode()) - 1,
        "chunk's header": found.chunks[3].offset + 9 + 23,
    }[what]
    raw[at] ^= 0x80
    recovery, out = _recovered(bytes(raw), tmp_path)
    assert recovery.status == RecoveryStatus.LOSSY
    assert recovery.chunks == len(found.chunks) - (what == "chunk's header")
    start, end = recovery.lost[0]
    assert start < at < end
    kept = _scan(out)
    assert not kept.problem
    assert found.attachments.keys() - kept.attachments.keys() == ({"hand.urdf"} if what == "attachment" else set())


def test_a_damaged_summary_costs_nothing(small_log: Path, tmp_path: Path) -> None:
    raw = bytearray(small_log.read_bytes())
    raw[-60] ^= 1
    recovery, out = _recovered(bytes(raw), tmp_path)
    assert recovery.status == RecoveryStatus.WHOLE
    assert "summary" in recovery.problem
    assert messages(out) == messages(small_log)


def test_an_existing_file_is_not_overwritten(small_log: Path, tmp_path: Path) -> None:
    precious = tmp_path / "precious.mcap"
    precious.write_text("precious")
    with pytest.raises(ConfigError, match="is there already"):
        recover(small_log, precious)
    assert precious.read_text() == "precious"


def test_what_is_no_log_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"no log at all")
    with pytest.raises(LogError, match="not an MCAP file"):
        recover(tmp_path / "x", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_log_with_only_its_header_gives_nothing_but_the_names(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    synthetic.write(path, synthetic.header(rate_hz=50), 0.5)
    first = _scan(path).chunks[0]
    recovery, out = _recovered(path.read_bytes()[: first.end], tmp_path)
    assert (recovery.status, recovery.chunks) == (RecoveryStatus.LOSSY, 1)
    with RunLog(out) as log:
        assert len(log) == 0
        assert log.field("tension").shape == (0, 4)
        assert log.header.joints[0] == "index_j1"
        assert log.events == []
