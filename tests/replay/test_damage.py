"""A changed byte is named by its first tick, even where every checksum was made to fit."""

import json
import zlib
from pathlib import Path

import lz4.frame
import pytest

from handctl.cli.main import main
from handctl.log.read.chunk_reader import definitions, iter_messages
from handctl.log.read.logfile import ChunkLocation, LogFile
from handctl.log.read.reader import RunLog
from handctl.log.read.record_scan import RecordScan, scan_records
from handctl.log.read.recover import recover
from handctl.replay.check import check
from handctl.replay.damage import first_damage


@pytest.fixture
def log(golden: Path, tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    path.write_bytes((golden / "jamia-grasp.mcap").read_bytes())
    return path


def _chunks(path: Path) -> tuple[LogFile, RecordScan]:
    file, found = LogFile(path), RecordScan()
    scan_records(file, found)
    return file, found


def _changed(path: Path, topic: str, k: int, at: int, fitting: bool) -> None:
    """Change a byte of a message; with ``fitting`` all checksums are made to fit it, as somebody would who forges."""
    file, found = _chunks(path)
    names = {name: number for number, _, name, _, _ in definitions(file.content(found.chunks[0])).channels}
    for place in found.chunks:
        content = file.content(place)
        for one in iter_messages(content, place.end - place.data, frozenset([names[topic]])):
            hit = [i for i, sequence in enumerate(one.sequence().tolist()) if sequence == k]
            if hit:
                bent = bytearray(content)
                bent[one.start + hit[0] * one.records.shape[1] + 31 + at] ^= 0x10
                _put(path, found, place, bytes(bent), fitting)
                return
    raise AssertionError("no such message")


def _put(path: Path, found: RecordScan, place: ChunkLocation, bent: bytes, fitting: bool) -> None:
    """The same chunk with other bytes, in a file that ends without its last checksum."""
    raw = path.read_bytes()
    packed = lz4.frame.compress(bent)
    head = bytearray(raw[place.offset : place.data])
    head[1:9] = (len(head) - 9 + len(packed)).to_bytes(8, "little")
    if fitting:
        head[33:37] = zlib.crc32(bent).to_bytes(4, "little")
    head[-8:] = len(packed).to_bytes(8, "little")
    path.write_bytes(raw[: place.offset] + bytes(head) + packed + raw[place.end : found.end])


@pytest.mark.parametrize("fitting", [False, True], ids=["by chance", "forged"])
@pytest.mark.parametrize(("topic", "at"), [("/tick", 60), ("/controller/values", 100), ("/tick/chain", 22)])
def test_a_changed_byte_is_named_by_its_tick(log: Path, topic: str, at: int, fitting: bool) -> None:
    assert first_damage(log) == ""
    _changed(log, topic, 321, at, fitting)
    assert first_damage(log).startswith("tick 321 is not what was written")
    if fitting:
        with RunLog(log) as opened:
            (line,) = [line for line in check(opened) if "chain" in line]
        assert "breaks at tick 321" in line


def test_a_changed_byte_of_what_is_made_from_the_ticks_is_named_by_its_chunk(log: Path) -> None:
    _changed(log, "/joint_states", 321, 300, False)
    told = first_damage(log)
    assert "its ticks are intact" in told
    first, last = (int(word) for word in told.rpartition("ticks ")[2].split(" to "))
    assert first <= 321 <= last


def test_any_changed_byte_of_a_chunk_is_told_by_the_verb(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, found = _chunks(log)
    place = found.chunks[5]
    raw = bytearray(log.read_bytes())
    raw[(place.data + place.end) // 2] ^= 1
    log.write_bytes(raw)
    assert main(["log", "check", str(log), "--json"]) == 1
    findings = json.loads(capsys.readouterr().out)["findings"]
    assert len(findings) == 2
    assert "tick" in findings[-1]


def test_other_gains_in_the_header_break_the_chain_at_the_first_tick(log: Path) -> None:
    with RunLog(log) as opened:
        opened.header.attachments["gains.json"] += b" "
        (line,) = [line for line in check(opened) if "chain" in line]
    assert "breaks at tick 0:" in line


def test_a_recovered_log_has_an_unbroken_chain(log: Path, tmp_path: Path) -> None:
    raw = log.read_bytes()
    log.write_bytes(raw[: len(raw) // 2])
    recover(log, tmp_path / "new.mcap")
    with RunLog(tmp_path / "new.mcap") as opened:
        assert not [line for line in check(opened) if "chain" in line]
