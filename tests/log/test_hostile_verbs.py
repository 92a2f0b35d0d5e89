"""For a hostile log file, every command prints one clear line.

With a hostile log file, a command ends after at most one second, and uses at most 256 MiB of
memory.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import synthetic_run
from hostile_logs import hostile_files

from handctl.cli.main import main
from handctl.log.tick_packing import pack_tick_record
from handctl.log.tick_record import RECORD_FRAMING_STRUCT
from handctl.log.write.log_writer import LogWriter

EXIT_CODES = {
    "log recover": (1, 2, 3),
    "log check": (1, 2, 3),
    "replay drive": (2, 4),
    "view --save": (2, 3),
}
"""Commands whose exit code for a hostile log is not the usual code of bad input.

`replay drive` checks the name of the hand before all else, and a hostile log contains no name of a
hand.
"""
PROBE_PROGRAM = """
import contextlib, io, json, resource, sys, time
from pathlib import Path
from handctl.cli.main import main
import handctl.log.read.reader, handctl.log.read.recover
import handctl.replay.log_check, handctl.replay.damage_description, handctl.replay.log_execution
import handctl.report.run_report_page, handctl.replay.phase_comparison, handctl.replay.limits_judgement
import handctl.view.rerun_conversion
folder, found = Path(sys.argv[1]), []
(folder / "limits.toml").write_text("tension_trip_N = 20")
VERBS = [["log", "info"], ["log", "check"], ["log", "recover"], ["report"], ["replay", "execute"],
    ["replay", "safety", "--limits", str(folder / "limits.toml")], ["replay", "drive", "--bus", "local:x", "--dry-run"],
    ["view", "--save", str(folder / "x.rrd")], ["log", "export", "--csv"], ["log", "diff"]]
limit = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 + (256 << 20)
for path in sorted(folder.glob("*.mcap")):
    for words in VERBS:
        out, err = io.StringIO(), io.StringIO()
        begin = time.process_time()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main([*words, str(path), *([str(path)] if words[-1] == "diff" else [])])
        lines = (err.getvalue() + out.getvalue()).splitlines()
        found.append([path.name, words, code, lines, time.process_time() - begin])
    for made in folder.glob("*.recovered.mcap"):
        made.unlink()
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
print(json.dumps([found, peak <= limit]))
"""


def test_every_verb_refuses_a_hostile_log_in_one_line(small_log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "hostile"
    folder.mkdir()
    for name, data in hostile_files(small_log).items():
        (folder / f"{name}\x1b[2J.mcap").write_bytes(data)
    done = subprocess.run(
        [sys.executable, "-c", PROBE_PROGRAM, str(folder)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    outcomes, little_memory = json.loads(done.stdout)
    assert little_memory
    assert len(outcomes) == 10 * len(list(folder.glob("*.mcap")))
    for name, words, code, output, seconds in outcomes:
        failure_text = f"{words} on {name}: {output}"
        assert code in EXIT_CODES.get(" ".join(words[:2]), (2,)), failure_text
        assert len(output) <= 2, failure_text
        assert "\x1b" not in "".join(output), failure_text
        assert "Traceback" not in "".join(output), failure_text
        assert seconds < 1.0, failure_text


def test_names_from_a_log_cannot_control_the_terminal_or_write_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    escape_sequence = "\x1b]0;mine\x07\x1b[2J"
    hostile_names = {
        "metadata": {"hand": escape_sequence, "note": escape_sequence},
        "gains": {escape_sequence: escape_sequence},
        "attachments": {f"../{escape_sequence}": b"x"},
    }
    run = synthetic_run.synthetic_header(rate_hz=50, **hostile_names)
    writer = LogWriter(inner / "run.mcap", run, lambda *arguments: None, 1)
    for tick in synthetic_run.SyntheticRunTicks(run, 0.5):
        writer.add_tick(pack_tick_record(*tick)[RECORD_FRAMING_STRUCT.size :])
    writer.finish(escape_sequence, 0)
    for words in (
        ["log", "info"],
        ["log", "check"],
        ["log", "recover"],
        ["log", "export", "--csv"],
        ["report"],
    ):
        main([*words, str(inner / "run.mcap")])
        out, err = capsys.readouterr()
        assert "\x1b" not in out + err, words
    assert list(tmp_path.iterdir()) == [inner]
    assert {path.name for path in inner.iterdir()} <= {
        "run.mcap",
        "run.recovered.mcap",
        "run.csv",
        "run.html",
    }
