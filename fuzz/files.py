"""Files that a person writes: hand, task, trajectory, gains and calibration, as noise and as nearly right ones."""

import math
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fuzz.mutate import Source, mutated, places
from handctl.cli.plan import find_task, find_trajectory
from handctl.controller.bus_load import bus_loads
from handctl.controller.calibration import load_calibration
from handctl.controller.gains import Gains, load_gains, load_gains_file
from handctl.controller.identified import identified_hand
from handctl.document import validated
from handctl.drives.registry import make_drive
from handctl.errors import HandctlError
from handctl.hand.description import HANDS, Hand, hand_from, load_hand, packaged_hands
from handctl.hand.digit import DigitModel
from handctl.hand.toml_text import toml_text

Target = Callable[[bytes], bool]
TASKS = HANDS.parents[1] / "tasks"


def used(hand: Hand) -> None:
    """Everything that a program makes of a hand before it opens a bus."""
    for name in hand.digit_names:
        DigitModel.of(hand, name)
    for motor in hand.motor:
        make_drive(motor, hand.bus_names.index(motor.bus))
    bus_loads(hand)


def hand(folder: Path) -> Target:
    """A hand, changed in up to four places."""
    contents = [tomllib.loads((HANDS / f"{name}.toml").read_text()) for name in packaged_hands()]
    known = [list(places(content)) for content in contents]

    def target(data: bytes) -> bool:
        source = Source(data)
        i = source.number(len(contents))
        content = mutated(contents[i], known[i], source)
        try:
            used(hand_from(content, "fuzzed"))
        except HandctlError as error:
            one_line(error)
            return False
        return True

    return target


def hand_text(folder: Path) -> Target:
    """A hand file of any bytes."""
    return _text(folder / "hand.toml", lambda path: used(load_hand(str(path))))


def one_line(error: HandctlError) -> None:
    """An error is one line."""
    assert str(error), "an error without words"
    assert "\n" not in str(error), str(error)


def _text(path: Path, load: Callable[[Path], object]) -> Target:
    def target(data: bytes) -> bool:
        path.write_bytes(data)
        try:
            load(path)
        except HandctlError as error:
            one_line(error)
            return False
        return True

    return target


def _document(path: Path, contents: list[Mapping[str, Any]], load: Callable[[Path], object]) -> Target:
    """A document: of any bytes, or a good one changed in up to four places."""
    known = [list(places(content)) for content in contents]
    noise = _text(path, load)

    def target(data: bytes) -> bool:
        source = Source(data)
        i = source.number(len(contents) + 1)
        if i == len(contents):
            return noise(data[source.at :])
        text = toml_text(mutated(contents[i], known[i], source))
        return noise(text.encode("utf-8", "surrogatepass"))

    return target


def task(folder: Path) -> Target:
    """A task, checked against the hand."""
    jamia, contents = load_hand("jamia"), [tomllib.loads(path.read_text()) for path in sorted(TASKS.glob("*.toml"))]
    return _document(folder / "task.toml", list(contents), lambda path: find_task(path, jamia))


def trajectory(folder: Path) -> Target:
    """A trajectory, checked against the hand."""
    jamia = load_hand("jamia")
    angles = [30.0 * math.sin(0.5 * i) ** 2 for i in range(8)]
    content = {"schema": 1, "name": "t", "time_s": [0.3 * i for i in range(8)], "angle_deg": {"index": angles}}
    return _document(folder / "trajectory.toml", [content], lambda path: find_trajectory(path, jamia))


def gains(folder: Path) -> Target:
    """Gains of a run, and with their provenance."""
    packaged = Gains().model_dump(by_alias=True)
    validated(packaged, Gains, "packaged")
    return _document(folder / "gains.toml", [packaged], lambda path: (load_gains(path), load_gains_file(path)))


def calibration(folder: Path) -> Target:
    """A calibration with something identified, and the hand that comes of it."""
    jamia = load_hand("jamia")
    tendon = {"tare_N": 0.1, "zero_rad": 1.0, "answer_N": 3.0, "crosstalk_N": 0.1}
    found = {"names": ["motor_coulomb"], "values": [0.01], "half_widths": [1e-3], "covariance": [[1e-6]]}
    content = {
        "schema": 1,
        "hand": jamia.name,
        "identity": jamia.identity,
        "made": "2026-01-01T00:00:00+00:00",
        "tendon": {name: dict(tendon) for name in jamia.tendon_names},
        "identified": {jamia.tendon_names[0]: found},
    }

    def load(path: Path) -> None:
        loaded = load_calibration(path, jamia)
        loaded.tare(jamia), loaded.zero(jamia)
        identified_hand(jamia, loaded.identified)

    return _document(folder / "calibration.toml", [content], load)
