"""Test the files that `handctl view` writes, and its error messages about refused input."""

import json
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.log.read.reader import RunLog
from handctl.view import viewer
from handctl.view.picture_time import picture_time


def error_line(capsys: pytest.CaptureFixture[str]) -> str:
    """Return the only error line that a command has printed."""
    output = capsys.readouterr()
    assert output.out == ""
    (line_of_error,) = output.err.splitlines()
    return line_of_error


def test_save_writes_a_recording_and_reports_it(
    jamia_log_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording_path = tmp_path / "run.rrd"
    assert main(["view", str(jamia_log_path), "--save", str(recording_path), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert (output["rrd"], output["bytes"]) == (str(recording_path), recording_path.stat().st_size)
    assert recording_path.read_bytes()[:4] == b"RRF2"


def test_a_cut_log_is_shown_with_a_warning(
    jamia_log_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truncated_log_path = tmp_path / "cut.mcap"
    truncated_log_path.write_bytes(jamia_log_path.read_bytes()[:300_000])
    assert (
        main(["view", str(truncated_log_path), "--save", str(tmp_path / "cut.rrd"), "--json"]) == 3
    )
    output = capsys.readouterr()
    assert "without an end mark" in json.loads(output.out)["warning"]
    assert len(output.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("view_options", "expected_message"),
    [
        (["--save", "run.mcap"], "ending in .rrd"),
        (["--picture", "no/such/folder/x.png"], "in a folder that exists"),
        (["--at", "1"], "--picture FILE.png"),
        (["--save", "x.rrd", "--follow"], "one of them"),
        (["other.mcap", "--save", "x.rrd"], "one log"),
        (["folder/run.mcap"], "different file names"),
    ],
)
def test_impossible_requests_are_refused_before_the_log_is_read(
    view_options: list[str],
    expected_message: str,
    jamia_log_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    content_before = jamia_log_path.read_bytes()
    assert main(["view", str(jamia_log_path), *view_options]) == 2
    assert expected_message in error_line(capsys)
    assert jamia_log_path.read_bytes() == content_before


def test_a_time_outside_of_the_run_is_refused(
    jamia_log_path: Path,
    tmp_path: Path,
    vulkan_environment: dict[str, str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert (
        main(["view", str(jamia_log_path), "--picture", str(tmp_path / "x.png"), "--at", "99"]) == 2
    )
    assert "0 to 2.990" in error_line(capsys)


def test_view_refuses_a_file_that_is_not_a_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text_file = tmp_path / "x.mcap"
    text_file.write_bytes(b"no log at all")
    for path in (text_file, tmp_path / "missing.mcap", tmp_path):
        assert main(["view", str(path), "--save", str(tmp_path / "x.rrd")]) == 2
        assert str(path) in error_line(capsys)
    assert not (tmp_path / "x.rrd").exists()


def test_without_a_driver_the_packages_are_named(
    jamia_log_path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(viewer, "VULKAN_DRIVER_FOLDERS", (str(tmp_path),))
    monkeypatch.delenv("VK_ICD_FILENAMES", raising=False)
    monkeypatch.delenv("VK_DRIVER_FILES", raising=False)
    assert main(["view", str(jamia_log_path), "--picture", str(tmp_path / "x.png")]) == 2
    assert "libvulkan1 mesa-vulkan-drivers" in error_line(capsys)


def test_without_a_screen_no_window_is_tried(
    jamia_log_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(["view", str(jamia_log_path)]) == 2
    assert "--picture" in error_line(capsys)


def test_the_picture_is_taken_in_the_middle_of_the_hold_phase(jamia_log_path: Path) -> None:
    with RunLog(jamia_log_path) as log:
        assert picture_time(log) == pytest.approx((0.40 + 0.75) / 2 * 3.0, abs=0.02)
