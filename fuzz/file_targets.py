"""Fuzzing targets for the files that users write.

A user can write files for a hand, a task, a trajectory, gains and a calibration. The inputs of a
fuzzing target are random bytes, or nearly valid files.
"""

import math
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fuzz.document_mutation import ByteSource, mutated_content, paths_of_values
from handctl.controller.bus_load import bus_loads
from handctl.core.calibration import parse_calibration
from handctl.core.gains.gains import Gains, GainsFile, GainsProvenance
from handctl.core.identified_parameters import identified_hand
from handctl.document import validate_content
from handctl.drives.protocol_registry import make_drive
from handctl.errors import HandctlError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.file.toml_text import toml_text
from handctl.hand.hand_loading import (
    PACKAGED_HANDS_FOLDER,
    hand_content,
    hand_from_content,
    load_hand,
    packaged_hands,
    read_toml,
)
from handctl.programs.task import Task, task_from_trajectory_file
from handctl.session.task_loading import check_task_for_hand

FuzzTarget = Callable[[bytes], bool]
FileContent = Mapping[str, Any]
TASKS_FOLDER = PACKAGED_HANDS_FOLDER.parents[1] / "tasks"


def construct_hand_parts(hand: Hand) -> None:
    """Construct the digits, drives and bus loads of a hand, as a run does before it opens a bus."""
    for name in hand.digit_names:
        DigitModel.from_hand(hand, name)
    for motor in hand.motor:
        make_drive(motor, hand.bus_names.index(motor.bus))
    bus_loads(hand)


def hand_fuzz_target(folder: Path) -> FuzzTarget:
    """Return the fuzzing target that loads a packaged hand file with up to four changes."""
    contents = [hand_content(name) for name in packaged_hands()]
    paths = [list(paths_of_values(content)) for content in contents]

    def target(data: bytes) -> bool:
        source = ByteSource(data)
        i = source.take_number(len(contents))
        content = mutated_content(contents[i], paths[i], source)
        return _is_accepted(lambda: construct_hand_parts(hand_from_content(content, "fuzzed")))

    return target


def hand_text_fuzz_target(folder: Path) -> FuzzTarget:
    """Return the fuzzing target that loads arbitrary bytes as a hand file."""
    return _text_fuzz_target(
        folder / "hand.toml", lambda path: construct_hand_parts(load_hand(str(path)))
    )


def check_single_line_message(error: Exception) -> None:
    """Check that the message of an error is exactly one line."""
    assert str(error), "an error without text"
    assert "\n" not in str(error), str(error)


def _text_fuzz_target(file_path: Path, load_file: Callable[[Path], object]) -> FuzzTarget:
    def target(data: bytes) -> bool:
        file_path.write_bytes(data)
        return _is_accepted(lambda: load_file(file_path))

    return target


def _is_accepted(load_input: Callable[[], object]) -> bool:
    """Return True if the loading function accepts its input.

    If the loading function refuses the input, check that the error message is one line.
    """
    try:
        load_input()
    except HandctlError as error:
        check_single_line_message(error)
        return False
    return True


INPUT_KIND_COUNT = 32
"""Number of different values that select the kind of an input.

One of the values selects random bytes. Another value selects a changed document that is written as
text and parsed. All other values select changed documents that need no parsing, because parsing is
slow.
"""


def _document_fuzz_target(
    file_path: Path,
    file_contents: list[FileContent],
    process_content: Callable[[FileContent], object],
) -> FuzzTarget:
    """Return the fuzzing target for one kind of TOML file.

    The inputs are arbitrary bytes, or a valid document with up to four changes.
    """
    paths = [list(paths_of_values(content)) for content in file_contents]
    parse_text = _text_fuzz_target(file_path, lambda file: process_content(read_toml(file)))

    def target(data: bytes) -> bool:
        source = ByteSource(data)
        kind = source.take_number(INPUT_KIND_COUNT)
        if kind == 1:
            return parse_text(data[source.at :])
        i = source.take_number(len(file_contents))
        content = mutated_content(file_contents[i], paths[i], source)
        if kind == 2:
            return parse_text(toml_text(content).encode("utf-8", "surrogatepass"))
        return _is_accepted(lambda: process_content(content))

    return target


def task_fuzz_target(folder: Path) -> FuzzTarget:
    """Return the fuzzing target that reads a task file and checks whether the task fits a hand."""
    jamia = load_hand("jamia")
    contents = [tomllib.loads(path.read_text()) for path in sorted(TASKS_FOLDER.glob("*.toml"))]
    return _document_fuzz_target(
        folder / "task.toml",
        list(contents),
        lambda content: check_task_for_hand(
            validate_content(content, Task, "fuzzed"), jamia, "fuzzed"
        ),
    )


def trajectory_fuzz_target(folder: Path) -> FuzzTarget:
    """Return the fuzzing target that reads a trajectory file and checks whether the trajectory fits a hand."""
    jamia = load_hand("jamia")
    angles = [30.0 * math.sin(0.5 * i) ** 2 for i in range(8)]
    content = {
        "schema": 1,
        "name": "t",
        "time_s": [0.3 * i for i in range(8)],
        "angle_deg": {"index": angles},
    }
    return _document_fuzz_target(
        folder / "trajectory.toml",
        [content],
        lambda content: check_task_for_hand(
            task_from_trajectory_file(content, "fuzzed"), jamia, "fuzzed"
        ),
    )


def gains_fuzz_target(folder: Path) -> FuzzTarget:
    """Return the fuzzing target that reads a gains file and the provenance of its gains."""
    packaged = Gains().model_dump(by_alias=True)
    content = packaged | {
        "provenance": GainsProvenance(hand="jamia", number=3, log=("a.mcap",)).model_dump()
    }
    del content["provenance"]["restores"]
    validate_content(content, GainsFile, "packaged")
    return _document_fuzz_target(
        folder / "gains.toml",
        [content],
        lambda content: validate_content(content, GainsFile, "fuzzed").gains,
    )


def calibration_fuzz_target(folder: Path) -> FuzzTarget:
    """Return the fuzzing target that applies a calibration to a hand.

    The fuzzing target reads the calibration from a file, which also contains identified parameters.
    """
    jamia = load_hand("jamia")
    tendon = {"tare_N": 0.1, "zero_rad": 1.0, "answer_N": 3.0, "crosstalk_N": 0.1}
    identified = {
        "names": ["motor_coulomb"],
        "values": [0.01],
        "half_widths": [1e-3],
        "covariance": [[1e-6]],
    }
    content = {
        "schema": 1,
        "hand": jamia.name,
        "identity": jamia.identity,
        "made": "2026-01-01T00:00:00+00:00",
        "tendon": {name: dict(tendon) for name in jamia.tendon_names},
        "identified": {jamia.tendon_names[0]: identified},
    }

    def use_calibration(content: FileContent) -> None:
        loaded_calibration = parse_calibration(content, jamia, "fuzzed")
        loaded_calibration.tare_tensions(jamia), loaded_calibration.motor_zeros(jamia)
        identified_hand(jamia, loaded_calibration.identified)

    return _document_fuzz_target(folder / "calibration.toml", [content], use_calibration)
