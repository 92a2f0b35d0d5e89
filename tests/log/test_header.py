"""Test how handctl reads logs from an unknown source.

The header of a log from an unknown source can contain wrong values. Every command of handctl checks
the type and the range of each header value that it uses in a computation.
"""

import json
from pathlib import Path

import pytest
from changed_headers import log_with_changed_metadata, write_log_with_run_metadata

from handctl.cli.main import main
from handctl.errors import LogError
from handctl.hand.hand_loading import PACKAGED_HANDS_FOLDER
from handctl.log.header import MAX_LOG_TIME_NS, PERIOD_RANGE_NS
from handctl.log.read.reader import RunLog

GOLDEN_LOG = PACKAGED_HANDS_FOLDER.parents[3] / "logs" / "golden" / "jamia-fault.mcap"
LOG_READING_COMMANDS = {
    "log info": ("log", "info", "odd.mcap"),
    "log check": ("log", "check", "odd.mcap"),
    "log diff": ("log", "diff", "odd.mcap", "odd.mcap"),
    "export csv": ("log", "export", "--csv", "odd.mcap"),
    "export parquet": ("log", "export", "--parquet", "odd.mcap"),
    "export candump": ("log", "export", "--candump", "odd.mcap"),
    "export lerobot": ("log", "export", "--lerobot", "odd.mcap"),
    "export rrd": ("log", "export", "--rrd", "odd.mcap"),
    "report": ("report", "odd.mcap"),
    "replay execute": ("replay", "execute", "odd.mcap"),
    "replay drive": ("replay", "drive", "odd.mcap", "--bus", "local:nobody", "--dry-run"),
    "replay safety": ("replay", "safety", "odd.mcap", "--limits", "limits.toml"),
    "identify": ("identify", "--from-log", "odd.mcap"),
    "view": ("view", "odd.mcap", "--save", "odd.rrd"),
}
WRONG_NUMBERS = {
    "period_ns": [
        "0",
        "0.5",
        "1e-300",
        "1e308",
        "-1",
        "true",
        "null",
        '"5"',
        "[5]",
        "NaN",
        "9" * 5000,
        str(2**64),
    ],
    "offset_ns": [
        "0.5",
        "1e308",
        "-1",
        "true",
        "null",
        '"5"',
        "[5]",
        "NaN",
        "9" * 5000,
        str(2**64),
    ],
}
WRONG_TEXTS = [
    '"abc"',
    "{}",
    '[["a"]]',
    "[1]",
    "[null]",
    '["a", "a"]',
    '["\\ud800"]',
    '["\\u001b[2J"]',
    '["a\\nb"]',
    '[""]',
]
LIST_KEYS = ("joints", "tendons", "motors", "digits", "buses")


@pytest.fixture
def log_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "limits.toml").write_text("tension_trip_N = 20")
    return tmp_path


def _refusal_line(capsys: pytest.CaptureFixture[str], *command_words: str) -> str:
    """Return the error line that a command prints when it refuses a log.

    The command `log check` prints its finding to standard output, so return this line for `log
    check`. In addition, check the exit code: 1 for `log check`, and 2 for other commands.
    """
    checks = command_words[:2] == ("log", "check")
    assert main(command_words) == (1 if checks else 2), command_words
    out, err = capsys.readouterr()
    message, silent = (out, err) if checks else (err, out)
    message = message.removeprefix("reading odd.mcap\n")
    assert silent == ""
    assert message.count("\n") == 1, message
    assert message[:-1].isprintable()
    assert len(message) < 600
    return message


@pytest.mark.parametrize("command_name", LOG_READING_COMMANDS)
def test_invalid_period_is_refused_in_one_line(
    log_folder: Path, capsys: pytest.CaptureFixture[str], command_name: str
) -> None:
    for period in ("0", "0.5", str(2**64)):
        write_log_with_run_metadata(GOLDEN_LOG, log_folder / "odd.mcap", period_ns=period)
        assert "period_ns" in _refusal_line(capsys, *LOG_READING_COMMANDS[command_name])
    write_log_with_run_metadata(GOLDEN_LOG, log_folder / "odd.mcap", offset_ns=str(2**64))
    assert "offset_ns" in _refusal_line(capsys, *LOG_READING_COMMANDS[command_name])
    write_log_with_run_metadata(GOLDEN_LOG, log_folder / "odd.mcap", tendons='["\\ud800", ["a"]]')
    assert "tendons" in _refusal_line(capsys, *LOG_READING_COMMANDS[command_name])


@pytest.mark.parametrize(
    ("key", "text"), [(key, text) for key, texts in WRONG_NUMBERS.items() for text in texts]
)
def test_a_number_of_the_header_has_its_type_and_range(
    small_log: Path, tmp_path: Path, key: str, text: str
) -> None:
    with pytest.raises(LogError, match=key if len(text) < 4000 else "digits"):
        RunLog(write_log_with_run_metadata(small_log, tmp_path / "odd.mcap", **{key: text}))


@pytest.mark.parametrize("text", WRONG_TEXTS)
@pytest.mark.parametrize("key", LIST_KEYS)
def test_a_name_of_the_header_is_a_name(
    small_log: Path, tmp_path: Path, key: str, text: str
) -> None:
    with pytest.raises(LogError, match=key) as refused:
        RunLog(write_log_with_run_metadata(small_log, tmp_path / "odd.mcap", **{key: text}))
    assert str(refused.value).isprintable()


def test_the_ends_of_the_ranges_are_read(small_log: Path, tmp_path: Path) -> None:
    for period in PERIOD_RANGE_NS:
        with RunLog(
            write_log_with_run_metadata(small_log, tmp_path / "odd.mcap", period_ns=str(period))
        ) as log:
            assert log.header.period_ns == period
    with RunLog(
        write_log_with_run_metadata(
            small_log, tmp_path / "odd.mcap", offset_ns=str(MAX_LOG_TIME_NS)
        )
    ) as log:
        assert log.header.offset_ns == MAX_LOG_TIME_NS


@pytest.mark.parametrize(
    "command_name",
    [
        command_name
        for command_name in LOG_READING_COMMANDS
        if command_name.startswith(("report", "replay", "identify", "view"))
    ],
)
def test_a_hand_with_other_names_than_the_columns_is_refused(
    log_folder: Path, capsys: pytest.CaptureFixture[str], command_name: str
) -> None:
    def metadata_with_other_name(name: str, old_metadata: dict[str, str]) -> dict[str, str]:
        if name != "handctl.run":
            return old_metadata
        joints = json.loads(old_metadata["joints"])
        return old_metadata | {"joints": json.dumps([*joints[:-1], "another"])}

    (log_folder / "odd.mcap").write_bytes(
        log_with_changed_metadata(GOLDEN_LOG.read_bytes(), metadata_with_other_name)
    )
    assert "names differ" in _refusal_line(capsys, *LOG_READING_COMMANDS[command_name])


@pytest.mark.parametrize("text", ["²", "-1", "1.5", "9" * 5000, str(2**64), "\x1b[2J"])
def test_invalid_truth_offset_is_refused(
    log_folder: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    changed_fields = {"truth_offset_ns": text}
    changed_log = log_with_changed_metadata(
        GOLDEN_LOG.read_bytes(),
        lambda name, old_metadata: (
            old_metadata | changed_fields if name == "handctl" else old_metadata
        ),
    )
    (log_folder / "odd.mcap").write_bytes(changed_log)
    assert "truth_offset_ns" in _refusal_line(capsys, "report", "odd.mcap")


def test_logs_of_other_columns_are_not_compared(
    log_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_log_with_run_metadata(GOLDEN_LOG, log_folder / "odd.mcap", joints='["a", "b"]')
    assert main(["log", "diff", str(GOLDEN_LOG), "odd.mcap"]) == 4
    assert "other joints" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["3.5", "[]", '{"torque_gain": [1.0]}', '{"torque_gain": 3}', "{"])
def test_invalid_setup_is_refused_by_identify(small_log: Path, text: str) -> None:
    from handctl.tune.identify.tendon_data import _logged_gain

    with RunLog(small_log) as log:
        log.header.attachments["setup.json"] = text.encode()
        with pytest.raises(LogError, match=r"setup\.json"):
            _logged_gain(log, 4)
