"""The check of a log reports a changed byte, together with the first tick that has a wrong byte.

The check reports a changed byte even if all checksums were adjusted.
"""

import json
import zlib
from pathlib import Path

import lz4.frame
import pytest

from handctl.cli.main import main
from handctl.log.read.chunk_reader import iter_messages, schemas_and_channels
from handctl.log.read.logfile import ChunkLocation, LogFile
from handctl.log.read.reader import RunLog
from handctl.log.read.record_scan import RecordScan, scan_records
from handctl.log.read.recover import recover_log
from handctl.replay.damage_description import describe_damaged_log
from handctl.replay.log_check import check_log


@pytest.fixture
def log_copy(golden_folder: Path, tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    path.write_bytes((golden_folder / "jamia-grasp.mcap").read_bytes())
    return path


def _scan_chunks(path: Path) -> tuple[LogFile, RecordScan]:
    file, scan = LogFile(path), RecordScan()
    scan_records(file, scan)
    return file, scan


def _change_message(
    log_path: Path, topic: str, tick_index: int, byte_offset: int, has_valid_checksum: bool
) -> None:
    """Change a byte in the message of the tick ``tick_index``.

    If ``has_valid_checksum`` is True, adjust all checksums, as an attacker would do to forge a log.
    """
    file, scan = _scan_chunks(log_path)
    names = {
        name: number
        for number, _, name, _, _ in schemas_and_channels(
            file.chunk_content(scan.chunks[0])
        ).channels
    }
    for chunk in scan.chunks:
        content = file.chunk_content(chunk)
        for message in iter_messages(
            content, chunk.end - chunk.data_offset, frozenset([names[topic]])
        ):
            matching_rows = [
                i
                for i, sequence in enumerate(message.sequence().tolist())
                if sequence == tick_index
            ]
            if matching_rows:
                changed_content = bytearray(content)
                changed_content[
                    message.start + matching_rows[0] * message.records.shape[1] + 31 + byte_offset
                ] ^= 0x10
                _write_log_with_chunk(
                    log_path, scan, chunk, bytes(changed_content), has_valid_checksum
                )
                return
    raise AssertionError("no such message")


def _write_log_with_chunk(
    log_path: Path,
    record_scan: RecordScan,
    chunk: ChunkLocation,
    new_content: bytes,
    has_valid_checksum: bool,
) -> None:
    """Write a log in which the content of one chunk is replaced.

    The written file ends after the last record in ``record_scan``. The checksum that is usually at
    the end of a log is therefore missing.
    """
    log_bytes = log_path.read_bytes()
    compressed_content = lz4.frame.compress(new_content)
    head = bytearray(log_bytes[chunk.offset : chunk.data_offset])
    head[1:9] = (len(head) - 9 + len(compressed_content)).to_bytes(8, "little")
    if has_valid_checksum:
        head[33:37] = zlib.crc32(new_content).to_bytes(4, "little")
    head[-8:] = len(compressed_content).to_bytes(8, "little")
    log_path.write_bytes(
        log_bytes[: chunk.offset]
        + bytes(head)
        + compressed_content
        + log_bytes[chunk.end : record_scan.end]
    )


@pytest.mark.parametrize("has_valid_checksum", [False, True], ids=["by chance", "forged"])
@pytest.mark.parametrize(
    ("topic", "byte_offset"), [("/tick", 60), ("/controller/values", 100), ("/tick/chain", 22)]
)
def test_a_changed_byte_is_named_by_its_tick(
    log_copy: Path, topic: str, byte_offset: int, has_valid_checksum: bool
) -> None:
    assert describe_damaged_log(log_copy) == ""
    _change_message(log_copy, topic, 321, byte_offset, has_valid_checksum)
    assert describe_damaged_log(log_copy).startswith("tick 321 was changed after it was written")
    if has_valid_checksum:
        with RunLog(log_copy) as opened_log:
            (line,) = [line for line in check_log(opened_log) if "chain" in line]
        assert "breaks at tick 321" in line


def test_a_changed_byte_of_a_derived_topic_is_named_by_its_chunk(log_copy: Path) -> None:
    _change_message(log_copy, "/joint_states", 321, 300, False)
    message = describe_damaged_log(log_copy)
    assert "its ticks are intact" in message
    first_tick, last_tick = (int(word) for word in message.rpartition("ticks ")[2].split(" to "))
    assert first_tick <= 321 <= last_tick


def test_log_check_reports_any_changed_byte_of_a_chunk(
    log_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, scan = _scan_chunks(log_copy)
    chunk = scan.chunks[5]
    log_bytes = bytearray(log_copy.read_bytes())
    log_bytes[(chunk.data_offset + chunk.end) // 2] ^= 1
    log_copy.write_bytes(log_bytes)
    assert main(["log", "check", str(log_copy), "--json"]) == 1
    findings = json.loads(capsys.readouterr().out)["findings"]
    assert len(findings) == 2
    assert "tick" in findings[-1]


def test_other_gains_in_the_header_break_the_chain_at_the_first_tick(log_copy: Path) -> None:
    with RunLog(log_copy) as opened_log:
        opened_log.header.attachments["gains.json"] += b" "
        (line,) = [line for line in check_log(opened_log) if "chain" in line]
    assert "breaks at tick 0:" in line


def test_a_recovered_log_has_an_unbroken_chain(log_copy: Path, tmp_path: Path) -> None:
    log_bytes = log_copy.read_bytes()
    log_copy.write_bytes(log_bytes[: len(log_bytes) // 2])
    recover_log(log_copy, tmp_path / "new.mcap")
    with RunLog(tmp_path / "new.mcap") as opened_log:
        assert not [line for line in check_log(opened_log) if "chain" in line]
