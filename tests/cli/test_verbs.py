"""Test that every example in the help text of a command runs exactly as printed.

Further tests check JSON output, dry runs, and the exit codes of the log commands.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from handctl.cli.main import VERB_HELP, main
from handctl.drives import protocol_registry
from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.log.read.reader import RunLog

ABSENT_BUS_OPTION = ("--bus", "local:does-not-exist")
GOLDEN_LOG = Path(__file__).parents[2] / "logs" / "golden" / "jamia-grasp.mcap"


HEAVY_MODULES = {"numpy", "numba", "scipy", "mcap", "handctl.hand.description"}
"""Modules that a command must not import when it prints its help, because the import would delay the help."""


def test_help_imports_nothing_that_only_a_run_needs():
    words = [[verb, "--help"] for verb in sorted(VERB_HELP)]
    code = f"""
import contextlib, io, sys
from handctl.cli.main import main
for words in {words!r}:
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
        main(words)
    print(words[0], *({HEAVY_MODULES!r} & set(sys.modules)))
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout.split() == sorted(VERB_HELP)


def test_a_command_does_not_search_for_plugins_of_pydantic():
    code = """
import importlib.metadata, sys
real_search = importlib.metadata.entry_points
searched_groups = []
def recorded_search(**words):
    searched_groups.append(words.get("group"))
    return real_search(**words)
importlib.metadata.entry_points = recorded_search
from handctl.cli.main import main
assert main(["config", "check", "--hand", "jamia", "--json"]) == 0
assert "pydantic" in sys.modules
assert "pydantic" not in searched_groups
"""
    environment = {
        name: value for name, value in os.environ.items() if name != "PYDANTIC_DISABLE_PLUGINS"
    }
    command = [sys.executable, "-c", code]
    subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=True, timeout=60)


def test_the_protocol_option_lists_all_protocols():
    assert sorted(PROTOCOL_TRAITS) == sorted(protocol_registry.PROTOCOL_ENTRIES)


def json_output(capsys, *words):
    """Run a command with --json, and return its exit code and its output."""
    code = main([*words, "--json"])
    out, _ = capsys.readouterr()
    return code, json.loads(out)


ARGUMENTS_BY_VERB = {
    "run": (*ABSENT_BUS_OPTION, "--task", "grasp.toml"),
    "config show": (),
    "config list": (),
    "config check": ("--task", "grasp.toml"),
    "doctor": (),
}


@pytest.mark.parametrize("verb", ARGUMENTS_BY_VERB)
def test_every_verb_prints_json_without_hardware(capsys, verb):
    dry_run_option = ("--dry-run",) if verb == "run" else ()
    code, printed_json = json_output(
        capsys, *verb.split(), *ARGUMENTS_BY_VERB[verb], *dry_run_option
    )
    # doctor exits with code 1 if it has found a problem
    assert code in ((0, 1) if verb == "doctor" else (0,))
    assert printed_json


def test_config_show_and_run_plan_the_same_bus_load(capsys):
    _, config = json_output(capsys, "config", "show", "--hand", "jamia11")
    _, plan = json_output(capsys, "run", "--hand", "jamia11", *ABSENT_BUS_OPTION, "--dry-run")
    assert config["rate_hz"] == plan["rate_hz"] == 200.0
    assert config["bus_load"]["main"] == plan["bus_load"] < 0.7
    assert plan["buses"] == ["local:does-not-exist"]
    assert config["hand"]["name"] == "jamia11"


DRY_RUN_CASES = {
    "run": ABSENT_BUS_OPTION,
    "commission": ABSENT_BUS_OPTION,
    "jog": ("thumb", "--angle", "10", *ABSENT_BUS_OPTION),
    "sim": ABSENT_BUS_OPTION,
    "demo": ("--lockstep",),
    "identify": ABSENT_BUS_OPTION,
    "replay drive": (str(GOLDEN_LOG), *ABSENT_BUS_OPTION),
    "scan": ABSENT_BUS_OPTION,
    "conformance": (
        "--protocol",
        "mit",
        "--node",
        "1",
        "--torque-limit-Nm",
        "0.1",
        *ABSENT_BUS_OPTION,
    ),
}


@pytest.mark.parametrize("verb", DRY_RUN_CASES)
def test_a_dry_run_opens_and_writes_nothing(work_folder, capsys, verb):
    words = (*verb.split(), *DRY_RUN_CASES[verb], "--dry-run")
    assert main(words) == 0
    assert capsys.readouterr().out
    code, printed_json = json_output(capsys, *words)
    assert code == 0
    assert printed_json
    assert not any(work_folder.iterdir())
    assert not any(os.scandir(os.environ["HANDCTL_RUN_DIR"]))


def test_a_dry_run_prints_the_gains(work_folder, capsys):
    Path("new.toml").write_text("schema = 1\n[motion]\nforce_N = 14\n")
    code, printed_json = json_output(
        capsys, "tune", "verify", "new.toml", "--lockstep", "--dry-run"
    )
    assert (code, printed_json["gains"]) == (0, "new.toml")


@pytest.fixture(scope="module")
def small_log(tmp_path_factory):
    """Return the path of a small log of a successful run."""
    from handctl.core.tick_types import TELEMETRY_AXES, HandMode, Telemetry, TickIn, TickOut
    from handctl.hand.hand_loading import load_hand
    from handctl.log.header import RunHeader
    from handctl.log.tick_packing import pack_tick_record
    from handctl.log.write.recorder import Recorder
    from handctl.safety.safety_action import SafetyAction

    hand = load_hand("jamia")
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    header = RunHeader.from_hand(hand.to_toml(), 2_000_000, offset_ns=0, deterministic=True)
    recorder = Recorder.start(path, header)
    random = np.random.default_rng(0)
    for k in range(3000):
        numbers = Telemetry(
            **{
                name: random.random(len(header.axis_names(axis)))
                for name, axis in TELEMETRY_AXES.items()
            }
        )
        out = TickOut((), HandMode.ACTIVE, "hold", SafetyAction.PASS, numbers, (), bytes(8))
        recorder.send_record(pack_tick_record(TickIn(k, k * 2_000_000), out))
    assert recorder.close("done")["complete"]
    return path


def test_log_info_counts_the_ticks_of_a_complete_log(small_log, capsys):
    code, printed_json = json_output(capsys, "log", "info", str(small_log))
    assert (code, printed_json["whole"], printed_json["ticks"]) == (0, True, 3000)
    assert main(["log", "info", str(small_log)]) == 0
    assert "3000" in capsys.readouterr().out


def test_log_info_prints_gains_only_if_asked_and_no_none(capsys):
    code, printed_json = json_output(capsys, "log", "info", str(GOLDEN_LOG))
    assert code == 0
    assert printed_json["gains"]
    assert main(["log", "info", str(GOLDEN_LOG)]) == 0
    text = capsys.readouterr().out
    assert "None" not in text
    assert "force_N" not in text
    assert main(["log", "info", str(GOLDEN_LOG), "-v"]) == 0
    assert "force_N" in capsys.readouterr().out


def test_a_truncated_log_is_reported_and_recovered(small_log, work_folder, capsys):
    data = small_log.read_bytes()
    (work_folder / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    code, printed_json = json_output(capsys, "log", "info", "cut.mcap")
    assert (code, printed_json["whole"]) == (3, False)
    assert 0 < printed_json["ticks"] < 3000
    code, result = json_output(capsys, "log", "recover", "cut.mcap")
    assert (code, result["status"]) == (3, "lossy")
    with RunLog(work_folder / "cut.recovered.mcap") as whole_log:
        assert not whole_log.warning
        assert len(whole_log) == printed_json["ticks"]


def test_a_complete_log_is_recovered_unchanged(small_log, work_folder, capsys):
    shutil.copy(small_log, "run.mcap")
    code, result = json_output(capsys, "log", "recover", "run.mcap", "--output", "new.mcap")
    assert (code, result["status"], result["lost"]) == (0, "whole", [])
    with RunLog(small_log) as small_run_log, RunLog(work_folder / "new.mcap") as recovered_log:
        assert np.array_equal(small_run_log.times, recovered_log.times)


def test_a_log_cut_before_its_first_chunk_cannot_be_recovered(small_log, work_folder, capsys):
    (work_folder / "head.mcap").write_bytes(small_log.read_bytes()[:64])
    code, result = json_output(capsys, "log", "recover", "head.mcap")
    assert (code, result["status"]) == (1, "nothing")
    assert not (work_folder / "head.recovered.mcap").exists()


@pytest.mark.parametrize("what", ["info", "recover"])
@pytest.mark.parametrize("content", [b"", b"garbage" * 1000, None])
def test_file_that_is_not_a_log_is_bad_input(work_folder, capsys, what, content):
    if content is not None:
        (work_folder / "x.mcap").write_bytes(content)
    assert main(["log", what, "x.mcap"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (work_folder / "x.recovered.mcap").exists()


def test_folder_is_refused_as_log(capsys):
    for log_command in ("info", "recover"):
        assert main(["log", log_command, "/"]) == 2
        assert capsys.readouterr().err == "handctl: /: not a file; expected a log\n"
