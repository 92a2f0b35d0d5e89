"""Test that a command writes an output file either completely or not at all.

An output file of a command never replaces a log, a folder or a device.
"""

import json
import os
import stat
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from handctl.cli.main import main
from handctl.errors import ConfigError
from handctl.hand.hand_loading import hand_path
from handctl.output_files import atomic_path, save_figure, write_text_atomically

GOLDEN_LOG = Path(__file__).parents[2] / "logs" / "golden" / "jamia-fault.mcap"
FULL_DISK_DEVICE = Path("/dev/full")
"""A device that behaves like a full disk: it accepts no byte."""
EXPORT_FORMATS = ("csv", "candump", "parquet", "rrd", "lerobot")
GOLDEN_LOG_TEXT = str(GOLDEN_LOG)
OUTPUT_COMMAND_BY_KIND = {
    "report": ("report", GOLDEN_LOG_TEXT, "--output", "@"),
    "recover": ("log", "recover", GOLDEN_LOG_TEXT, "--output", "@"),
    "picture": ("replay", "execute", GOLDEN_LOG_TEXT, "--gains", "g.toml", "--picture", "@"),
    "design": ("tune", "design", "--plants", "1", "--output", "@"),
    "picture of a design": (
        "tune",
        "design",
        "--plants",
        "1",
        "--output",
        "new.toml",
        "--picture",
        "@",
    ),
    "save": ("view", GOLDEN_LOG_TEXT, "--save", "@.rrd"),
    "paper": ("paper", "--quick", "--output", "@"),
    "calibration": ("run", "--bus", "local:nobody", "--task", "grasp.toml", "--calibration", "@"),
    "log": ("run", "--bus", "local:nobody", "--task", "grasp.toml", "--log", "@"),
    **{
        form: ("log", "export", f"--{form}", GOLDEN_LOG_TEXT, "--output", "@", "--json")
        for form in EXPORT_FORMATS
    },
}


@pytest.fixture(autouse=True)
def existing_files(work_folder):
    """Create some files before the test.

    After the test, check that the command has not changed the files that existed before the test.
    """
    for name in ("folder", "folder.rrd"):
        (work_folder / name).mkdir()
        (work_folder / name / "mine").write_text("mine")
    for name in ("file", "other.mcap"):
        (work_folder / name).write_text("mine")
    (work_folder / "g.toml").write_text("schema = 1\n")
    paths_before = files_below(work_folder)
    yield
    assert files_below(work_folder) == paths_before


def files_below(work_folder):
    return {path: path.read_bytes() if path.is_file() else None for path in work_folder.rglob("*")}


UNWRITABLE_CASES = [
    (output_kind, name)
    for output_kind in OUTPUT_COMMAND_BY_KIND
    for name in ("folder", "no-folder/x", "file/x", "other.mcap")
]
UNWRITABLE_CASES.remove(("save", "other.mcap"))  # the function ``save`` writes to other.mcap.rrd


@pytest.mark.parametrize(("command_kind", "output_name"), UNWRITABLE_CASES)
def test_unwritable_output_path_is_refused(capsys, command_kind, output_name):
    command_words = [
        word.replace("@", output_name) for word in OUTPUT_COMMAND_BY_KIND[command_kind]
    ]
    assert main(command_words) == 2
    out, err = capsys.readouterr()
    if "--json" in command_words:
        assert json.loads(out) == {
            "error": err.removeprefix("handctl: ").rstrip("\n"),
            "exit_code": 2,
        }
    else:
        assert out == ""
    assert err.startswith("handctl: ")
    assert err.count("\n") == 1, err
    assert output_name in err


def write_input_files(work_folder):
    """Create a hand file, and a log under each of the names log.html and log.png."""
    for name in ("log.html", "log.png"):
        (work_folder / name).write_bytes(GOLDEN_LOG.read_bytes())
    (work_folder / "hand.toml").write_text(hand_path("jamia").read_text())


@pytest.mark.parametrize(
    "command_words",
    [
        ("report", "log.html"),
        ("report", GOLDEN_LOG_TEXT, "--truth", "file", "--output", "file"),
        ("view", "log.png", "--picture", "log.png"),
        ("replay", "execute", GOLDEN_LOG_TEXT, "--gains", "g.toml", "--picture", "g.toml"),
        ("tune", "design", "--plants", "1", "--hand", "hand.toml", "--output", "hand.toml"),
        (
            "tune",
            "design",
            "--plants",
            "1",
            "--gains",
            "g.toml",
            "--output",
            "new.toml",
            "--picture",
            "g.toml",
        ),
        ("run", "--bus", "local:nobody", "--hand", "hand.toml", "--calibration", "hand.toml"),
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_output_never_replaces_an_input(work_folder, capsys, command_words):
    write_input_files(work_folder)
    paths_before = files_below(work_folder)
    assert main(list(command_words)) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1), err
    assert "another name" in err
    assert files_below(work_folder) == paths_before
    for name in ("log.html", "log.png", "hand.toml"):
        (work_folder / name).unlink()


@pytest.mark.parametrize("export_format", EXPORT_FORMATS)
def test_an_export_that_fails_leaves_nothing(work_folder, monkeypatch, capsys, export_format):
    def raise_full_disk(path):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("handctl.output_files._fsync_file", raise_full_disk)
    assert (
        main(["log", "export", f"--{export_format}", GOLDEN_LOG_TEXT, "--output", "new", "--json"])
        == 1
    )
    out, err = capsys.readouterr()
    assert json.loads(out) == {"error": "new: No space left on device", "exit_code": 1}
    assert err == "handctl: new: No space left on device\n"


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, ValueError])
def test_interrupted_write_leaves_only_the_old_file(work_folder, interruption):
    def write_and_interrupt(path):
        path.parent.mkdir(exist_ok=True)
        path.write_text("half of")
        raise interruption

    with pytest.raises(interruption), atomic_path(work_folder / "file") as temporary_path:
        write_and_interrupt(temporary_path)
    with (
        pytest.raises(interruption),
        atomic_path(work_folder / "new", must_be_new=True) as temporary_path,
    ):
        write_and_interrupt(temporary_path / "deep")


def test_a_device_is_written_to_and_not_replaced(work_folder):
    (work_folder / "full").symlink_to(FULL_DISK_DEVICE)
    with pytest.raises(OSError, match="No space left on device") as error:
        write_text_atomically(work_folder / "full", "text")
    assert error.value.filename == str(work_folder / "full")
    os.mkfifo(work_folder / "pipe")
    reader = os.open(work_folder / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    write_text_atomically(work_folder / "pipe", "text")
    assert os.read(reader, 10) == b"text"
    os.close(reader)
    assert stat.S_ISFIFO((work_folder / "pipe").stat().st_mode)
    (work_folder / "full").unlink()
    (work_folder / "pipe").unlink()


def test_a_link_stays_a_link(work_folder):
    (work_folder / "link").symlink_to("file")
    write_text_atomically(work_folder / "link", "yours")
    assert (work_folder / "link").is_symlink()
    assert (work_folder / "file").read_text() == "yours"
    (work_folder / "link").unlink()
    (work_folder / "file").write_text("mine")


def test_a_loop_of_symbolic_links_is_refused_as_output(work_folder):
    (work_folder / "loop").symlink_to("loop")
    with pytest.raises((ConfigError, OSError)):
        write_text_atomically(work_folder / "loop", "text", must_be_new=True)
    (work_folder / "loop").unlink()


def test_a_log_that_its_own_picture_would_replace_is_refused(capsys):
    for name in ("run.png", "run.truth", "run"):
        assert main(["demo", "--lockstep", "--log", name]) == 2
        assert "ending in .mcap" in capsys.readouterr().err


def test_a_picture_keeps_the_requested_file_name(work_folder):
    save_figure(Figure(), work_folder / "picture")
    save_figure(Figure(), work_folder / "picture.odd")
    save_figure(Figure(), work_folder / "picture.svg")
    assert (work_folder / "picture").read_bytes() == (work_folder / "picture.odd").read_bytes()
    assert (work_folder / "picture").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (work_folder / "picture.svg").read_bytes()
    for name in ("picture", "picture.odd", "picture.svg"):
        (work_folder / name).unlink()


def test_a_recording_is_not_begun_without_room_for_it(monkeypatch, capsys):
    monkeypatch.setattr("handctl.view.rerun_conversion.DISK_SPACE_FACTOR", 10**12)
    for words in (
        ("log", "export", "--rrd", GOLDEN_LOG_TEXT, "--output", "new.rrd", "--json"),
        ("view", GOLDEN_LOG_TEXT, "--save", "new.rrd"),
    ):
        assert main(words) == 1
        out, err = capsys.readouterr()
        assert ("No space left on device" in out) is ("--json" in words)
        assert err == "handctl: new.rrd: No space left on device\n"
