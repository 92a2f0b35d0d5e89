"""The recorder continues when the controller ends, never delays the controller, and reports failed writes."""

import os
import platform
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import synthetic_run
import varied_run

from handctl.core.tick_types import IoEvent, TickIn
from handctl.errors import LogError
from handctl.log.read.reader import RunLog
from handctl.log.tick_packing import pack_tick_record
from handctl.log.tick_record import RECORD_FRAMING_STRUCT
from handctl.log.write import recorder_start
from handctl.log.write.disk_syncer import DiskSyncer
from handctl.log.write.log_writer import LogWriter
from handctl.log.write.recorder import PIPE_BYTES, Recorder
from handctl.log.write.recorder_process import RECORDER_NICE_VALUE
from handctl.log.write.recorder_start import prestarted_recorder_process

NIGHTLY = os.environ.get("HANDCTL_NIGHTLY") == "1"
TICK_SENDER_KILLS, PARALLEL_KILLS = 100 if NIGHTLY else 8, 4
RECORDER_KILL_COUNT = 100 if NIGHTLY else 1
TICK_SENDER_PROGRAM = Path(__file__).with_name("tick_sender.py")


@pytest.fixture
def start_recorder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., Recorder]]:
    """Yield a function that starts a recorder.

    The pipe of the recorder has the largest size that Linux permits without special rights.

    After the test, end all recorders.
    """
    started: list[Recorder] = []
    monkeypatch.setattr("handctl.log.write.recorder.PIPE_BYTES", PIPE_BYTES[-1:])

    def start_one_recorder(
        name: str = "run.mcap", deterministic: bool = False, min_free_bytes: int = 1, **more: object
    ) -> Recorder:
        run = synthetic_run.synthetic_header(rate_hz=1000, deterministic=deterministic, **more)
        started.append(Recorder.start(tmp_path / name, run, min_free_bytes))
        return started[-1]

    yield start_one_recorder
    for recorder in started:
        if recorder._child.poll() is None:
            recorder._child.send_signal(signal.SIGCONT)
            recorder.close("test over")


def _make_records(record_count: int) -> list[bytes]:
    run = synthetic_run.synthetic_header(rate_hz=1000)
    return [
        pack_tick_record(*tick)
        for tick in synthetic_run.SyntheticRunTicks(run, record_count / 1000)
    ]


def _wait_until(is_condition_met: Callable[[], bool], timeout_s: float = 10.0) -> bool:
    end = time.monotonic() + timeout_s
    while not (done := is_condition_met()) and time.monotonic() < end:
        time.sleep(0.01)
    return done


def _is_finished(log_path: Path) -> bool:
    with RunLog(log_path) as log:
        return not log.warning


def test_a_recorder_that_does_not_start_in_time_is_named(
    start_recorder: Callable[..., Recorder], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error message states the time that the command waited for the recorder, and advises a less busy computer."""
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nexec sleep 10\n")
    python.chmod(0o755)
    monkeypatch.setattr("handctl.log.write.recorder_start.sys.executable", str(python))
    monkeypatch.setattr("handctl.log.write.recorder.START_TIMEOUT_S", 0.2)
    with pytest.raises(
        LogError, match=r"has not started within 0\.2 s; expected a computer with less other load"
    ):
        start_recorder()


def test_a_process_started_ahead_records_the_first_run(
    start_recorder: Callable[..., Recorder], tmp_path: Path
) -> None:
    with prestarted_recorder_process():
        (waiting,) = recorder_start._started_ahead
        first_recorder = start_recorder("first.mcap")
        second_recorder = start_recorder("second.mcap")
        assert waiting.child.poll() is None
    assert first_recorder._child is waiting.child
    assert second_recorder._child is not waiting.child
    for recorder in (first_recorder, second_recorder):
        assert recorder.close("done")["complete"]


def test_an_unused_recorder_process_started_ahead_is_ended() -> None:
    with prestarted_recorder_process():
        (waiting,) = recorder_start._started_ahead
    assert waiting.child.returncode is not None
    assert recorder_start._started_ahead == []
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(waiting.pipe)


def test_a_process_started_ahead_ends_with_its_controller() -> None:
    script = "from handctl.log.write import recorder_start\nprint(recorder_start.start_recorder_process().child.pid)"
    ended = subprocess.run(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, check=False
    )
    recorder = Path(f"/proc/{ended.stdout.strip()}")
    assert _wait_until(lambda: not recorder.exists() or ") Z " in (recorder / "stat").read_text())


def test_a_kill_of_the_controller_loses_no_tick(tmp_path: Path) -> None:
    rng = random.Random(5)
    for first_number in range(0, TICK_SENDER_KILLS, PARALLEL_KILLS):
        paths = [tmp_path / f"{n}.mcap" for n in range(first_number, first_number + PARALLEL_KILLS)]
        tick_senders = [
            subprocess.Popen(
                [sys.executable, TICK_SENDER_PROGRAM, path],
                stdout=subprocess.PIPE,
                start_new_session=True,
            )
            for path in paths
        ]
        for tick_sender in tick_senders:
            assert tick_sender.stdout is not None
            assert tick_sender.stdout.read(8)
        for tick_sender in tick_senders:
            time.sleep(rng.uniform(0, 0.2))
            tick_sender.kill()
        for path, tick_sender in zip(paths, tick_senders, strict=True):
            written = 8 + len(tick_sender.communicate()[0])
            assert _wait_until(lambda path=path: _is_finished(path))
            with RunLog(path) as log:
                assert log.end["reason"] == "controller died"
                assert int(log.k[-1]) >= written // 8 - 1
                assert log.gaps == []
                assert len(list(log.ticks())) == len(log) == len(log.field("tension"))


@pytest.mark.parametrize("kill_number", range(RECORDER_KILL_COUNT))
def test_a_killed_recorder_loses_a_quarter_of_a_second(
    start_recorder: Callable[..., Recorder], tmp_path: Path, kill_number: int
) -> None:
    tick_count = random.Random(kill_number).randrange(300, 900)
    recorder, records = start_recorder(), _make_records(tick_count)
    started = time.monotonic()
    for k, record in enumerate(records):
        assert recorder.send_record(record)
        time.sleep(max(0.0, started + (k + 1) * 0.001 - time.monotonic()))
    os.kill(recorder._child.pid, signal.SIGKILL)
    kill_time_s = time.monotonic()
    recorder._child.wait()
    with RunLog(tmp_path / "run.mcap") as log:
        assert log.warning
        assert log.gaps == []
        lost_record_count = len(records) - len(log)
        assert len(list(log.ticks())) == len(log)
    assert lost_record_count * 0.001 <= 0.25 + (kill_time_s - started - tick_count * 0.001)
    assert not recorder.send_record(records[0])
    assert IoEvent("recorder", "gone") in recorder.take_events()
    assert recorder.take_events() == ()
    summary = recorder.close("gone")
    assert not summary["complete"]
    assert summary["dropped"] == 1


def test_a_stalled_recorder_never_holds_up_the_controller(
    start_recorder: Callable[..., Recorder], tmp_path: Path
) -> None:
    recorder, records = start_recorder(), _make_records(3000)
    recorder.send_record(records[0])
    os.kill(recorder._child.pid, signal.SIGSTOP)
    accepted_ticks, longest, events = [], 0.0, []
    for k, record in enumerate(records[1:], 1):
        started = time.perf_counter()
        if recorder.send_record(record):
            accepted_ticks.append(k)
        longest = max(longest, time.perf_counter() - started)
        events += recorder.take_events()
    os.kill(recorder._child.pid, signal.SIGCONT)
    assert longest < 0.05
    assert 100 < len(accepted_ticks) < len(records) - 100
    assert [event.where for event in events][:2] == ["filling", "dropped"]
    assert sum(event.number for event in events if event.where == "dropped") == recorder.dropped
    assert _wait_until(lambda: recorder.send_record(records[-1]))
    summary = recorder.close("finished")
    with RunLog(tmp_path / "run.mcap") as log:
        assert log.k.tolist() == [0, *accepted_ticks, len(records) - 1]
        assert int(log.end["dropped"]) == summary["dropped"] > 0
        assert len(log.gaps) >= 1


def test_a_deterministic_run_has_no_event_of_the_time_that_its_recorder_takes(
    start_recorder: Callable[..., Recorder],
) -> None:
    # A deterministic run waits while the pipe to the recorder is full, so it loses no tick. The run
    # records no event about a full pipe, because two equal runs would then differ.
    recorder = start_recorder(deterministic=True)
    os.kill(recorder._child.pid, signal.SIGSTOP)
    events, sent = [], 0
    for record in _make_records(1000):
        if sent > 0.52 * recorder._size:
            break
        assert recorder.send_record(record)
        sent += len(record)
        events += recorder.take_events()
    os.kill(recorder._child.pid, signal.SIGCONT)
    assert sent > recorder._size // 2
    assert events == []


def test_records_longer_than_an_atomic_write_stay_whole(
    start_recorder: Callable[..., Recorder], tmp_path: Path
) -> None:
    recorder, rng, accepted_records = start_recorder(), random.Random(3), []
    ticks = list(synthetic_run.SyntheticRunTicks(synthetic_run.synthetic_header(rate_hz=1000), 1.0))
    for k, (tick_in, out) in enumerate(ticks):
        if k % 250 == 100:
            os.kill(recorder._child.pid, signal.SIGSTOP)
        if k % 250 == 200:
            os.kill(recorder._child.pid, signal.SIGCONT)
            time.sleep(0.1)
        text = rng.choice("ab") * rng.randrange(9_000, 30_000)
        if recorder.send_record(pack_tick_record(tick_in._replace(requests=(text,)), out)):
            accepted_records.append((k, text))
    assert 0 < recorder.dropped < len(ticks) - 100
    recorder.close("finished")
    with RunLog(tmp_path / "run.mcap") as log:
        assert [
            (tick.tick_in.k, *tick.tick_in.requests) for tick in log.ticks()
        ] == accepted_records


def test_telemetry_of_another_shape_is_announced(
    start_recorder: Callable[..., Recorder],
) -> None:
    recorder = start_recorder()
    other_header = synthetic_run.synthetic_header("jamia11", rate_hz=1000)
    for tick in synthetic_run.SyntheticRunTicks(other_header, 0.01):
        recorder.send_record(pack_tick_record(*tick))
    events: list[IoEvent] = []
    assert _wait_until(lambda: bool(events.extend(recorder.take_events())) or bool(events))
    assert events == [IoEvent("recorder", "misshapen", 1)]


def test_a_lockstep_run_waits_and_loses_nothing(
    start_recorder: Callable[..., Recorder], tmp_path: Path
) -> None:
    recorder, records = start_recorder(deterministic=True), _make_records(3000)
    assert all(recorder.send_record(record) for record in records)
    summary = recorder.close("finished")
    assert (summary["ticks"], summary["dropped"], summary["complete"]) == (3000, 0, True)


def test_interrupts_do_not_reach_the_recorder(
    start_recorder: Callable[..., Recorder], tmp_path: Path
) -> None:
    recorder = start_recorder()
    assert os.getsid(recorder._child.pid) != os.getsid(0)
    for signal_number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(recorder._child.pid, signal_number)
    for record in _make_records(10):
        assert recorder.send_record(record)
    assert recorder.close("stopped by hand")["ticks"] == 10
    with RunLog(tmp_path / "run.mcap") as log:
        assert log.end["reason"] == "stopped by hand"


def test_the_recorder_has_priority_over_other_programs(
    start_recorder: Callable[..., Recorder],
) -> None:
    priority, child = (
        os.getpriority(os.PRIO_PROCESS, pid) for pid in (0, start_recorder()._child.pid)
    )
    assert child == (RECORDER_NICE_VALUE if os.geteuid() == 0 else priority)


def test_the_header_is_in_the_file_before_the_first_tick(
    start_recorder: Callable[..., Recorder], tmp_path: Path
) -> None:
    attachments = {"big.bin": random.Random(1).randbytes(3 << 20)}
    recorder = start_recorder(
        attachments=attachments, metadata={"note": "a \u00e4"}, wall={"host": "x"}
    )
    with RunLog(tmp_path / "run.mcap") as log:
        assert log.header.attachments["big.bin"] == attachments["big.bin"]
        assert log.header.attachments["hand.toml"].decode() == log.header.hand_toml
        assert log.header.metadata == {"note": "a \u00e4"}
        assert log.header.wall == {"host": "x"}
        assert len(log) == 0
    recorder.close("finished")


@pytest.mark.parametrize("name", ["exists.mcap", "no/such/directory.mcap"])
def test_a_file_that_cannot_be_created_is_refused(
    start_recorder: Callable[..., Recorder], tmp_path: Path, name: str
) -> None:
    (tmp_path / "exists.mcap").write_text("precious")
    with pytest.raises(LogError, match="cannot record"):
        start_recorder(name)
    assert (tmp_path / "exists.mcap").read_text() == "precious"


FILE_SIZE_LIMIT_BYTES = 800_000
"""Largest permitted size of a file [bytes].

The size limit simulates a full disk. A file of the largest permitted size can contain only a part
of the run.
"""


def _check_readable_prefix(path: Path, log_size: int) -> None:
    with RunLog(path) as log:
        assert 0 < len(log) < log_size
        assert log.k.tolist() == list(range(len(log)))
        assert len(list(log.ticks())) == len(log)


def test_a_failed_write_is_announced_and_ends_the_file(
    start_recorder: Callable[..., Recorder], tmp_path: Path
) -> None:
    recorder, records = start_recorder(), _make_records(2000)
    resource.prlimit(
        recorder._child.pid, resource.RLIMIT_FSIZE, (FILE_SIZE_LIMIT_BYTES, FILE_SIZE_LIMIT_BYTES)
    )
    events: list[IoEvent] = []
    for record in records:
        recorder.send_record(record)
        time.sleep(0.0002)
        events += recorder.take_events()
    assert _wait_until(
        lambda: (
            bool(events.extend(recorder.take_events()))
            or any(event.where == "disk_full" for event in events)
        )
    )
    summary = recorder.close("finished")
    assert summary["lost"] + summary["ticks"] == len(records) - recorder.dropped
    assert (tmp_path / "run.mcap").stat().st_size <= FILE_SIZE_LIMIT_BYTES
    assert [event.where for event in events].count("disk_full") == 1
    _check_readable_prefix(tmp_path / "run.mcap", len(records))


@pytest.fixture
def two_megabyte_disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a disk of two megabytes, and return its folder."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount_process = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)], capture_output=True
    )
    if mount_process.returncode:
        pytest.skip("cannot mount a tmpfs here")
    yield disk
    subprocess.run(["umount", "--lazy", str(disk)], check=True)


@pytest.mark.parametrize("min_free_bytes", [1, 700_000])
def test_a_full_disk_leaves_a_whole_file(
    two_megabyte_disk: Path, start_recorder: Callable[..., Recorder], min_free_bytes: int
) -> None:
    recorder, records = (
        start_recorder("disk/run.mcap", min_free_bytes=min_free_bytes),
        _make_records(3000),
    )
    for record in records:
        recorder.send_record(record)
        time.sleep(0.0005)
    assert _wait_until(lambda: any(event.where == "disk_full" for event in recorder.take_events()))
    recorder.close("finished")
    _check_readable_prefix(two_megabyte_disk / "run.mcap", len(records))
    with RunLog(two_megabyte_disk / "run.mcap") as log:
        assert not log.warning
        assert log.end["reason"] in ("disk full", "write failed: No space left on device")
    assert [path.name for path in two_megabyte_disk.iterdir()] == ["run.mcap"]


def test_a_log_that_is_renamed_during_the_run_is_completed(tmp_path: Path) -> None:
    """Reproduce a defect: the recorder process ended with FileNotFoundError, and the log had no end mark."""
    path = tmp_path / "run.mcap"
    writer = LogWriter(path, synthetic_run.synthetic_header(), lambda *arguments: None, 1)
    records = _make_records(100)
    for record in records[:50]:
        writer.add_tick(record[RECORD_FRAMING_STRUCT.size :])
    path.rename(tmp_path / "kept.mcap")
    writer.sync()
    for record in records[50:]:
        writer.add_tick(record[RECORD_FRAMING_STRUCT.size :])
    writer.finish("finished", 0)
    with RunLog(tmp_path / "kept.mcap") as log:
        assert (len(log), log.warning, log.end["reason"]) == (100, "", "finished")


def test_a_full_disk_has_reserved_space_for_the_end(two_megabyte_disk: Path) -> None:
    events: list[tuple[str, int]] = []
    writer = LogWriter(
        two_megabyte_disk / "run.mcap",
        synthetic_run.synthetic_header(),
        lambda *arguments: events.append(arguments),
        700_000,
    )
    for record in _make_records(200):
        writer.add_tick(record[RECORD_FRAMING_STRUCT.size :])
    writer.flush()
    with (two_megabyte_disk / "other").open("wb", buffering=0) as other_file, suppress(OSError):
        while True:
            other_file.write(bytes(4096))
    writer.sync()
    writer.finish("finished", 0)
    assert [event_name for event_name, _ in events] == ["disk_full"]
    with RunLog(two_megabyte_disk / "run.mcap") as log:
        assert (len(log), log.warning, log.end["reason"]) == (200, "", "disk full")


def test_the_syncing_process_does_not_hold_the_reserved_space(two_megabyte_disk: Path) -> None:
    disk_syncer = DiskSyncer()
    writer = LogWriter(
        two_megabyte_disk / "run.mcap",
        synthetic_run.synthetic_header(),
        lambda *arguments: None,
        1,
        sync_file=disk_syncer,
    )
    for record in _make_records(100):
        writer.add_tick(record[RECORD_FRAMING_STRUCT.size :])
    writer.flush()
    writer.sync()
    with (two_megabyte_disk / "other").open("wb", buffering=0) as other_file, suppress(OSError):
        while True:
            other_file.write(bytes(4096))
    writer._reserved.release()
    assert _wait_until(lambda: shutil.disk_usage(two_megabyte_disk).free > 256 << 10, 5.0)
    writer.finish("finished", 0)
    # without the pipe to the syncer, the process of the syncer ends
    os.close(disk_syncer._request_pipe)


def test_recording_a_tick_is_fast(start_recorder: Callable[..., Recorder]) -> None:
    recorder = start_recorder()
    tick_in, out = next(
        iter(synthetic_run.SyntheticRunTicks(synthetic_run.synthetic_header(rate_hz=1000), 0.01))
    )
    durations_s = []
    for k in range(300):
        started = time.perf_counter()
        recorder.send_record(pack_tick_record(TickIn(k, k * 1_000_000, 0, tick_in.frames), out))
        recorder.take_events()
        durations_s.append(time.perf_counter() - started)
        time.sleep(0.0005)
    assert sorted(durations_s)[len(durations_s) // 2] < 200e-6


def test_the_recorder_needs_no_compiler(tmp_path: Path) -> None:
    """The recorder imports no compiler.

    A run waits until its recorder is ready. If the recorder imported a compiler, every run would
    begin later.

    Earlier defect: the recorder imported numba, llvmlite and scipy in order to check a single
    string.
    """
    run = varied_run.varied_header()
    path = tmp_path / "run.mcap"
    recorder = Recorder.start(path, run, 1)
    size = path.stat().st_size
    for tick in varied_run.varied_ticks(run):
        recorder.send_record(pack_tick_record(*tick))
    assert _wait_until(lambda: path.stat().st_size > size)
    memory_maps = Path(f"/proc/{recorder._child.pid}/maps").read_text()
    assert recorder.close("finished")["complete"]
    assert "/numpy/" in memory_maps
    assert not {name for name in ("/llvmlite/", "/scipy/") if name in memory_maps}


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc has mallopt")
def test_the_recorder_uses_freed_memory_again() -> None:
    """Without ``keep_freed_memory``, the system provides each page of each block again."""
    program = (
        "import resource\n"
        "from handctl.log.write.recorder_process import keep_freed_memory\n"
        "keep_freed_memory()\n"
        "def page_faults():\n"
        "    blocks = [bytearray(b'x') * (2 << 20) for _ in range(8)]\n"
        "    del blocks\n"
        "    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "first = page_faults()\n"
        "print([page_faults() for _ in range(20)][-1] - first)\n"
    )
    output = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    pages_of_all_blocks = (16 << 20) // resource.getpagesize()
    assert int(output.stdout) < 2 * pages_of_all_blocks
