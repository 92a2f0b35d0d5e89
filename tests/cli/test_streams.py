"""Test commands with a faulty standard stream, and commands that get a signal of the operating system.

A standard stream is faulty if it is a closed pipe, writes to a full disk, or is missing.
"""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import closing

import pytest

from handctl.cli.console.process_termination import TerminationRequested, terminate_on_signals
from handctl.cli.console.rich_console import rich_console
from handctl.cli.main import main
from handctl.paper.bench.worker_pool import worker_pool
from handctl.tune.search.workers import ProcessPool

VERSION_COMMAND = (sys.executable, "-m", "handctl.cli", "--version")
BUFFERED_OUTPUT_ENVIRONMENT = {
    key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"
}


def run_in_shell(redirections, command_words=VERSION_COMMAND, **environment):
    """Run a command in a shell with redirected streams.

    Return the exit code, the output and the errors of the command.
    """
    command = ["sh", "-c", f'exec "$0" "$@" {redirections}', *command_words]
    result = subprocess.run(
        command,
        env=BUFFERED_OUTPUT_ENVIRONMENT | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return result.returncode, result.stdout, result.stderr


@pytest.mark.parametrize("with_unbuffered_output", ["", "1"])
def test_a_full_disk_for_the_output_is_one_line(with_unbuffered_output):
    code, _, err = run_in_shell("> /dev/full", PYTHONUNBUFFERED=with_unbuffered_output)
    assert code == 1
    assert err.startswith("handctl: ")
    assert err.endswith("No space left on device\n")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "cli_verb", [("config", "list"), ("paper", "--quick")]
)  # the first command prints plain text, and the second one prints a table of the package rich
def test_output_without_a_reader_is_no_error(cli_verb):
    read, write = os.pipe()
    os.close(read)
    command = (sys.executable, "-m", "handctl.cli", *cli_verb)
    result = subprocess.run(
        command, env=BUFFERED_OUTPUT_ENVIRONMENT, stdout=write, stderr=subprocess.PIPE, check=False
    )
    os.close(write)
    assert (result.returncode, result.stderr) == (0, b"")


def test_progress_without_a_reader_does_not_end_the_verb(monkeypatch):
    def raise_broken_pipe(text):
        raise BrokenPipeError

    monkeypatch.setattr("sys.stderr.write", raise_broken_pipe)
    console = rich_console(error=True)
    console.print("half of it")
    console.print("the rest")


def test_a_narrow_terminal_shows_a_whole_table(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "40")
    assert main(["paper", "--quick"]) == 0
    assert "3 + 3 + 3 + 2 joints." in capsys.readouterr().out


def test_the_name_of_a_file_is_no_markup(capsys):
    rich_console().print("log: [bold]/x[/y]:warning:.mcap")
    assert capsys.readouterr().out == "log: [bold]/x[/y]:warning:.mcap\n"


@pytest.mark.parametrize("closed_streams", [">&-", "<&-", "2>&-", ">&- 2>&- <&-"])
def test_closed_streams_are_no_error(closed_streams):
    code, _, err = run_in_shell(closed_streams)
    assert (code, err) == (0, "")


def test_characters_that_a_terminal_cannot_show_are_escaped(work_folder):
    words = (sys.executable, "-m", "handctl.cli", "log", "info", "h\u00e4nd\udcff.mcap")
    code, _, err = run_in_shell("", words, PYTHONIOENCODING="ascii")
    assert code == 2
    assert "h\\xe4nd" in err
    words = (sys.executable, "-m", "handctl.cli", "sim", "--bus", "local:\u00e4\udcff", "--dry-run")
    code, out, err = run_in_shell("", words, PYTHONIOENCODING="ascii")
    assert (code, err) == (0, "")
    assert "\\xe4\\udcff" in out


@pytest.mark.parametrize(
    ("signal_number", "exit_code"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 143)],
)
def test_a_signal_ends_a_verb_with_a_line_and_its_code(
    capsys, monkeypatch, signal_number, exit_code
):
    handlers = {
        handled_signal: signal.getsignal(handled_signal)
        for handled_signal in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }

    def send_signal(args):
        os.kill(os.getpid(), signal_number)
        raise AssertionError("the signal was not felt")

    monkeypatch.setattr("handctl.cli.checks.config.run", send_signal)
    assert main(["config", "list"]) == exit_code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("handctl: ")
    assert err.count("\n") == 1
    assert {handler: signal.getsignal(handler) for handler in handlers} == handlers


def test_signal_ignored_through_nohup_stays_ignored():
    signal_before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with terminate_on_signals():
            os.kill(os.getpid(), signal.SIGHUP)
            with pytest.raises(TerminationRequested):
                os.kill(os.getpid(), signal.SIGTERM)
    finally:
        signal.signal(signal.SIGHUP, signal_before)


def test_a_run_in_lockstep_that_is_interrupted_keeps_its_log(work_folder, monkeypatch, capsys):
    def interrupt_at_tick_100(entry, out):
        if entry.k == 100:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("handctl.session.run._ignore_tick", interrupt_at_tick_100)
    assert main(["demo", "--lockstep", "--scene", "none", "--log", "run.mcap", "--json"]) == 130
    assert json.loads(capsys.readouterr().out) == {"error": "interrupted", "exit_code": 130}
    assert main(["log", "info", "run.commission.mcap", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["ticks"] >= 100
    assert result["end"]["reason"] == "interrupted"


def test_an_interrupted_search_names_the_study_to_continue(monkeypatch, capsys):
    def send_termination(*words):
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr("handctl.tune.search.gain_search.run_search", send_termination)
    monkeypatch.setattr("handctl.cli.tuning.tune_search._designed_gains", lambda *words: ())
    assert main(["tune", "search", "--plants", "1", "--json"]) == 143
    out, err = capsys.readouterr()
    text = "interrupted; the same command continues with jamia.study"
    assert json.loads(out) == {"error": text, "exit_code": 143}
    assert err == f"handctl: {text}\n"


@pytest.mark.parametrize(
    "start_workers",
    [lambda: closing(ProcessPool(1)), lambda: worker_pool(1, print)],
    ids=["search", "paper"],
)
def test_workers_ignore_the_ctrl_c_of_a_terminal(monkeypatch, start_workers):
    children = []
    begin = subprocess.Popen

    def started(*words, **options):
        children.append(begin(*words, **options))
        return children[-1]

    monkeypatch.setattr("subprocess.Popen", started)
    with start_workers():
        assert (
            [os.getsid(child.pid) for child in children] == [child.pid for child in children] != []
        )


def test_a_worker_of_the_paper_leaves_no_folder(work_folder):
    command = [sys.executable, "-m", "handctl.paper.bench.worker"]
    worker = subprocess.Popen(
        command, env=os.environ | {"TMPDIR": str(work_folder)}, stdin=subprocess.PIPE, stderr=-1
    )
    while not list(work_folder.glob("handctl-paper-*")):
        assert worker.poll() is None
        time.sleep(0.02)
    worker.send_signal(signal.SIGINT)
    worker.terminate()
    assert worker.communicate()[1] == b""
    assert list(work_folder.iterdir()) == []


BUGGY_PROGRAM = """
import atexit, sys
import handctl.cli.checks.doctor
from handctl.cli.main import main
handctl.cli.checks.doctor.run = lambda args: atexit.register(print, "put away") and {}["nobody thought of this"]
sys.argv = ["handctl", "doctor"]
sys.exit(main())
"""


def test_a_bug_in_handctl_is_shown_with_traceback_and_its_own_exit_code():
    ended = subprocess.run([sys.executable, "-c", BUGGY_PROGRAM], capture_output=True, text=True)
    assert ended.returncode == 70
    assert "KeyError: 'nobody thought of this'" in ended.stderr
    assert (
        ended.stderr.splitlines()[-1]
        == "handctl: this is a bug in handctl; the traceback above shows the place"
    )
    assert ended.stdout == "put away\n"
