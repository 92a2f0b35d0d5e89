"""Test that fuzz tests start from valid inputs, which handctl accepts.

A fuzz test changes a valid input, so that only the change can cause a refusal of the input.
"""

import functools
import subprocess
from pathlib import Path

import pytest
from mcap.opcode import Opcode

from firmware_sim.description.hand_description import SimulatorError
from fuzz import file_targets, frame_targets, fuzz_without_coverage, log_targets, text_targets
from fuzz.__main__ import MAX_INPUT_BYTES, fuzz_target
from fuzz.fuzzed_drives import FUZZED_DRIVES
from fuzz.targets import TARGET_FACTORIES, seed_inputs
from handctl.drives.contract import DrivePhase

DOCUMENT_TARGETS = ("hand", "task", "trajectory", "gains", "calibration", "log")
"""Names of the fuzz tests that change a valid document. An empty fuzz input leaves the document unchanged."""


@pytest.mark.parametrize("target_name", DOCUMENT_TARGETS)
def test_an_unchanged_document_is_accepted(target_name: str, tmp_path: Path) -> None:
    assert TARGET_FACTORIES[target_name](tmp_path)(b"")


@pytest.mark.parametrize(
    "target_name", [*FUZZED_DRIVES, "hand-text", "log-bytes", "request", "fault"]
)
def test_seeds_of_a_corpus_are_accepted(target_name: str, tmp_path: Path) -> None:
    target = TARGET_FACTORIES[target_name](tmp_path)
    seeds = seed_inputs(target_name, tmp_path)
    assert seeds
    assert all(target(seed[: MAX_INPUT_BYTES[target_name]]) for seed in seeds), (
        "inputs of the largest length are accepted"
    )


@pytest.mark.parametrize("target_name", FUZZED_DRIVES)
def test_seeds_of_a_drive_s_corpus_reach_torque(target_name: str, tmp_path: Path) -> None:
    motor, reached_states = frame_targets.record_states_until_torque(target_name, tmp_path)
    assert {reached_state.state.phase for reached_state in reached_states} >= {
        DrivePhase.SILENT,
        DrivePhase.READY,
        DrivePhase.ENABLED,
    }
    drive_identifiers = frame_targets.selectable_identifiers(motor, reached_states)
    for data in seed_inputs(target_name, tmp_path):
        state, t_ns, received_frames = reached_states[data[0]]
        sent = [frame for frame, _ in frame_targets.frames_of_input(data, drive_identifiers, t_ns)]
        assert [(frame.can_id, frame.data) for frame in sent] == [
            (frame.can_id, frame.data) for frame in received_frames
        ]
        state_after = functools.reduce(motor.receive, sent, state)
        assert state_after.misread_frame_count == 0
        assert state_after.phase == functools.reduce(motor.receive, received_frames, state).phase


def test_a_changed_field_of_a_log_is_found_by_its_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    error_lines: list[str] = []
    monkeypatch.setattr(
        file_targets, "check_single_line_message", lambda error: error_lines.append(str(error))
    )
    target = TARGET_FACTORIES["log"](tmp_path)
    log_parts = log_targets._split_log(tmp_path / "small.mcap")
    messages = (
        (i, at)
        for i, records in enumerate(log_parts)
        for at, record in enumerate(records)
        if record[0] == Opcode.MESSAGE
    )
    part_index, record_index = next(messages)
    number = 22 + 4  # the tick number follows 22 bytes of message header and 4 bytes of encoding
    replaced, anywhere, given_value, one_byte = 3, 1, 0, 0
    mutation_choices = (part_index, record_index, replaced, number, anywhere, given_value, one_byte)
    assert not target(b"".join(n.to_bytes(2, "little") for n in mutation_choices) + b"\x07")
    assert len(error_lines) == 1
    assert "telemetry and ticks do not belong together" in error_lines[0]


@pytest.mark.parametrize("refusal_text", ["", "two\nlines"])
def test_the_fuzz_target_rejects_an_empty_or_two_line_refusal(
    refusal_text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse_with_text(*_: object) -> None:
        raise SimulatorError(refusal_text)

    monkeypatch.setattr(text_targets, "parse_fault", refuse_with_text)
    target = TARGET_FACTORIES["fault"](tmp_path)
    with pytest.raises(AssertionError):
        target(b"")


def test_fuzzing_without_an_accepted_input_is_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert fuzz_without_coverage.feed_inputs(
        lambda data: data > b"b", iter([b"a", b"b", b"c"] * 100), tmp_path, 0.0, 256
    ) == (256, 85)
    monkeypatch.chdir(tmp_path)
    for accepted_count, accepted in ((0, False), (64, True)):
        summary = (
            f"Done 256 runs in 2 second(s), {accepted_count} inputs accepted, corpus of 3 inputs"
        )
        done = subprocess.CompletedProcess([], 0, "", summary)
        monkeypatch.setattr(subprocess, "run", lambda *words, done=done, **keyword_arguments: done)
        line, good = fuzz_target("log", 0, 256, without_coverage=True)
        assert good == accepted
        assert ("25.0 % accepted" in line) == accepted
