"""Test the commands that use recorded runs. The tests use command lines that a user would type."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.hand.hand_loading import load_hand
from handctl.replay.tick_difference import TickDifference

GOLDEN_FOLDER = Path(__file__).parents[2] / "logs" / "golden"
GRASP_LOG, OTHER_LOG = (
    str(GOLDEN_FOLDER / "jamia-grasp.mcap"),
    str(GOLDEN_FOLDER / "jamia11-grasp.mcap"),
)


def test_replay_execute_reports_its_result_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", "execute", GRASP_LOG, "--json", "--within", "1e-9"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["ticks"] > 300
    assert content["undecided"] == 0
    assert {"differing", "first", "times_real_time", "version_logged"} <= content.keys()


def test_rounding_of_another_machine_is_distinguished(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    compared_function = "handctl.replay.log_runner.are_outputs_equal"
    monkeypatch.setattr(compared_function, lambda logged, *arguments: logged.tick_in.k != 100)
    tick_difference = TickDifference(100, 0.5, "nis", "index_tendon", 0.5, 0.5 + 1e-15, 9)
    monkeypatch.setattr(
        "handctl.replay.log_runner.differing_fields", lambda *arguments: iter([tick_difference])
    )
    assert main(["replay", "execute", GRASP_LOG]) == 1
    assert "--within 1e-9" in capsys.readouterr().out
    assert main(["replay", "execute", GRASP_LOG, "--within", "1e-9"]) == 0
    assert "--within 1e-9" not in capsys.readouterr().out


def test_other_gains_are_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gains, picture = tmp_path / "gains.toml", tmp_path / "x.png"
    gains.write_text("[motion]\nposition_error_m = 3e-4\n")
    assert (
        main(
            [
                "replay",
                "execute",
                GRASP_LOG,
                "--gains",
                str(gains),
                "--picture",
                str(picture),
                "--json",
            ]
        )
        == 0
    )
    content = json.loads(capsys.readouterr().out)
    assert content["change"]["motor_torque_N_m"]["index_motor"]["peak"] > 0.01
    assert picture.stat().st_size > 10_000


@pytest.mark.parametrize(
    "log_path", sorted(GOLDEN_FOLDER.glob("*.mcap")), ids=lambda path: path.stem
)
def test_the_comparison_ends_at_a_fault_that_the_log_does_not_have(
    log_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Reproduce a defect: the comparison of recorded and repeated ticks wrongly included the time after a fault.

    The ticks of a log were executed again with other gains. The re-execution ended with a fault,
    and the hand relaxed.
    """
    gains = tmp_path / "gains.toml"
    gains.write_text("[motion]\nposition_error_m = 3e-5\nspeed_error_m_s = 3e-3\n")
    words = ["replay", "execute", str(log_path), "--gains", str(gains), "--picture"]
    assert main([*words, str(tmp_path / "a.png"), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert main([*words, str(tmp_path / "b.png")]) == 0
    out = capsys.readouterr().out
    ends = content["compared"] < content["ticks"]
    assert ("the comparison ends at" in out) == ends
    assert all(fault in out for fault in content["faults"])
    assert ends == bool(content["faults"])


def test_gains_that_are_wrong_are_bad_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gains = tmp_path / "gains.toml"
    gains.write_text("[motion]\nposition_error_m = -1\n")
    assert main(["replay", "execute", GRASP_LOG, "--gains", str(gains)]) == 2
    assert "position_error_m" in capsys.readouterr().err


@pytest.mark.parametrize(
    "extra_options",
    [
        ["--picture", "x.png"],
        ["--gains", "gains.toml", "--within", "1e-9"],
        ["--gains", "gains.toml", "--from", "1"],
        ["--gains", "gains.toml", "--until", "1"],
    ],
)
def test_an_option_without_effect_is_refused(
    extra_options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", "execute", GRASP_LOG, *extra_options]) == 2
    assert "--gains" in capsys.readouterr().err


def test_a_part_of_a_log_is_executed(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["replay", "execute", GRASP_LOG, "--within", "1e-9", "--from", "1.2", "--until", "2"]
    assert main([*words, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["start_s"], result["ticks"]) == (pytest.approx(1.005), 199)
    assert main(words) == 0
    assert capsys.readouterr().out.startswith("199 ticks from 1.005 s, ")


@pytest.mark.parametrize(
    ("time_options", "expected_error"),
    [
        (["--from", "nan"], "--from: nan; expected a time from 0 to 3.2"),
        (["--from", "-1"], "--from: -1; expected a time from 0 to 3.2"),
        (["--from", "100"], "--from: 100; expected a time from 0 to 3.2"),
        (["--until", "nan"], "--until: nan; expected a time after 0 s"),
        (["--until", "0"], "--until: 0; expected a time after 0 s"),
        (["--from", "2", "--until", "1.5"], "--until: 1.5; expected a time after 2 s"),
    ],
)
def test_a_part_that_the_log_does_not_contain_is_refused(
    time_options: list[str], expected_error: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", "execute", GRASP_LOG, *time_options]) == 2
    assert capsys.readouterr().err.startswith(f"handctl: {expected_error}")


def test_replay_safety_names_the_reading_of_a_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    limits = tmp_path / "limits.toml"
    limits.write_text("tension_trip_N = 20\n")
    assert main(["replay", "safety", GRASP_LOG, "--limits", str(limits)]) == 0
    assert "T03 over-tension: thumb_tendon 20." in capsys.readouterr().out


@pytest.mark.parametrize(
    "command_words",
    [
        ["log", "diff", GRASP_LOG, OTHER_LOG],
        ["replay", "drive", OTHER_LOG, "--hand", "jamia", "--bus", "local:x", "--dry-run"],
    ],
    ids=["diff", "drive"],
)
def test_another_hand_s_log_is_refused_with_both_identities(
    command_words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command_words) == 4
    error_output = capsys.readouterr().err
    assert len(error_output.splitlines()) == 1
    for hand in ("jamia", "jamia11"):
        assert load_hand(hand).identity[:12] in error_output


def test_replay_drive_has_a_dry_run_without_a_bus(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["replay", "drive", GRASP_LOG, "--bus", "local:nobody", "--dry-run"]) == 0
    assert "would drive 2." in capsys.readouterr().out


@pytest.mark.parametrize("export_format", ["parquet", "csv", "candump", "rrd"])
def test_export_writes_beside_the_log(
    export_format: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.mcap"
    log.write_bytes(Path(GRASP_LOG).read_bytes())
    assert main(["log", "export", str(log), f"--{export_format}", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["count"] > 600
    assert (tmp_path / f"run.{export_format}").stat().st_size > 100_000


def test_a_truncated_log_is_checked_and_executed_in_part(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["log", "check", GRASP_LOG]) == 0
    cut = tmp_path / "cut.mcap"
    whole_content = Path(GRASP_LOG).read_bytes()
    cut.write_bytes(whole_content[: len(whole_content) // 2])
    assert main(["log", "check", str(cut)]) == 3
    assert "incomplete" in capsys.readouterr().out
    assert main(["replay", "execute", str(cut), "--within", "1e-9"]) == 3, (
        "the ticks before the end are executed"
    )


def test_log_info_prints_readable_text(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "info", GRASP_LOG]) == 0
    assert "motion.force_N: " not in capsys.readouterr().out
    assert main(["log", "info", GRASP_LOG, "-v"]) == 0
    output = capsys.readouterr().out
    assert max(map(len, output.splitlines())) < 120
    assert "motion.force_N: " in output
    assert "\nwhole        yes\nproblem      -\n" in output
    # The hash of the chain can contain twelve decimal digits.
    numbers = re.sub(r"chain: [0-9a-f]{16}\b", "", output.partition("identity")[0])
    assert not re.search(r"\d{12}", numbers), "numbers are rounded"


@pytest.mark.parametrize(
    "command_words",
    [["report"], ["log", "export", "--csv"], ["log", "diff", GRASP_LOG], ["replay", "safety"]],
)
def test_result_of_an_incomplete_log_is_marked(
    command_words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut, limits = tmp_path / "cut.mcap", tmp_path / "limits.toml"
    whole_content = Path(GRASP_LOG).read_bytes()
    cut.write_bytes(whole_content[: len(whole_content) // 2])
    limits.write_text("tension_trip_N = 20\n")
    limits_options = ["--limits", str(limits)] if command_words[-1] == "safety" else []
    assert main([*command_words, str(cut), *limits_options]) == 3
    assert "cut.mcap: ends at byte" in capsys.readouterr().err


class HtmlPage(HTMLParser):
    """Parser of a web page.

    The parser collects the addresses from which the web page would load content.
    """

    def __init__(self) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.seen: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        if tag not in ("svg", "use", "g", "path", "image", "metadata"):
            self.loads += [value or "" for name, value in attrs if name in ("src", "href")]


def test_the_report_is_one_page_that_loads_nothing(tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    assert main(["report", str(GOLDEN_FOLDER / "jamia-fault.mcap"), "--output", str(out)]) == 0
    page = HtmlPage()
    text = out.read_text()
    page.feed(text)
    assert {"svg", "img", "table", "style"} <= page.seen
    assert "script" not in page.seen
    assert all(loaded_url.startswith("data:image/png;base64,") for loaded_url in page.loads)
    assert "B17 some nodes do not hear: index_motor" in text
    assert load_hand("jamia").identity in text


def test_text_of_a_log_cannot_become_markup() -> None:
    from handctl.report.run_report_page import _escaped_text

    assert _escaped_text("<script>\x1b[31m&") == "&lt;script&gt;\\x1b[31m&amp;"


def test_a_report_begins_with_faults_and_contacts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("handctl.report.run_report_page.MAX_LISTED_EVENTS", 3)
    out = tmp_path / "page.html"
    assert main(["report", str(GOLDEN_FOLDER / "jamia-fault.mcap"), "--output", str(out)]) == 0
    text = out.read_text()
    head = text[: text.index("The hand in each phase")]
    assert "B02 a motor has gone silent: 1, first at" in head
    for digit in ("index", "middle", "ring", "thumb"):
        assert f"{digit} touches" in head
    assert "more: handctl log info" in text
