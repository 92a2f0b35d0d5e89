"""Test the conditions for the success of ``handctl demo``.

The tests use hands that differ slightly from packaged hands.
"""

import json

import pytest

from handctl.cli.main import main
from handctl.hand.file.toml_text import toml_text
from handctl.hand.hand_loading import hand_content, load_hand
from handctl.session.calibration import load_calibration
from tests.cli.command_refusals import refusal_line
from tests.runtime.processes import make_time_scale_options, run_handctl

GRASP_TASK = """schema = 1
name = "two fingers"
[[phase]]
kind = "close"
name = "close"
angle_deg = 85.0
speed_deg_s = 80.0
contact_tension_N = 18.0
[[phase]]
kind = "hold"
name = "carry"
tension_N = 30.0
rate_N_per_s = 100.0
duration_s = 1.0
"""


def jamia_hand_content():
    return hand_content("jamia")


def two_fingers():
    """Return a hand that has only an index finger and a middle finger.

    Both fingers close in the same direction, so the hand cannot lift objects.
    """
    content = jamia_hand_content()
    for section in ("digit", "tendon", "motor"):
        content[section] = content[section][:2]
    node = content["sensor_node"]
    node["tendons"] = node["tendons"][:2]
    node["joints"] = [joint for joint in node["joints"] if joint.startswith(("index", "middle"))]
    return content


def two_buses():
    """Return a hand whose thumb and ring finger are on a second bus."""
    content = jamia_hand_content()
    content["bus"].append({**content["bus"][0], "name": "second"})
    for motor in content["motor"][2:]:
        motor["bus"] = "second"
    return content


def test_a_grasp_that_lifts_nothing_is_a_failure(work_folder, capsys):
    (work_folder / "two.toml").write_text(toml_text(two_fingers()))
    (work_folder / "grasp.toml").write_text(GRASP_TASK)
    assert (
        main(
            [
                "demo",
                "--lockstep",
                "--json",
                "--hand",
                "two.toml",
                "--task",
                "grasp.toml",
                "--log",
                "x.mcap",
            ]
        )
        == 1
    )
    shown_output = capsys.readouterr()
    result = json.loads(shown_output.out)
    assert "never lifted" in result["failure"]
    assert result["table_sunk_mm"] == 0.0
    assert list(result["digit_forces_N"]) == ["index", "middle"]
    forces = result["digit_forces_N"]
    assert f"on each digit: index {forces['index']:.1f} N, middle" in result["failure"]
    assert result["object_motion_mm"] is None
    assert shown_output.err.splitlines()[-1].startswith(
        "handctl: two fingers on cylinder: the object was never lifted"
    )


def test_a_demo_overwrites_no_calibration(work_folder, capsys):
    """Reproduce a defect.

    With ``--log jamia.mcap``, the demo overwrote jamia.calibration.toml, the calibration of a real
    hand.
    """
    path = work_folder / "jamia.calibration.toml"
    path.write_text("of the real hand")
    assert main(["demo", "--lockstep", "--log", "jamia.mcap"]) == 2
    assert "would overwrite jamia.calibration.toml" in capsys.readouterr().err
    assert path.read_text() == "of the real hand"
    assert main(["demo", "--lockstep", "--log", "other.mcap"]) == 0
    calibration = load_calibration(work_folder / "other.calibration.toml", load_hand("jamia"))
    assert calibration.simulated


def test_a_hand_of_two_buses_needs_no_bus_named(work_folder, capsys):
    (work_folder / "buses.toml").write_text(toml_text(two_buses()))
    assert main(["demo", "--hand", "buses.toml", "--dry-run"]) == 0
    assert "jamia: power grasp on cylinder" in capsys.readouterr().out


@pytest.mark.realtime
def test_a_hand_of_two_buses_works_in_real_time(work_folder, time_scale_of_attempt):
    (work_folder / "buses.toml").write_text(toml_text(two_buses()))
    (work_folder / "bend.toml").write_text(
        'schema = 1\nname = "bend"\n[[phase]]\nkind = "move"\nangle_deg = 20.0\n'
    )
    words = ("--hand", "buses.toml", "--task", "bend.toml", "--scene", "none", "--log", "x.mcap")
    done = run_handctl("demo", "--json", *words, *make_time_scale_options(time_scale_of_attempt))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["failure"] == ""


@pytest.mark.parametrize("load_cell_lines", [[], ["index_tendon"]])
def test_a_hand_without_load_cells_is_ready_and_the_faults_that_need_them_are_named(
    work_folder, capsys, load_cell_lines
):
    content = jamia_hand_content()
    content["sensor_node"]["tendons"] = load_cell_lines
    (work_folder / "hand.toml").write_text(toml_text(content))
    assert main(["config", "check", "--hand", "hand.toml"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if ": no load cell: " in line)
    assert "not judged: N02, N14b" in line
    assert ("index_tendon" in line) == (not load_cell_lines), (
        "only tendons without a load cell are named"
    )


@pytest.mark.parametrize("cli_verb", ["config", "demo"])
def test_a_joint_that_no_tendon_crosses_is_one_line(work_folder, capsys, cli_verb):
    content = jamia_hand_content()
    del content["tendon"][0]["moment_arm_m"]["index_j3"]
    (work_folder / "hand.toml").write_text(toml_text(content))
    line = refusal_line(
        capsys, cli_verb, "check" if cli_verb == "config" else "--lockstep", "--hand", "hand.toml"
    )
    assert "digit[index]: no tendon crosses index_j3" in line
