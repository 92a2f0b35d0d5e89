"""Test the command line: help, suggestions after typing errors, renamed options, shell completion, and verbosity."""

import argparse
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from handctl.cli.main import VERB_GROUPS, VERB_HELP, main, verb_parser
from handctl.cli.parsing.parser import VerbParser
from handctl.cli.parsing.renamed_options import RENAMED_OPTIONS
from handctl.core.gains.gain_bounds import gain_bounds
from handctl.session.exit_codes import ExitCode
from tests.cli.command_refusals import refusal_line

COMMAND_LINE_PAGE = Path(__file__).parents[2] / "docs" / "reference" / "command-line.md"
OTHER_NAMES_OF_OPTION = {
    "--output": {"--out", "--write-to", "--report"},
    "--perturb": {"--vary", "--perturbation"},
    "--protocol": {"--drive", "--protocols"},
    "--jobs": {"--workers", "--processes"},
    "--picture": {"--png"},
    "--calibration": {"--fit"},
}
"""For each option that several commands share: other names that no command is allowed to use for the same option."""


def sub_parsers(parser: VerbParser) -> dict[str, VerbParser]:
    """Return the parsers of all sub-commands of a command, by name."""
    actions = [
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    ]
    return dict(actions[0].choices) if actions else {}


def leaf_parsers() -> dict[str, VerbParser]:
    """Return a dictionary from the words of each command, such as ``config init``, to its parser.

    The dictionary does not contain commands that have sub-commands.
    """
    parser_by_words = {}
    for verb in VERB_HELP:
        parser = verb_parser(verb)
        parser_by_subcommand = {
            f"{verb} {name}": sub_parser for name, sub_parser in sub_parsers(parser).items()
        }
        parser_by_words.update(parser_by_subcommand or {verb: parser})
    return parser_by_words


def test_help_shows_21_verbs_in_groups(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    lines = capsys.readouterr().out.splitlines()
    assert len(VERB_HELP) == 21
    assert all(any(line.startswith(f"  {verb:<11} ") for line in lines) for verb in VERB_HELP)
    assert all(f"{group.title}:" in lines for group in VERB_GROUPS.values())
    assert lines[-1] == "  handctl demo --lockstep"


def test_help_names_every_exit_code(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    named_codes = re.findall(r"(\d+) [a-z]", capsys.readouterr().out.split("exit codes:")[1])
    assert {int(code) for code in named_codes} == set(ExitCode)


@pytest.mark.parametrize("command_words", sorted({*VERB_HELP, *leaf_parsers()}))
def test_every_help_ends_with_an_example_of_its_verb(capsys, command_words):
    with pytest.raises(SystemExit) as ended:
        main([*command_words.split(), "--help"])
    assert ended.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert f"handctl {command_words} " in f"{lines[-1]} "
    assert lines[-2] == "example:"


@pytest.mark.parametrize("command_words", sorted(leaf_parsers()))
def test_every_verb_has_verbose_and_quiet_and_one_name_for_one_thing(command_words):
    options = set(leaf_parsers()[command_words]._option_string_actions)
    assert {"-v", "--verbose", "-q", "--quiet"} <= options
    for name, unused_names in OTHER_NAMES_OF_OPTION.items():
        assert not options & unused_names, f"{command_words}: {name} is the name"


@pytest.mark.parametrize(
    ("command_words", "suggested_word"),
    [
        ("dmeo", "unknown verb 'dmeo', did you mean demo?"),
        ("demo --lockstepp", "demo: unknown option '--lockstepp', did you mean --lockstep?"),
        ("run --trajectry x", "run: unknown option '--trajectry', did you mean --trajectory?"),
        ("tune serach", "did you mean search?"),
        (
            "tune design --plnats=3",
            "tune design: unknown option '--plnats', did you mean --plants?",
        ),
        ("demo --protocol odriv", "did you mean odrive?"),
        ("config show list", "config show: unknown argument 'list'"),
    ],
)
def test_a_misspelt_word_is_answered_with_the_nearest_one(capsys, command_words, suggested_word):
    assert suggested_word in refusal_line(capsys, *command_words.split())


RENAMED_OPTION_ROWS = [
    (verb, old_name, new_name)
    for verb, options in RENAMED_OPTIONS.items()
    for old_name, new_name in options.items()
]


@pytest.mark.parametrize(
    ("cli_verb", "old_option", "new_option"),
    RENAMED_OPTION_ROWS,
    ids=[f"{verb} {old_name}" for verb, old_name, _ in RENAMED_OPTION_ROWS],
)
def test_an_old_spelling_is_refused_and_names_the_new_one(capsys, cli_verb, old_option, new_option):
    assert new_option in leaf_parsers()[cli_verb]._option_string_actions
    for words in ([old_option, "x"], [f"{old_option}=x"]):
        line = refusal_line(capsys, *cli_verb.split(), *words)
        assert (
            line == f"handctl: {cli_verb}: {old_option} has been renamed; expected {new_option}\n"
        )


def test_the_document_lists_the_renamed_options():
    rows = re.findall(
        r"^\| `([a-z ]+)` \| `(--[a-z-]+)` \| `(--[a-z-]+)` \|",
        COMMAND_LINE_PAGE.read_text(),
        re.MULTILINE,
    )
    assert sorted(rows) == sorted(RENAMED_OPTION_ROWS)


def shell_completions(tmp_path, unfinished_line):
    """Return the completions that a shell offers for an unfinished command line."""
    answer = tmp_path / "answer"
    environment = os.environ | {
        "_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "COMP_LINE": unfinished_line, "COMP_POINT": str(len(unfinished_line)),
    }  # fmt: skip
    code = "import sys; sys.argv[0] = 'handctl'; from handctl.cli.main import main; main()"
    subprocess.run([sys.executable, "-c", code], env=environment, check=True, timeout=60)
    return [word.strip() for word in answer.read_text().split("\n")]


@pytest.mark.parametrize(
    ("unfinished_line", "expected_completions"),
    [
        ("handctl de", ["demo"]),
        ("handctl tune ver", ["verify"]),
        ("handctl tune design --pla", ["--plants"]),
        ("handctl demo --protocol od", ["odrive"]),
        ("handctl demo --hand jamia1", ["jamia11"]),
    ],
)
def test_a_shell_completes_verbs_options_and_hands(tmp_path, unfinished_line, expected_completions):
    assert shell_completions(tmp_path, unfinished_line) == expected_completions


def test_verbose_adds_details_on_standard_error_and_leaves_the_result(capsys):
    assert main(["config", "list"]) == 0
    plain_output = capsys.readouterr()
    for words in (["config", "list", "-v"], ["-v", "config", "list"], ["config", "-v", "list"]):
        assert main(words) == 0
        out, err = capsys.readouterr()
        assert (out, plain_output.err) == (plain_output.out, "")
        assert "exit code 0 after" in err


def test_verbose_names_the_files_behind_a_run(work_folder, capsys):
    assert main(["demo", "--lockstep", "--dry-run", "-v"]) == 0
    err = capsys.readouterr().err
    assert "hand: jamia from jamia, identity" in err
    assert "bus load" in err


def test_verbose_and_quiet_exclude_each_other(capsys):
    assert "not allowed with" in refusal_line(capsys, "-v", "demo", "-q")


def test_quiet_leaves_the_findings_that_need_a_repair(capsys, monkeypatch):
    from handctl.cli.checks import doctor

    # Replace the measurement of late wake-ups by a fixed result. Two measurements on the same
    # computer would give different delays, and the command would print different lines.
    finding = doctor._check_wakeups()
    monkeypatch.setattr(doctor, "_check_wakeups", lambda: finding)
    main(["doctor"])
    lines = capsys.readouterr().out.splitlines()
    main(["doctor", "--quiet"])
    quiet = capsys.readouterr().out.splitlines()
    assert quiet == [line for line in lines if not line.startswith("ok ")]


def test_quiet_hides_notices_and_shows_cautions(capsys):
    from handctl.cli.console.plan import print_notice
    from handctl.cli.console.verbosity import apply_verbosity

    with apply_verbosity(argparse.Namespace(quiet=True)):
        print_notice("commissioning jamia first")
        print_notice("handctl: caution: hot")
    assert capsys.readouterr() == ("", "handctl: caution: hot\n")


def test_a_command_prints_each_caution_once(capsys):
    """Reproduce a defect: ``run`` printed all cautions twice if it commissioned the hand before the task."""
    from handctl.cli.console.plan import print_notice
    from handctl.cli.console.verbosity import apply_verbosity

    for _ in range(2):
        with apply_verbosity(argparse.Namespace()):
            for text in ("hot", "cold", "hot"):
                print_notice(f"handctl: caution: {text}")
        assert capsys.readouterr().err == "handctl: caution: hot\nhandctl: caution: cold\n"


@pytest.mark.parametrize("is_ready", [True, False])
def test_the_doctor_fails_if_something_needs_a_repair(monkeypatch, capsys, is_ready):
    from handctl.cli.checks import doctor

    for name in (
        "_check_priority",
        "_check_locked_memory",
        "_check_wakeups",
        "_check_socketcan",
        "_check_interfaces",
        "_check_vulkan",
        "_optional_package_finding",
        "_check_disk_space",
    ):
        monkeypatch.setattr(doctor, name, lambda: ("a part", True, ""))
    monkeypatch.setattr(
        doctor, "_check_locked_memory", lambda: ("locked memory", is_ready, "allow it")
    )
    assert main(["doctor"]) == (0 if is_ready else 1)
    assert main(["doctor", "--json"]) == (0 if is_ready else 1)


@pytest.mark.parametrize(
    ("late_s", "stolen_ticks", "is_ready", "expected_message"),
    [
        (0.0005, 0, True, "0.5 ms late in 1 s"),
        (0.005, 30, False, "5.0 ms late in 1 s, a hypervisor took 15.0 %"),
    ],
)
def test_the_doctor_measures_wake_ups(
    monkeypatch, late_s, stolen_ticks, is_ready, expected_message
):
    from handctl.cli.checks import doctor

    now, ticks = [0.0], iter([(1000, 10), (1200, 10 + stolen_ticks)])
    monkeypatch.setattr(time, "monotonic_ns", lambda: round(now[0] * 1e9))
    monkeypatch.setattr(time, "sleep", lambda s: now.__setitem__(0, now[0] + s + late_s))
    monkeypatch.setattr(doctor, "_cpu_and_steal_ticks", lambda: next(ticks))
    message, is_good, fix = doctor._check_wakeups()
    assert (expected_message in message, is_good) == (True, is_ready)
    assert "--time-scale" in fix


def test_the_time_of_all_cores_contains_the_stolen_part():
    from handctl.cli.checks.doctor import _cpu_and_steal_ticks

    total, stolen = _cpu_and_steal_ticks()
    assert total >= stolen >= 0


def test_each_gain_is_shown_with_meaning_and_bounds(capsys):
    assert main(["gains", "show"]) == 0
    lines = capsys.readouterr().out.splitlines()[1:]
    assert len(lines) == 2 * len(gain_bounds())
    for key, text in zip(lines[::2], lines[1::2], strict=True):
        gain = gain_bounds()[key.split()[0]]
        assert gain.meaning
        assert text.startswith(f"    {gain.meaning.splitlines()[0]} ")
        assert f"at most {gain.high:g}" in text
    assert main(["gains", "show", "-q"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(gain_bounds())


def test_a_gain_with_a_unit_in_its_name_tells_the_unit():
    for key, gain in gain_bounds().items():
        if re.search(r"_(N|m|s|m_s|N_per_s|per_s)$", key):
            assert re.search(r"\[[^\]]+\]\.", gain.meaning.splitlines()[0]), key


def test_a_line_of_a_run_names_the_tendons(capsys, monkeypatch):
    import io
    import json

    from handctl.cli.console import display

    head = {
        "names": ["thumb_tendon", "index_tendon"],
        "ceiling": [80.0, 80.0],
        "rate_hz": 500.0,
        "load": 0.4,
    }
    line = {
        "k": 0,
        "t": 1.0,
        "mode": "ACTIVE",
        "phase": "hold",
        "tension": [3.0, 12.25],
        "events": [],
    }
    monkeypatch.setattr(sys, "stdin", io.StringIO(json.dumps(line) + "\n"))
    display._print_lines(head)
    assert capsys.readouterr().out.endswith("tension [N]  thumb 3.0  index 12.2\n")


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "handctl", "--version"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count(".") == 2
