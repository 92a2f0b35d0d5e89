"""Test that every command prints one error line and exits with code 2 for an invalid file or number."""

import json
import os

import pytest

from handctl.cli.main import main
from handctl.hand.hand_loading import PACKAGED_HANDS_FOLDER
from tests.cli.command_refusals import refusal_line

ABSENT_BUS_OPTION = ("--bus", "local:nobody")


def make_pipe(pipe_path):
    os.mkfifo(pipe_path)


def make_folder(folder_path):
    folder_path.mkdir()


def write_endless_number(file_path):
    file_path.write_text("schema = " + "9" * 5000)


def write_endless_nesting(file_path):
    file_path.write_text("a = " + "[" * 3000 + "]" * 3000)


def make_link_loop(link_path):
    link_path.symlink_to(link_path.name)


COMMAND_BY_FILE_KIND = {
    "hand": ("config", "check", "--hand", "odd"),
    "task": ("config", "check", "--task", "odd"),
    "gains": ("config", "check", "--gains", "odd"),
    "calibration": ("config", "check", "--calibration", "odd"),
    "trajectory": ("run", *ABSENT_BUS_OPTION, "--trajectory", "odd"),
    "candidate": ("tune", "verify", "odd", "--lockstep", "--dry-run"),
    "scene": ("demo", "--lockstep", "--dry-run", "--scene", "odd.toml"),
    "log": ("log", "info", "odd"),
}


@pytest.mark.parametrize(
    "create_unreadable_file",
    [make_pipe, make_folder, write_endless_number, write_endless_nesting],
    ids=lambda f: f.__name__,
)
@pytest.mark.parametrize("file_kind", COMMAND_BY_FILE_KIND)
def test_unreadable_file_is_refused_in_one_line(
    work_folder, capsys, file_kind, create_unreadable_file
):
    create_unreadable_file(work_folder / "odd")
    (work_folder / "odd.toml").symlink_to("odd")
    assert "odd" in refusal_line(capsys, *COMMAND_BY_FILE_KIND[file_kind])


def test_a_truth_that_is_a_pipe_is_not_waited_for(work_folder, capsys):
    make_pipe(work_folder / "truth")
    golden = PACKAGED_HANDS_FOLDER.parents[3] / "logs" / "golden" / "jamia-fault.mcap"
    assert "not a file" in refusal_line(capsys, "report", str(golden), "--truth", "truth")


def test_a_truth_file_of_another_run_is_refused(work_folder, capsys):
    golden = PACKAGED_HANDS_FOLDER.parents[3] / "logs" / "golden" / "jamia-fault.mcap"
    header = {"columns": ["q/index_j1"]}
    row = (10**13).to_bytes(8, "little") + bytes(8)
    (work_folder / "run.truth").write_bytes(json.dumps(header).encode() + b"\n" + row)
    assert "at another time" in refusal_line(
        capsys, "report", str(golden), "--truth", "run.truth", "--output", "x.html"
    )
    assert not (work_folder / "x.html").exists()


@pytest.mark.parametrize("file_name", ["n" * 300, "odd/x", "loop"])
@pytest.mark.parametrize(
    "file_kind", [file_kind for file_kind in COMMAND_BY_FILE_KIND if file_kind != "scene"]
)
def test_impossible_file_name_is_refused(work_folder, capsys, file_kind, file_name):
    (work_folder / "odd").write_text("")
    make_link_loop(work_folder / "loop")
    refusal_line(
        capsys, *(word.replace("odd", file_name) for word in COMMAND_BY_FILE_KIND[file_kind])
    )


def test_a_name_with_nul_is_refused(capsys):
    for words in COMMAND_BY_FILE_KIND.values():
        assert "NUL" in refusal_line(capsys, *(word.replace("odd", "o\0d") for word in words))


WRONG_NUMBER_COMMANDS = [
    ("tune", "design", "--rate=nan"),
    ("tune", "design", "--rate=inf"),
    ("tune", "design", "--rate=0"),
    ("tune", "design", "--rate=1"),
    ("tune", "search", "--rate=-1"),
    ("tune", "design", "--seed=-1"),
    ("tune", "search", "--seed=-1"),
    ("tune", "design", "--plants=1", "--poles-Hz=0,0"),
    ("tune", "design", "--plants=1", "--poles-Hz=nan,25"),
    ("tune", "design", "--plants=1", "--poles-Hz=6,2500"),
    ("tune", "design", "--plants=1", "--poles-Hz=6,25", "--damping=1e308"),
    ("tune", "design", "--plants=1", "--poles-Hz=6,25", "--damping=nan"),
    ("fault", "campaign", "--calm=inf"),
    ("fault", "campaign", "--calm=nan"),
    ("fault", "campaign", "--calm=-1"),
    ("fault", "sequences", "--count=0"),
    ("fault", "sequences", "--seed=-1"),
    ("fault", "sequences", "--jobs=0"),
    ("gains", "show", "--gain", "tension.force_N=3", "--gain=tension.force_N=4"),
    ("replay", "execute", "no.mcap", "--within=nan"),
    ("replay", "execute", "no.mcap", "--within=-1"),
]


@pytest.mark.parametrize("command_words", WRONG_NUMBER_COMMANDS, ids=" ".join)
def test_invalid_number_is_refused(capsys, command_words):
    assert command_words[-1].partition("=")[0] in refusal_line(capsys, *command_words)


def test_campaign_of_rows_without_scenarios_is_refused(capsys):
    """`handctl campaign` must not report success if no scenario was executed.

    The fault N09 (the temperature of a drive) has no scenario for CiA 402 drives, because CiA 402
    drives report no temperature.
    """
    words = (
        "fault",
        "campaign",
        "--protocol",
        "cia402",
        "--calm",
        "0",
        "--row",
        "N08",
        "--row",
        "N09",
    )
    assert "'N09'" in refusal_line(capsys, *words)


def test_very_long_drive_option_is_refused(capsys):
    words = (
        "--protocol",
        "odrive",
        "--node",
        "1",
        "--bus",
        "local:nobody",
        "--torque-limit-Nm",
        "0.1",
        "--dry-run",
    )
    assert "--option" in refusal_line(
        capsys, "conformance", *words, "--option", "gear_ratio=" + "9" * 5000
    )


@pytest.mark.parametrize("bit_rate", ["-1", "0", "9" * 30])
@pytest.mark.parametrize("option_name", ["--bitrate", "--data-bitrate"])
@pytest.mark.parametrize("cli_verb", [("bus", "doctor"), ("scan",)], ids=" ".join)
def test_impossible_bit_rate_is_refused(capsys, cli_verb, option_name, bit_rate):
    assert "expected 10000 to 8000000" in refusal_line(
        capsys, *cli_verb, *ABSENT_BUS_OPTION, f"{option_name}={bit_rate}"
    )


def test_an_unknown_perturbation_is_refused_before_the_run(capsys):
    refusal_line(capsys, "identify", "--lockstep", "--digits", "thumb", "--perturb", "luck=2")


@pytest.mark.parametrize("cli_verb", [("identify",), ("tune", "verify", "new.toml")], ids=" ".join)
@pytest.mark.parametrize(
    "command_words",
    [
        ("--lockstep", "--perturb", "stiffness=nan"),
        (*ABSENT_BUS_OPTION, "--perturb", "stiffness=2"),
    ],
)
def test_perturbation_without_a_simulated_hand_is_refused(
    work_folder, capsys, cli_verb, command_words
):
    (work_folder / "new.toml").write_text("schema = 1\n")
    assert "--perturb" in refusal_line(capsys, *cli_verb, *command_words, "--dry-run")


WRONG_BUS_SPECS = ["x", ":x", "local:", "local:../x", "local:a/b", "local:.x", "socketcan:", ""]


@pytest.mark.parametrize("bus", WRONG_BUS_SPECS)
def test_invalid_bus_is_refused_before_the_run(work_folder, capsys, bus):
    drive = ("--protocol", "mit", "--node", "1", "--torque-limit-Nm", "0.1")
    for words in (
        ("run", "--task", "grasp.toml"),
        ("scan",),
        ("jog", "index", "--angle", "3"),
        ("bus", "doctor"),
    ):
        assert main([*words, "--bus", bus]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.splitlines()[-1].startswith("handctl: ")
        assert "commissioning" not in err
    assert main(["conformance", *drive, "--yes", "--bus", bus]) == 2
    capsys.readouterr()
    fault = ("fault", "inject", "drop node=3")
    for words in (
        ("stop",),
        ("clear",),
        ("gains", "set", "motion.force_N=20"),
        ("fault", "list"),
        fault,
    ):
        refusal_line(capsys, *words, "--bus", bus)
    for words in (("scan",), ("sim",), ("conformance", *drive)):
        refusal_line(capsys, *words, "--dry-run", "--bus", bus)
    assert list(work_folder.iterdir()) == []


@pytest.mark.parametrize(
    "bus", ["local:" + "n" * 300, "socketcan:nosuch", "nosuch:x", "slcan:/dev/nosuch"]
)
def test_missing_bus_ends_with_exit_code_1(capsys, bus):
    assert main(["scan", "--bus", bus]) == 1
    err = capsys.readouterr().err
    assert err.startswith("handctl: ")
    assert err.count("\n") == 1, err


@pytest.mark.parametrize("bus", ["main=virtual:x=y", "virtual:x=y"])
def test_unconfirmed_request_names_the_bus_without_its_hand_name(capsys, bus):
    for words in (("stop",), ("clear",), ("gains", "set", "motion.force_N=20")):
        assert main([*words, "--bus", bus]) == 71
        assert "bus virtual:x=y: " in capsys.readouterr().err


def test_buses_are_named_alike_in_every_verb(capsys):
    for words in (("stop",), ("scan",), ("bus", "doctor")):
        assert main([*words, "--bus", "main=local:nobody"]) == 1
        out, err = capsys.readouterr()
        assert "local:nobody" in out + err
        assert "main=local:nobody" not in out + err
        refusal_line(capsys, *words, "--bus", "no name=local:nobody")


def test_deleted_working_folder_is_one_line(work_folder, monkeypatch, capsys):
    (work_folder / "gone").mkdir()
    monkeypatch.chdir("gone")
    (work_folder / "gone").rmdir()
    for words in (("demo", "--lockstep"), ("doctor",), ("config", "show")):
        assert "folder" in refusal_line(capsys, *words) or words[0] == "demo"
