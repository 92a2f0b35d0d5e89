"""Test that texts from files, logs and arguments are escaped and shortened before they are printed on a terminal.

JSON output must be encoded in UTF-8.
"""

import io
import json
import os
import subprocess
import sys

import pytest

from handctl.cli.console.options import print_escaped, print_json
from handctl.cli.console.rich_console import rich_console
from handctl.cli.main import VERB_HELP, main
from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.errors import ConfigError
from handctl.hand.file.toml_text import toml_text
from handctl.hand.hand_loading import PACKAGED_HANDS_FOLDER, parse_toml
from handctl.printing import (
    MAX_MESSAGE_CHARACTERS,
    EscapedStream,
    escape_surrogates,
    escape_text,
    escaped_streams,
    one_line_message,
)
from tests.cli.command_refusals import refusal_line, refusal_lines

ESCAPE_SEQUENCES = "\x1b[2J\x1b]0;mine\x07\x9b31m\r\u202e\u2028\x7f"
TASKS_FOLDER = PACKAGED_HANDS_FOLDER.parents[1] / "tasks"


def is_printable_text(printed_text):
    return all(c.isprintable() or c in "\n\t" for c in printed_text)


def exit_code(command_words):
    """Run a command line and return its exit code, even if argparse refuses the command line."""
    try:
        return main(command_words)
    except SystemExit as ended:
        return ended.code


def test_unprintable_characters_are_escaped():
    assert escape_text("a\x1b[2J\nb\u00e4\u03b8") == "a\\x1b[2J\\nb\u00e4\u03b8"
    assert escape_text("a\nb\x07", "\n") == "a\nb\\x07"
    assert escape_text(ESCAPE_SEQUENCES).isprintable()
    assert escape_text("\ud800") == "\\ud800"
    assert escape_surrogates("a\udcff\x1b").encode() == b"a\\udcff\x1b"


@pytest.mark.parametrize("text_length", [499, 500, 501, 2000, 100_000])
@pytest.mark.parametrize("repeated_letter", ["x", "\x1b"])
def test_a_message_keeps_its_beginning_and_its_end(text_length, repeated_letter):
    line = one_line_message("what" + repeated_letter * (text_length - 8) + "right\n"[:4])
    assert len(line) <= MAX_MESSAGE_CHARACTERS
    assert line.startswith("what")
    assert line.endswith("righ")
    assert line.isprintable()
    assert ("[...]" in line) == (text_length > 500 or repeated_letter == "\x1b")


def test_an_error_is_one_harmless_line():
    line = str(ConfigError(f"{ESCAPE_SEQUENCES}\n" * 1000, "where", "this"))
    assert line.isprintable()
    assert len(line) <= MAX_MESSAGE_CHARACTERS
    assert line.startswith("where: ")
    assert line.endswith("; expected this")


def test_escaped_stream_escapes_every_writer(capsys):
    with escaped_streams():
        print(f"{ESCAPE_SEQUENCES}\tb\nc")
        print(ESCAPE_SEQUENCES, file=sys.stderr)
        sys.stdout.writelines([ESCAPE_SEQUENCES])
        inner = sys.stdout
        with escaped_streams():
            assert sys.stdout is inner, "a second context does not escape again"
    assert not isinstance(sys.stdout, EscapedStream)
    out, err = capsys.readouterr()
    assert out.startswith("\\x1b[2J")
    assert "\tb\nc\n" in out
    assert is_printable_text(out + err)


def test_a_table_of_rich_escapes_its_cells_and_keeps_its_own_codes(monkeypatch):
    from rich.table import Table
    from rich.text import Text

    table = Table(f"head{ESCAPE_SEQUENCES}")
    table.add_row(f"cell{ESCAPE_SEQUENCES}")
    table.add_row(Text(f"text{ESCAPE_SEQUENCES}"))
    console = rich_console(min_width=80)
    console.file = io.StringIO()
    console.print(table)
    console.print(f"line{ESCAPE_SEQUENCES}")
    assert is_printable_text(console.file.getvalue())
    assert console.file.getvalue().count("\\x1b[2J") == 4
    monkeypatch.setenv("FORCE_COLOR", "1")
    console = rich_console(min_width=80)
    console.file = io.StringIO()
    console.print(Text(f"red{ESCAPE_SEQUENCES}", style="red"))
    assert console.file.getvalue().startswith("\x1b[31m"), "codes of rich are not escaped"
    assert "red\\x1b[2J" in console.file.getvalue()


def test_rich_writes_its_codes_past_the_escaping_stream(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with escaped_streams():
        from rich.text import Text

        rich_console().print(Text("red\x1b[2J", style="red"))
    out, _ = capsys.readouterr()
    assert out.startswith("\x1b[31m")
    assert "\x1b[2J" not in out


def test_a_long_line_is_cut(capsys):
    print_escaped("a" * 2000)
    assert len(capsys.readouterr().out) <= MAX_MESSAGE_CHARACTERS + 1


@pytest.mark.parametrize("cli_verb", VERB_HELP)
def test_argparse_messages_are_escaped_and_shortened(capsys, cli_verb):
    for words in (
        [f"--no{ESCAPE_SEQUENCES}\n{'x' * 3000}"],
        [ESCAPE_SEQUENCES],
        [f"--gain{ESCAPE_SEQUENCES}=3"],
    ):
        assert exit_code([cli_verb, *words, "--no-such-option", ESCAPE_SEQUENCES]) == 2
        out, err = capsys.readouterr()
        assert is_printable_text(out + err)
        assert len(err.splitlines()[-1]) < MAX_MESSAGE_CHARACTERS + 60
    assert exit_code([ESCAPE_SEQUENCES]) == 2
    assert is_printable_text(capsys.readouterr().err)


TEXT_BY_MISTAKE = {
    "key": f"{json.dumps(ESCAPE_SEQUENCES)} = 3",
    "table": f"[{json.dumps(ESCAPE_SEQUENCES)}]",
    "value": f"schema = {json.dumps(ESCAPE_SEQUENCES)}",
    "list": f"schema = 1\nname = [{json.dumps(ESCAPE_SEQUENCES)}]",
    "long": f"schema = 1\n{'k' * 3000} = 3",
}
COMMAND_BY_FILE_KIND = {
    "hand": ("config", "check", "--hand", "odd.toml"),
    "task": ("config", "check", "--task", "odd.toml"),
    "gains": ("config", "check", "--gains", "odd.toml"),
    "calibration": ("config", "check", "--calibration", "odd.toml"),
    "trajectory": ("run", "--bus", "local:nobody", "--dry-run", "--trajectory", "odd.toml"),
    "limits": (
        "replay",
        "safety",
        str(PACKAGED_HANDS_FOLDER.parents[3] / "logs/golden/jamia-fault.mcap"),
        "--limits",
        "odd.toml",
    ),
}


@pytest.mark.parametrize("mistake_name", TEXT_BY_MISTAKE)
@pytest.mark.parametrize("file_kind", COMMAND_BY_FILE_KIND)
def test_texts_of_files_are_escaped_and_shortened(work_folder, capsys, file_kind, mistake_name):
    (work_folder / "odd.toml").write_text(TEXT_BY_MISTAKE[mistake_name])
    lines = refusal_lines(capsys, *COMMAND_BY_FILE_KIND[file_kind])
    assert len(lines) == 1 or file_kind == "hand"  # a hand file can cause several error lines
    for line in lines:
        assert line[:-1].isprintable()
        assert len(line) < MAX_MESSAGE_CHARACTERS + 20


def test_a_name_and_a_note_are_escaped_where_all_is_well(work_folder, capsys):
    task = (
        (TASKS_FOLDER / "grasp.toml")
        .read_text()
        .replace('name = "', f'name = "{json.dumps(ESCAPE_SEQUENCES)[1:-1]}', 1)
    )
    (work_folder / "odd.toml").write_text(task)
    (work_folder / "a\x1b[2J.toml").write_text("schema = 1\n[motion]\nforce_N = 12.0\n")
    for words in (
        ("config", "check", "--task", "odd.toml"),
        ("gains", "show", "--gains", "a\x1b[2J.toml"),
        ("gains", "apply", "a\x1b[2J.toml", "--note", ESCAPE_SEQUENCES),
        ("gains", "log"),
        ("gains", "show"),
        ("config", "show"),
    ):
        assert main(words) == 0, words
        out, err = capsys.readouterr()
        assert is_printable_text(out + err), words


WIDE_NUMBERS = {
    "hex": "0x" + "f" * 5000,
    "decimal": "9" * 5000,
    "65 bits": str(2**64),
    "in a list": f"[1, [{2**64}]]",
}
"""Integers with so many digits that Python refuses to print them, or outside the range of TOML."""


@pytest.mark.parametrize("number_kind", WIDE_NUMBERS)
@pytest.mark.parametrize("file_kind", COMMAND_BY_FILE_KIND)
def test_very_long_number_in_a_file_is_refused(work_folder, capsys, file_kind, number_kind):
    (work_folder / "odd.toml").write_text(f"schema = 1\nname = {WIDE_NUMBERS[number_kind]}\n")
    line = refusal_line(capsys, *COMMAND_BY_FILE_KIND[file_kind])
    assert "odd.toml" in line
    assert len(line) < MAX_MESSAGE_CHARACTERS


def test_the_largest_numbers_of_toml_are_read():
    content = {"a": 2**63 - 1, "b": [-(2**63) + 1]}
    assert parse_toml(toml_text(content), "here") == content


@pytest.mark.parametrize(
    "option_name",
    ["bus", "rate", "gain", "log", "hand", "jobs", "seed", "output", "wire", "perturb"],
)
@pytest.mark.parametrize(
    "cli_verb", ["run", "demo", "report", "fault", "tune", "identify", "scan", "sim"]
)
def test_double_dash_is_no_option_value(capsys, cli_verb, option_name):
    assert f"--{option_name}" in refusal_line(capsys, cli_verb, f"--{option_name}=--")


@pytest.mark.parametrize("log_name", [".", "", "/", ".."])
@pytest.mark.parametrize(
    "cli_verb",
    [
        ("report",),
        ("log", "export", "--csv"),
        ("log", "export", "--lerobot"),
        ("log", "recover"),
        ("log", "info"),
        ("replay", "execute", "--gains", "gains.toml"),
        ("view",),
    ],
    ids=" ".join,
)
def test_a_log_whose_name_is_a_folder(work_folder, capsys, cli_verb, log_name):
    (work_folder / "gains.toml").write_text("schema = 1\n")
    refusal_line(capsys, *cli_verb, log_name)


@pytest.mark.parametrize("node_text", ["9" * 50, "9" * 5000, "-1", "0.5", "1e99", "\x1b[2J"])
@pytest.mark.parametrize("drive_text", PROTOCOL_TRAITS)
def test_invalid_node_number_is_refused(capsys, drive_text, node_text):
    words = (
        "conformance",
        "--protocol",
        drive_text,
        f"--node={node_text}",
        "--bus",
        "local:nobody",
    )
    assert exit_code([*words, "--torque-limit-Nm", "0.1", "--dry-run"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert is_printable_text(err)
    assert len(err.splitlines()[-1]) < MAX_MESSAGE_CHARACTERS + 60


def test_a_pipe_without_a_reader_is_not_waited_for(work_folder, capsys):
    os.mkfifo(work_folder / "pipe")
    golden_log = PACKAGED_HANDS_FOLDER.parents[3] / "logs" / "golden" / "jamia-fault.mcap"
    assert "nobody reads" in refusal_line(capsys, "report", str(golden_log), "--output", "pipe")


def test_json_of_foreign_words_is_utf8_that_others_read(capsys):
    print_json({f"k{ESCAPE_SEQUENCES}\udcff": ["\ud800", ESCAPE_SEQUENCES, {"\udcff": "\x7f"}]})
    text = capsys.readouterr().out
    assert is_printable_text(text)
    content = json.loads(text)
    json.dumps(content, ensure_ascii=False).encode()
    assert ESCAPE_SEQUENCES in content[f"k{ESCAPE_SEQUENCES}\\udcff"], (
        "only surrogates are replaced"
    )


def test_a_note_of_bytes_that_are_no_text_is_kept_escaped(work_folder):
    (work_folder / "new.toml").write_text("schema = 1\n[motion]\nforce_N = 12.0\n")
    words = (
        sys.executable,
        "-m",
        "handctl.cli",
        "gains",
        "apply",
        "new.toml",
        "--note",
        b"n\xf6te\x1b",
    )
    assert subprocess.run(words, capture_output=True, check=False).returncode == 0
    words = (sys.executable, "-m", "handctl.cli", "gains", "log", "--json")
    done = subprocess.run(words, capture_output=True, check=True)
    assert "n\\udcf6te\x1b" in done.stdout.decode().replace("\\\\", "\\").replace("\\u001b", "\x1b")


def test_a_folder_whose_name_is_no_text(work_folder):
    folder = os.fsencode(work_folder) + b"/l\xf6g"
    os.mkdir(folder)
    words = (
        sys.executable,
        "-m",
        "handctl.cli",
        "config",
        "check",
        "--json",
        "--gains",
        b"l\xf6g/x\x1b.toml",
    )
    done = subprocess.run(words, capture_output=True, check=False)
    assert done.returncode == 2
    assert b"l\\udcf6g/x\\x1b.toml" in done.stderr


def test_a_refusal_of_the_simulator_is_reported_without_its_class(work_folder, capsys):
    (work_folder / "odd.toml").write_text('name = "x"\n[object]\nshape = "\\u001b[2J\\n"\n')
    for words in (
        ("demo", "--lockstep", "--scene", "odd.toml"),
        ("demo", "--lockstep", "--scene", ESCAPE_SEQUENCES),
    ):
        line = refusal_line(capsys, *words)
        assert "firmware_sim" not in line
        assert ":Rig" not in line
        assert line[:-1].isprintable()


FORGED_LINE = "\nFORGED"


@pytest.mark.parametrize(
    "command_words",
    [
        ("gains", "show", "--gains", "g.toml"),
        ("gains", "apply", "g.toml"),
        ("gains", "log"),
        ("gains", "show"),
        ("config", "check", "--gains", "g.toml"),
    ],
)
def test_a_line_end_in_a_file_makes_no_second_line(work_folder, capsys, command_words):
    forged_lines = "".join(
        f"{key} = {json.dumps(key + FORGED_LINE)}\n"
        for key in ("note", "made", "version", "fit", "study")
    )
    text = (
        "schema = 1\n[motion]\nforce_N = 12.0\n[provenance]\nhand = 'jamia'\n"
        f"log = [{json.dumps(FORGED_LINE)}]\n{forged_lines}"
    )
    (work_folder / "g.toml").write_text(text)
    if command_words in (("gains", "log"), ("gains", "show")):
        assert main(["gains", "apply", "g.toml"]) == 0
    assert main(list(command_words)) == 0
    out, err = capsys.readouterr()
    assert not [line for line in (out + err).splitlines() if line.startswith("FORGED")]


@pytest.mark.parametrize(
    "command_words",
    [
        ("sim", "--bus", f"local:x{FORGED_LINE}", "--dry-run"),
        ("bus", "doctor", "--bus", f"local:x{FORGED_LINE}"),
        ("demo", "--lockstep", "--dry-run", "--log", f"a{FORGED_LINE}.mcap"),
        ("gains", "apply", "g.toml", "--note", f"x{FORGED_LINE}"),
        (f"x{FORGED_LINE}",),
    ],
)
def test_a_line_end_in_an_argument_is_refused(capsys, command_words):
    assert main(command_words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "a word with a line end in it" in err
    assert "\\nFORGED" in err


def test_the_simulator_refuses_a_line_end_in_an_argument(capsys):
    from firmware_sim.__main__ import main as simulate

    assert simulate(["--hand", f"x{FORGED_LINE}", "--bus", "local:x"]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "\\nFORGED" in err
