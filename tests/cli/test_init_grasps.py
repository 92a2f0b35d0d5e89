"""Test the hand files that `config init` writes.

A hand with a hand file from `config init` can grasp, hold and release an object in a lockstep run.
An ordinary test run covers only a sample of these hand files.
"""

import itertools
import json
import re
from collections.abc import Iterable
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.core.gains.gains import Gains, MotionGains, packaged_gains
from handctl.core.hand_model import HandModel
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS
from handctl.hand.description import Hand
from handctl.hand.hand_loading import load_hand, packaged_hands
from handctl.programs.default_task import default_scene
from handctl.report.truth_record import read_truth
from handctl.session.run_plan import default_control_rate
from handctl.tune.loops.default_gains import (
    MIN_FORCE_FRACTION,
    MIN_PACKAGED_MARGIN_DB,
    default_gains,
)
from handctl.tune.loops.linear_models import LoopKind, open_loop
from handctl.tune.loops.margins import MIN_GAIN_MARGIN_DB, margins_of_loop
from tests.cli.command_refusals import refusal_line
from tests.cli.test_config_init import SENSOR_CASES, sensor_options
from tests.conftest import NIGHTLY

LINK_LENGTHS_MM = (
    "40",
    "60",
    "90",
    "120",
    "24,16",
    "40,30",
    "70,50",
    "18,12,10",
    "50,30,20",
    "55,40,25",
)
HAND_CASES = [
    (fingers, links, tendons, seed)
    for seed in range(2)
    for fingers in (1, 2, 3, 4)
    for links in LINK_LENGTHS_MM
    for tendons in ("one", "each")
    if tendons == "one" or "," in links
]
SAMPLE_CASES = [
    (1, "70,50", "one", 0),
    (2, "50,30,20", "each", 1),
    (2, "24,16", "each", 0),
    (1, "50,30,20", "each", 1),
]
"""Reproduce defects of four hands. Two of the four dropped the cylinder, and two reported a fault (N04 or T02b).

The first two hands dropped the cylinder, because the size of the cylinder did not depend on the
hand, and the fingertips touched each other. In the third hand, friction held a motor at rest, while
the motor of another tendon changed the tension (fault N04). In the last hand, the position feedback
paid out a slack tendon while the hand opened (fault T02b).
"""
MAX_SLIP_MM = 5.0


def write_initial_hand(*init_options: str) -> None:
    """Write the hand file mine.toml by running `config init` with the given options."""
    assert main(["config", "init", "--yes", *init_options, "--output", "mine.toml"]) == 0


def check_grasp(capsys: pytest.CaptureFixture[str], seed: int) -> None:
    """Run ``handctl demo`` with mine.toml, and check that the hand holds the object while the table sinks."""
    words = ["--hand", "mine.toml", "--log", "run.mcap", "--seed", str(seed), "--json"]
    code = main(["demo", "--lockstep", *words])
    out, err = capsys.readouterr()
    assert code == 0, err
    result = json.loads(out)
    assert result["table_sunk_mm"] > 50.0
    assert result["object_slid_mm"] < MAX_SLIP_MM


@pytest.mark.parametrize(
    ("finger_count", "link_lengths_mm", "tendon_choice", "seed"),
    HAND_CASES if NIGHTLY else SAMPLE_CASES,
)
def test_new_hand_grasps_holds_and_releases(
    work_folder: Path,
    capsys: pytest.CaptureFixture[str],
    finger_count: int,
    link_lengths_mm: str,
    tendon_choice: str,
    seed: int,
) -> None:
    write_initial_hand(
        "--fingers",
        str(finger_count),
        "--opposed",
        "1",
        "--links",
        link_lengths_mm,
        "--tendons",
        tendon_choice,
    )
    assert "warning" not in capsys.readouterr().out
    check_grasp(capsys, seed)
    truth = read_truth(work_folder / "run.truth")
    forces = [name for name in truth.columns if name.startswith("contact_force/")]
    assert forces
    # At the end of the demo, the object lies on the table, and no digit touches the object.
    assert abs(truth.interpolated_columns(forces, truth.t_ns[-1:])).max() == 0.0


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sensor_case", SENSOR_CASES, ids="-".join)
def test_every_choice_of_sensors_and_springs_grasps(
    work_folder: Path,
    capsys: pytest.CaptureFixture[str],
    sensor_case: tuple[str, str, str, str],
    seed: int,
) -> None:
    write_initial_hand("--fingers", "1", "--opposed", "1", *sensor_options(sensor_case))
    capsys.readouterr()
    check_grasp(capsys, seed)


THREE_LINK_CASES = [
    # The commissioning ended with a tendon that had left its pulley (fault T08), because the rotor
    # of the released extensor turned back.
    ("18,12,10", ("each", "none", "none", "all"), 0),
    # The opening of the hand ended with a tendon that stays slack (fault T02b), because the motor
    # paid out more and more of this tendon.
    ("55,40,25", ("each", "all", "none", "none"), 1),
    # The hold ended with a snapped tendon (fault T01), because the tensions oscillated at 250 Hz.
    ("55,40,25", ("each", "none", "none", "none"), 1),
]
"""For each of three defects: the link lengths [mm], the answers in the format of ``SENSOR_CASES``, and the seed."""
NIGHTLY_THREE_LINK_CASES = [
    (links, case, seed)
    for links in ("18,12,10", "50,30,20", "55,40,25")
    for case in SENSOR_CASES
    if case[0] == "each" and case[2] == "none"
    for seed in range(4)
]


@pytest.mark.parametrize(
    ("link_lengths_mm", "sensor_case", "seed"),
    NIGHTLY_THREE_LINK_CASES if NIGHTLY else THREE_LINK_CASES,
)
def test_three_links_without_load_cells_grasp(
    work_folder: Path,
    capsys: pytest.CaptureFixture[str],
    link_lengths_mm: str,
    sensor_case: tuple[str, str, str, str],
    seed: int,
) -> None:
    write_initial_hand(
        "--fingers", "1", "--opposed", "1", "--links", link_lengths_mm, *sensor_options(sensor_case)
    )
    capsys.readouterr()
    check_grasp(capsys, seed)


def test_the_object_suits_the_digits(work_folder: Path) -> None:
    write_initial_hand("--links", "40,30")
    assert default_scene(load_hand("mine.toml")) == "cylinder:52"


def test_the_object_fits_between_the_digits(work_folder: Path) -> None:
    write_initial_hand("--links", "70,50", "--palm", "60")
    assert default_scene(load_hand("mine.toml")) == "cylinder:43"


@pytest.mark.parametrize(
    ("finger_count", "opposed_digit_count", "link_lengths_mm"),
    [(4, 1, "55,40,25"), (4, 4, "40,30"), (3, 0, "40,30")],
)
def test_no_bus_is_slower_than_250_hz(
    work_folder: Path, finger_count: int, opposed_digit_count: int, link_lengths_mm: str
) -> None:
    write_initial_hand(
        "--fingers",
        str(finger_count),
        "--opposed",
        str(opposed_digit_count),
        "--links",
        link_lengths_mm,
        "--tendons",
        "each",
    )
    assert default_control_rate(load_hand("mine.toml")) >= 250.0


@pytest.mark.parametrize("cells", ["all", "none"])
@pytest.mark.parametrize("protocol", VERIFIABLE_PROTOCOLS)
def test_a_hand_of_any_protocol_is_valid(work_folder: Path, protocol: str, cells: str) -> None:
    """Each hand file without load cells contains the drive options with which the drives report their torque."""
    write_initial_hand("--protocol", protocol, "--cells", cells)
    assert main(["config", "check", "--hand", "mine.toml"]) == 0


def test_a_rate_that_leaves_no_margin_is_a_warning(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_initial_hand(
        "--fingers", "3", "--opposed", "1", "--links", "50,30,20", "--tendons", "each"
    )
    assert main(["config", "check", "--hand", "mine.toml"]) == 0
    assert "gain margin" not in capsys.readouterr().out, "two buses allow 250 Hz"
    text = re.sub(r', m[1-3]\.bus = "bus_2"', "", Path("mine.toml").read_text())
    text = text.replace('[[bus]]\nname = "bus_2"\nbitrate = 1_000_000\n\n', "")
    numbers = itertools.count(1)
    Path("mine.toml").write_text(
        re.sub(r"node_id = \d+", lambda _: f"node_id = {next(numbers)}", text)
    )
    assert main(["config", "check", "--hand", "mine.toml"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if "gain margin" in line)
    assert float(re.search(r"gain margin of ([0-9.]+) dB", line)[1]) < 6.0
    assert "at 100 Hz, which the buses allow" in line
    assert line.endswith("; 2 buses allow 250 Hz (bus plan --rate 250)")


@pytest.mark.parametrize(("link_lengths_mm", "margin_db"), [("55,40,25", 3.5), ("50,30,20", 4.3)])
def test_gains_that_leave_no_margin_without_load_cells_are_a_warning(
    work_folder: Path, capsys: pytest.CaptureFixture[str], link_lengths_mm: str, margin_db: float
) -> None:
    """Reproduce a defect: `config check` did not check the gain margin at 400 Hz for a hand without load cells.

    The hand of this test has springs.
    """
    write_initial_hand(
        "--fingers", "1", "--links", link_lengths_mm, "--tendons", "each", "--cells", "none"
    )
    Path("gains.toml").write_text("schema = 1\n\n[motion]\nforce_N = 13.0\n")
    assert main(["config", "check", "--hand", "mine.toml", "--gains", "gains.toml"]) == 0
    warning_lines = [line for line in capsys.readouterr().out.splitlines() if "gain margin" in line]
    [line] = {line.partition("warning: ")[2] for line in warning_lines}
    assert line.startswith("motion.force_N: 13 N leave the motion loop of index_t1 a gain margin")
    assert f"a gain margin of {margin_db} dB instead of 6 dB at 400 Hz; expected" in line
    force = float(re.search(r"expected at most ([0-9.]+) N$", line)[1])
    assert 0.4 * 13.0 < force < 13.0
    assert (
        main(["config", "check", "--hand", "mine.toml", "--gain", f"motion.force_N={force}"]) == 0
    )
    assert "warning: motion.force_N" not in capsys.readouterr().out


@pytest.mark.parametrize("rate_hz", [500.0, 200.0, 100.0])
@pytest.mark.parametrize("hand_file", ["pairs_and_springs.toml", "mixed_gripper.toml"])
def test_the_default_force_leaves_the_gain_margin(hand_file: str, rate_hz: float) -> None:
    """The default force of each digit is the largest of the candidate values that keep the required gain margin.

    The next larger candidate for the force would make the gain margin smaller than required.
    """
    hand = load_hand(Path(__file__).parents[1] / "hand" / hand_file)
    gains = default_gains(hand, rate_hz)
    for digit in hand.digit:
        tendons = hand.tendon_names[hand.digit_tendons[digit.name]]
        (force,) = {gains.force_weights_of_tendon(tendon)[0] for tendon in tendons}
        margin = margin_of_tendons(hand, force, rate_hz, tendons)
        if force == Gains().motion.force_N:
            required = MIN_PACKAGED_MARGIN_DB if digit.has_springs else MIN_GAIN_MARGIN_DB
            smallest_force = MIN_FORCE_FRACTION * force
            assert (
                margin >= required
                or margin_of_tendons(hand, smallest_force, rate_hz, tendons) < MIN_GAIN_MARGIN_DB
            )
            continue
        assert margin >= MIN_GAIN_MARGIN_DB
        assert margin_of_tendons(hand, 1.12 * force, rate_hz, tendons) < MIN_GAIN_MARGIN_DB


def margin_of_tendons(hand: Hand, force: float, rate_hz: float, tendons: Iterable[str]) -> float:
    """Return the smallest gain margin [dB] of the tendons' motion loops, with ``motion.force_N`` = ``force``."""
    model = HandModel.from_hand(hand, gains_with_force(force), rate_hz)
    return min(
        margins_of_loop(open_loop(model, hand.tendon_names.index(name), LoopKind.MOTION)).gain_db
        for name in tendons
    )


def gains_with_force(force_N: float) -> Gains:
    """Return the packaged gains, but with ``motion.force_N`` = ``force_N`` [N]."""
    return Gains(motion=MotionGains(force_N=force_N))


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_the_default_gains_of_a_packaged_hand_are_packaged(hand_name: str) -> None:
    assert default_gains(load_hand(hand_name), 100.0) == packaged_gains(hand_name)


def test_antagonists_without_load_cells_need_a_higher_rate(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Reproduce a defect: at 250 Hz, handctl reported a snapped tendon (fault T01) while a digit closed freely."""
    words = ["--fingers", "1", "--links", "55,40,25", "--tendons", "each", "--springs", "none"]
    write_initial_hand(*words, "--cells", "none")
    hand = load_hand("mine.toml")
    assert default_control_rate(hand) >= 500.0
    assert main(["config", "check", "--hand", "mine.toml"]) == 0
    assert "gain margin of" not in capsys.readouterr().out
    text = Path("mine.toml").read_text()
    text = re.sub(r', (m[1-3]|e)\.bus = "bus_2"', "", text)
    text = text.replace('[[bus]]\nname = "bus_2"\nbitrate = 1_000_000\n\n', "")
    numbers = itertools.count(1)
    text = re.sub(r"node_id = \d+", lambda _: f"node_id = {next(numbers)}", text)
    Path("mine.toml").write_text(text)
    assert main(["config", "check", "--hand", "mine.toml"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if "gain margin" in line)
    assert float(re.search(r"gain margin of ([0-9.]+) dB", line)[1]) < 6.0
    assert line.endswith("end with T01; 2 buses allow 500 Hz (bus plan --rate 500)")


@pytest.mark.parametrize(
    ("init_options", "expected_reason"),
    [
        (("--opposed", "0"), "no digit closes against another: the default task lifts no object"),
        (("--tension", "15"), "pressing with 1 N at its tip takes"),
        (
            ("--fingers", "1", "--palm", "50"),
            "--palm 50: tips of 70 mm digits may meet around an object that fits",
        ),
    ],
)
def test_config_check_warns_of_a_hand_that_cannot_grasp(
    work_folder: Path,
    capsys: pytest.CaptureFixture[str],
    init_options: tuple[str, ...],
    expected_reason: str,
) -> None:
    write_initial_hand(*init_options)
    out = capsys.readouterr().out
    assert "warning: " in out
    assert expected_reason in out
    assert "next: handctl" in out


def test_a_palm_too_small_for_an_object_is_refused(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refusal_line(capsys, "config", "init", "--yes", "--palm", "14", "--output", "mine.toml")
    assert "--palm: 14; expected at least" in line
