"""A command writes an output completely or not at all. An output never replaces a log, a folder or a device."""

import os
import stat
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from handctl.cli.main import main
from handctl.errors import ConfigError
from handctl.hand.load import hand_path
from handctl.output import atomic_path, save_figure, write_text_atomically

GOLDEN = Path(__file__).parents[2] / "logs" / "golden" / "jamia-fault.mcap"
FULL = Path("/dev/full")
"""A device that accepts no byte, like a full disk."""
FORMATS = ("csv", "candump", "parquet", "rrd", "lerobot")
LOG = str(GOLDEN)
NOWHERE = {
    "report": ("report", LOG, "--output", "@"),
    "recover": ("log", "recover", LOG, "--output", "@"),
    "picture": ("replay", "execute", LOG, "--gains", "g.toml", "--picture", "@"),
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
    "save": ("view", LOG, "--save", "@.rrd"),
    "paper": ("paper", "--quick", "--output", "@"),
    "calibration": ("run", "--bus", "local:nobody", "--task", "grasp.toml", "--calibration", "@"),
    "log": ("run", "--bus", "local:nobody", "--task", "grasp.toml", "--log", "@"),
    **{form: ("log", "export", f"--{form}", LOG, "--output", "@", "--json") for form in FORMATS},
}


@pytest.fixture(autouse=True)
def existing_files(place):
    """Create files that exist before a command. Check that it has not changed them."""
    for name in ("folder", "folder.rrd"):
        (place / name).mkdir()
        (place / name / "mine").write_text("mine")
    for name in ("file", "other.mcap"):
        (place / name).write_text("mine")
    (place / "g.toml").write_text("schema = 1\n")
    before = everything(place)
    yield
    assert everything(place) == before


def everything(place):
    return {path: path.read_bytes() if path.is_file() else None for path in place.rglob("*")}


CASES = [
    (what, name) for what in NOWHERE for name in ("folder", "no-folder/x", "file/x", "other.mcap")
]
CASES.remove(("save", "other.mcap"))  # ``save`` writes to other.mcap.rrd


@pytest.mark.parametrize(("what", "name"), CASES)
def test_unwritable_output_path_is_refused(capsys, what, name):
    assert main([word.replace("@", name) for word in NOWHERE[what]]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("handctl: ")
    assert err.count("\n") == 1, err
    assert name in err


def inputs(place):
    """Create a log under the names log.html and log.png, and a hand file."""
    for name in ("log.html", "log.png"):
        (place / name).write_bytes(GOLDEN.read_bytes())
    (place / "hand.toml").write_text(hand_path("jamia").read_text())


@pytest.mark.parametrize(
    "words",
    [
        ("report", "log.html"),
        ("report", LOG, "--truth", "file", "--output", "file"),
        ("view", "log.png", "--picture", "log.png"),
        ("replay", "execute", LOG, "--gains", "g.toml", "--picture", "g.toml"),
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
def test_output_never_replaces_an_input(place, capsys, words):
    inputs(place)
    before = everything(place)
    assert main(list(words)) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1), err
    assert "another name" in err
    assert everything(place) == before
    for name in ("log.html", "log.png", "hand.toml"):
        (place / name).unlink()


@pytest.mark.parametrize("form", FORMATS)
def test_an_export_that_fails_leaves_nothing(place, monkeypatch, capsys, form):
    def full(path):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("handctl.output._fsync_file", full)
    assert main(["log", "export", f"--{form}", LOG, "--output", "new", "--json"]) == 1
    assert capsys.readouterr() == ("", "handctl: new: No space left on device\n")


@pytest.mark.parametrize("ended", [KeyboardInterrupt, ValueError])
def test_interrupted_write_leaves_only_the_old_file(place, ended):
    def interrupted(part):
        part.parent.mkdir(exist_ok=True)
        part.write_text("half of")
        raise ended

    with pytest.raises(ended), atomic_path(place / "file") as part:
        interrupted(part)
    with pytest.raises(ended), atomic_path(place / "new", new=True) as part:
        interrupted(part / "deep")


def test_a_device_is_written_to_and_not_replaced(place):
    (place / "full").symlink_to(FULL)
    with pytest.raises(OSError, match="No space left on device") as error:
        write_text_atomically(place / "full", "text")
    assert error.value.filename == str(place / "full")
    os.mkfifo(place / "pipe")
    reader = os.open(place / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    write_text_atomically(place / "pipe", "text")
    assert os.read(reader, 10) == b"text"
    os.close(reader)
    assert stat.S_ISFIFO((place / "pipe").stat().st_mode)
    (place / "full").unlink()
    (place / "pipe").unlink()


def test_a_link_stays_a_link(place):
    (place / "link").symlink_to("file")
    write_text_atomically(place / "link", "yours")
    assert (place / "link").is_symlink()
    assert (place / "file").read_text() == "yours"
    (place / "link").unlink()
    (place / "file").write_text("mine")


def test_a_loop_of_symbolic_links_is_refused_as_output(place):
    (place / "loop").symlink_to("loop")
    with pytest.raises((ConfigError, OSError)):
        write_text_atomically(place / "loop", "text", new=True)
    (place / "loop").unlink()


def test_a_log_that_its_own_picture_would_replace_is_refused(capsys):
    for name in ("run.png", "run.truth", "run"):
        assert main(["demo", "--lockstep", "--log", name]) == 2
        assert "ending in .mcap" in capsys.readouterr().err


def test_a_picture_keeps_the_requested_file_name(place):
    save_figure(Figure(), place / "picture")
    save_figure(Figure(), place / "picture.odd")
    save_figure(Figure(), place / "picture.svg")
    assert (place / "picture").read_bytes() == (place / "picture.odd").read_bytes()
    assert (place / "picture").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (place / "picture.svg").read_bytes()
    for name in ("picture", "picture.odd", "picture.svg"):
        (place / name).unlink()


def test_a_recording_is_not_begun_without_room_for_it(monkeypatch, capsys):
    monkeypatch.setattr("handctl.view.rerun_conversion.DISK_SPACE_FACTOR", 10**12)
    for words in (
        ("log", "export", "--rrd", LOG, "--output", "new.rrd", "--json"),
        ("view", LOG, "--save", "new.rrd"),
    ):
        assert main(words) == 1
        assert capsys.readouterr() == ("", "handctl: new.rrd: No space left on device\n")
