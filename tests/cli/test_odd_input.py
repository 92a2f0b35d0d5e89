"""Files that are none and numbers that are none: one line, exit code 2, for every verb that takes them."""

import json
import os

import pytest

from handctl.cli.main import main
from handctl.hand.load import HANDS
from tests.cli.refused import refused

BUS = ("--bus", "local:nobody")


def a_pipe(path):
    os.mkfifo(path)


def a_folder(path):
    path.mkdir()


def a_number_without_end(path):
    path.write_text("schema = " + "9" * 5000)


def nested_without_end(path):
    path.write_text("a = " + "[" * 3000 + "]" * 3000)


def a_loop(path):
    path.symlink_to(path.name)


READS = {
    "hand": ("config", "check", "--hand", "odd"),
    "task": ("config", "check", "--task", "odd"),
    "gains": ("config", "check", "--gains", "odd"),
    "calibration": ("config", "check", "--calibration", "odd"),
    "trajectory": ("run", *BUS, "--trajectory", "odd"),
    "candidate": ("tune", "verify", "odd", "--lockstep", "--dry-run"),
    "scene": ("demo", "--lockstep", "--dry-run", "--scene", "odd.toml"),
    "log": ("log", "info", "odd"),
}


@pytest.mark.parametrize("make", [a_pipe, a_folder, a_number_without_end, nested_without_end], ids=lambda f: f.__name__)
@pytest.mark.parametrize("what", READS)
def test_a_file_that_is_none(place, capsys, what, make):
    make(place / "odd")
    (place / "odd.toml").symlink_to("odd")
    assert "odd" in refused(capsys, *READS[what])


def test_a_truth_that_is_a_pipe_is_not_waited_for(place, capsys):
    a_pipe(place / "truth")
    golden = HANDS.parents[3] / "logs" / "golden" / "jamia-fault.mcap"
    assert "not a file" in refused(capsys, "report", str(golden), "--truth", "truth")


def test_a_truth_of_another_time_is_refused(place, capsys):
    golden = HANDS.parents[3] / "logs" / "golden" / "jamia-fault.mcap"
    header = {"columns": ["q/index_j1"]}
    row = (10**13).to_bytes(8, "little") + bytes(8)
    (place / "run.truth").write_bytes(json.dumps(header).encode() + b"\n" + row)
    assert "of another time" in refused(capsys, "report", str(golden), "--truth", "run.truth", "--output", "x.html")
    assert not (place / "x.html").exists()


@pytest.mark.parametrize("name", ["n" * 300, "odd/x", "loop"])
@pytest.mark.parametrize("what", [what for what in READS if what != "scene"])
def test_a_name_that_cannot_be(place, capsys, what, name):
    (place / "odd").write_text("")
    a_loop(place / "loop")
    refused(capsys, *(word.replace("odd", name) for word in READS[what]))


def test_a_name_with_nul_is_refused(capsys):
    for words in READS.values():
        assert "NUL" in refused(capsys, *(word.replace("odd", "o\0d") for word in words))


NUMBERS = [
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


@pytest.mark.parametrize("words", NUMBERS, ids=" ".join)
def test_a_number_that_is_none(capsys, words):
    assert words[-1].partition("=")[0] in refused(capsys, *words)


def test_a_campaign_of_rows_that_nothing_is_tried_of(capsys):
    """CiA 402 tells no temperature, and none of these is a success."""
    words = ("fault", "campaign", "--protocol", "cia402", "--calm", "0", "--row", "N08", "--row", "N09")
    assert "'N09'" in refused(capsys, *words)


def test_an_option_of_a_drive_without_end(capsys):
    words = ("--protocol", "odrive", "--node", "1", "--bus", "local:nobody", "--torque-limit-Nm", "0.1", "--dry-run")
    assert "--option" in refused(capsys, "conformance", *words, "--option", "gear_ratio=" + "9" * 5000)


@pytest.mark.parametrize("rate", ["-1", "0", "9" * 30])
@pytest.mark.parametrize("option", ["--bitrate", "--data-bitrate"])
@pytest.mark.parametrize("verb", [("bus", "doctor"), ("scan",)], ids=" ".join)
def test_a_bit_rate_that_no_bus_has(capsys, verb, option, rate):
    assert "expected 10000 to 8000000" in refused(capsys, *verb, *BUS, f"{option}={rate}")


def test_an_unknown_perturbation_is_refused_before_the_run(capsys):
    refused(capsys, "identify", "--lockstep", "--digits", "thumb", "--perturb", "luck=2")


@pytest.mark.parametrize("verb", [("identify",), ("tune", "verify", "new.toml")], ids=" ".join)
@pytest.mark.parametrize("words", [("--lockstep", "--perturb", "stiffness=nan"), (*BUS, "--perturb", "stiffness=2")])
def test_what_makes_a_simulated_hand_another_one_is_never_ignored(place, capsys, verb, words):
    (place / "new.toml").write_text("schema = 1\n")
    assert "--perturb" in refused(capsys, *verb, *words, "--dry-run")


BUSES = ["x", ":x", "local:", "local:../x", "local:a/b", "local:.x", "socketcan:", ""]


@pytest.mark.parametrize("bus", BUSES)
def test_a_bus_that_is_none_is_refused_before_anything_is_begun(place, capsys, bus):
    drive = ("--protocol", "mit", "--node", "1", "--torque-limit-Nm", "0.1")
    for words in (("run", "--task", "grasp.toml"), ("scan",), ("jog", "index", "--angle", "3"), ("bus", "doctor")):
        assert main([*words, "--bus", bus]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.splitlines()[-1].startswith("handctl: ")
        assert "commissioning" not in err
    assert main(["conformance", *drive, "--yes", "--bus", bus]) == 2
    capsys.readouterr()
    fault = ("fault", "inject", "drop node=3")
    for words in (("stop",), ("clear",), ("gains", "set", "motion.force_N=20"), ("fault", "list"), fault):
        refused(capsys, *words, "--bus", bus)
    for words in (("scan",), ("sim",), ("conformance", *drive)):
        refused(capsys, *words, "--dry-run", "--bus", bus)
    assert list(place.iterdir()) == []


@pytest.mark.parametrize("bus", ["local:" + "n" * 300, "socketcan:nosuch", "nosuch:x", "slcan:/dev/nosuch"])
def test_a_bus_that_is_not_there_is_a_failure(capsys, bus):
    assert main(["scan", "--bus", bus]) == 1
    err = capsys.readouterr().err
    assert err.startswith("handctl: ")
    assert err.count("\n") == 1, err


@pytest.mark.parametrize("bus", ["main=virtual:x=y", "virtual:x=y"])
def test_a_controller_is_called_by_its_bus_whatever_it_is_named(capsys, bus):
    for words in (("stop",), ("clear",), ("gains", "set", "motion.force_N=20")):
        assert main([*words, "--bus", bus]) == 71
        assert "bus virtual:x=y: " in capsys.readouterr().err


def test_buses_are_named_alike_in_every_verb(capsys):
    for words in (("stop",), ("scan",), ("bus", "doctor")):
        assert main([*words, "--bus", "main=local:nobody"]) == (71 if words == ("stop",) else 1)
        out, err = capsys.readouterr()
        assert "local:nobody" in out + err
        assert "main=local:nobody" not in out + err
        refused(capsys, *words, "--bus", "no name=local:nobody")


def test_a_working_folder_that_has_gone(place, monkeypatch, capsys):
    (place / "gone").mkdir()
    monkeypatch.chdir("gone")
    (place / "gone").rmdir()
    for words in (("demo", "--lockstep"), ("doctor",), ("config", "show")):
        assert "folder" in refused(capsys, *words) or words[0] == "demo"
