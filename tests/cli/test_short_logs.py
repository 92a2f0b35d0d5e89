"""Test that every command handles logs without ticks, with few ticks, and with ticks in a wrong order."""

import struct
from collections.abc import Sequence
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.log.read.reader import RunLog
from handctl.log.tick_record import TICK_SIZES_STRUCT
from handctl.log.write.log_writer import LogWriter

GRASP_LOG = Path(__file__).parents[2] / "logs" / "golden" / "jamia-grasp.mcap"


def tick_records_of(run_log: RunLog) -> list[bytes]:
    """Return the ticks of a log as bytes, in the format that the controller sends to its recorder."""
    axes = [len(run_log.header.axis_names(name)) for name in ("joint", "tendon", "motor", "digit")]
    pairs = zip(run_log.tick_messages(), run_log.packed_telemetry(), strict=True)
    return [
        TICK_SIZES_STRUCT.pack(len(message), *axes) + message + numbers
        for message, numbers in pairs
    ]


def write_log(log_path: Path, source_log: RunLog, tick_records: Sequence[bytes]) -> str:
    """Write a complete log with given ticks and the header of ``source_log``, and return the path of the new log."""
    writer = LogWriter(log_path, source_log.header, lambda *arguments: None, 1)
    for tick in tick_records:
        writer.add_tick(tick)
    writer.finish("done", 0)
    return str(log_path)


@pytest.mark.parametrize(
    "ticks", [slice(0, 0), slice(0, 15), slice(0, 50), slice(300, 302)], ids=str
)
@pytest.mark.filterwarnings("error")
def test_every_verb_reads_or_refuses_a_short_log(
    ticks: slice, work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with RunLog(GRASP_LOG) as log:
        short_log = write_log(work_folder / "short.mcap", log, tick_records_of(log)[ticks])
    (work_folder / "gains.toml").write_text("[motion]\nposition_error_m = 3e-4\n")
    verbs = {
        ("log", "info", short_log): (0,),
        ("log", "check", short_log): (0,),
        ("log", "diff", short_log, str(GRASP_LOG)): (0,),
        ("log", "diff", str(GRASP_LOG), short_log): (0,),
        ("log", "export", "--csv", short_log): (0,),
        ("log", "export", "--lerobot", short_log): (0, 2),
        ("report", short_log): (0,),
        ("replay", "execute", short_log): (0, 1),
        ("replay", "execute", short_log, "--gains", "gains.toml"): (0, 2),
    }
    for words, codes in verbs.items():
        assert main(list(words)) in codes, words
        error_lines = capsys.readouterr().err.splitlines()
        assert len(error_lines) <= 1, words


def _shifted_tick(tick_record: bytes, tick_shift: int, period_ns: int) -> bytes:
    """Return a copy of a recorded tick, with the tick number and the time shifted by ``tick_shift`` ticks."""
    at = TICK_SIZES_STRUCT.size + 4
    k, t_ns = struct.unpack_from("<qq", tick_record, at)
    return (
        tick_record[:at]
        + struct.pack("<qq", k + tick_shift, t_ns + tick_shift * period_ns)
        + tick_record[at + 16 :]
    )


@pytest.mark.parametrize("clock_mistake", ["far apart", "in no order"])
def test_an_inconsistent_clock_in_a_log_is_refused(
    clock_mistake: str, work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with RunLog(GRASP_LOG) as log:
        ticks, period_ns = tick_records_of(log), log.header.period_ns
        ticks_with_clock_jump = ticks[:300] + [
            _shifted_tick(tick, 10**11, period_ns) for tick in ticks[300:]
        ]
        inconsistent_log = write_log(
            work_folder / "odd.mcap",
            log,
            ticks_with_clock_jump if clock_mistake == "far apart" else ticks[311:] + ticks[:311],
        )
    assert main(["log", "check", inconsistent_log]) == 1
    assert main(["report", inconsistent_log]) == 0
    output = capsys.readouterr().out
    assert "missing between 299" in output if clock_mistake == "far apart" else "gap" not in output
    drive = ["replay", "drive", "--bus", "local:nobody", "--dry-run", inconsistent_log]
    for words in (
        ["log", "diff", inconsistent_log, inconsistent_log],
        ["log", "export", "--lerobot", inconsistent_log],
        drive,
    ):
        assert main(words) == 2, words
        assert len(capsys.readouterr().err.splitlines()) == 1
