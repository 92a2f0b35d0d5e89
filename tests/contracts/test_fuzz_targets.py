"""Fuzzing begins at what is right: an input that changes nothing is taken, so that a change is what is refused."""

import functools
import subprocess
from pathlib import Path

import pytest
from mcap.opcode import Opcode

from firmware_sim.description import SimulatorError
from fuzz import blind, files, logs, texts, wire
from fuzz.__main__ import LONGEST, fuzzed
from fuzz.drives import DRIVES
from fuzz.targets import TARGETS, seeds
from handctl.drives.contract import Phase

UNCHANGED = ("hand", "task", "trajectory", "gains", "calibration", "log")
"""Targets of a document that an empty input leaves as it is."""


@pytest.mark.parametrize("name", UNCHANGED)
def test_a_document_that_nothing_changes_is_taken(name: str, tmp_path: Path) -> None:
    assert TARGETS[name](tmp_path)(b"")


@pytest.mark.parametrize("name", [*DRIVES, "hand-text", "log-bytes", "request", "fault"])
def test_what_a_corpus_begins_with_is_taken(name: str, tmp_path: Path) -> None:
    target = TARGETS[name](tmp_path)
    begin = seeds(name, tmp_path)
    assert begin
    assert all(target(seed[: LONGEST[name]]) for seed in begin), "as long as inputs are at most"


@pytest.mark.parametrize("name", DRIVES)
def test_what_a_drive_s_corpus_begins_with_goes_all_the_way_to_torque(name: str, tmp_path: Path) -> None:
    motor, seen = wire.path_to_torque(name, tmp_path)
    assert {one.state.phase for one in seen} >= {Phase.SILENT, Phase.READY, Phase.ENABLED}
    ours = sorted(motor.node_ids)
    for data in seeds(name, tmp_path):
        state, t_ns, heard = seen[data[0]]
        told = [frame for frame, _ in wire.frames(data, ours, t_ns)]
        assert [(frame.can_id, frame.data) for frame in told] == [(frame.can_id, frame.data) for frame in heard]
        after = functools.reduce(motor.receive, told, state)
        assert after.misread == 0
        assert after.phase == functools.reduce(motor.receive, heard, state).phase


def test_a_change_inside_a_log_comes_as_far_as_what_it_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr(files, "one_line", lambda error: told.append(str(error)))
    target = TARGETS["log"](tmp_path)
    parts = logs._parts(tmp_path / "small.mcap")
    messages = ((i, at) for i, part in enumerate(parts) for at, one in enumerate(part) if one[0] == Opcode.MESSAGE)
    part, tick = next(messages)
    number = 22 + 4  # of the tick: behind channel, sequence and times of a message, and the mark of its encoding
    replaced, anywhere, given, one_byte = 3, 1, 0, 0
    choices = (part, tick, replaced, number, anywhere, given, one_byte)
    assert not target(b"".join(n.to_bytes(2, "little") for n in choices) + b"\x07")
    assert len(told) == 1
    assert "telemetry and ticks do not belong together" in told[0]


@pytest.mark.parametrize("text", ["", "two\nlines"])
def test_a_fault_s_refusal_without_words_or_of_two_lines_is_noticed(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise SimulatorError(text)

    monkeypatch.setattr(texts, "parse_fault", refuse)
    target = TARGETS["fault"](tmp_path)
    with pytest.raises(AssertionError):
        target(b"")


def test_inputs_of_which_none_is_taken_are_no_success(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert blind.fuzz(lambda data: data > b"b", iter([b"a", b"b", b"c"] * 100), tmp_path, 0.0, 256) == (256, 85)
    monkeypatch.chdir(tmp_path)
    for taken, held in ((0, False), (64, True)):
        said = f"Done 256 runs in 2 second(s), {taken} taken, from 3 kept"
        done = subprocess.CompletedProcess([], 0, "", said)
        monkeypatch.setattr(subprocess, "run", lambda *words, done=done, **more: done)
        line, good = fuzzed("log", 0, 256, blind=True)
        assert good == held
        assert ("25.0 % taken" in line) == held
