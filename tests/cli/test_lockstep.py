"""Test ``handctl demo`` in virtual time.

Two demos with equal options write files with equal bytes. All checks of a demo pass, and other
tools can read the log of a demo.
"""

import json
import os
import subprocess
import sys
import time

import pytest
import rerun
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from handctl.cli.main import main
from handctl.log.read.reader import RunLog
from tests.conftest import NIGHTLY
from tests.runtime.processes import SHORT_TASK

RESULT_KEYS = {
    "ticks", "missed", "late_us", "tracking_rmse_rad", "tension_rmse_n", "tension_hold_error_n",
    "frames_tx", "frames_rx", "frames_late", "frames_lost", "silent_ticks", "joint_angles", "bus_load", "log",
}  # fmt: skip


def run_demos(result_folder, *hand_names, task_file=""):
    """Run lockstep demos of hands in parallel processes, and return the folder and the result of each.

    If ``task_file`` is not empty, each demo executes the task in ``task_file`` instead of the
    default grasp.
    """
    running = []
    for number, hand in enumerate(hand_names):
        time.sleep(1.1 * number)  # the two runs start in different seconds of the wall clock
        demo_folder = result_folder / str(number)
        demo_folder.mkdir()
        command = [
            sys.executable,
            "-m",
            "handctl.cli",
            "demo",
            "--lockstep",
            "--json",
            "--log",
            "run.mcap",
        ]
        if task_file:
            (demo_folder.parent / "task.toml").write_text(task_file)
            command += ["--task", "../task.toml", "--scene", "none"]
        options = {
            "cwd": demo_folder,
            "stdout": subprocess.PIPE,
            "stderr": subprocess.PIPE,
            "text": True,
        }
        environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        running.append(
            (demo_folder, subprocess.Popen([*command, "--hand", hand], env=environment, **options))
        )
    results = []
    for demo_folder, process in running:
        out, err = process.communicate(timeout=280)
        assert process.returncode == 0, err
        results.append((demo_folder, json.loads(out)))
    return results


@pytest.fixture(scope="module")
def equal_demos(tmp_path_factory):
    """Return the folders and the results of two demos with the same hand, task and seed.

    In an ordinary test run, each of the two demos executes a short motion. In a nightly test run,
    each demo executes a grasp.
    """
    return run_demos(
        tmp_path_factory.mktemp("equal_demos"),
        "jamia",
        "jamia",
        task_file="" if NIGHTLY else SHORT_TASK,
    )


@pytest.fixture(scope="module")
def default_demo(tmp_path_factory):
    """Return the folder and the result of the demo with the default hand."""
    return run_demos(tmp_path_factory.mktemp("default_demo"), "jamia")[0]


@pytest.fixture(scope="module")
def jamia11_demo(tmp_path_factory):
    """Return the folder and the result of the demo with the hand jamia11, which has one motor per joint."""
    return run_demos(tmp_path_factory.mktemp("jamia11_demo"), "jamia11")[0]


def messages_of(log_path):
    """Return the topic, the time and the data of every message in a log, in the order of the file."""
    with log_path.open("rb") as file:
        messages = make_reader(file).iter_messages(log_time_order=False)
        return [(channel.topic, message.log_time, message.data) for _, channel, message in messages]


DEMO_FILES = {"run.mcap", "run.truth", "run.png", "run.commission.mcap", "run.calibration.toml"}


@pytest.mark.parametrize("file_name", sorted(DEMO_FILES))
def test_two_runs_write_the_same_bytes(equal_demos, file_name):
    (first_folder, _), (second_folder, _) = equal_demos
    content, other_content = (
        (first_folder / file_name).read_bytes(),
        (second_folder / file_name).read_bytes(),
    )
    assert len(content) == len(other_content)
    differing_positions = (
        [i for i, (a, b) in enumerate(zip(content, other_content, strict=True)) if a != b]
        if content != other_content
        else []
    )
    assert not differing_positions, (
        f"{len(differing_positions)} bytes differ, the first at {differing_positions[0]}"
    )


def test_lockstep_demo_writes_exactly_its_files(equal_demos):
    for demo_folder, _ in equal_demos:
        assert {path.name for path in demo_folder.iterdir()} == DEMO_FILES
    assert len(messages_of(equal_demos[0][0] / "run.mcap")) > (50_000 if NIGHTLY else 10_000)


def test_two_lockstep_runs_print_equal_results(equal_demos):
    (_, first_result), (_, second_result) = equal_demos
    wall = ("wall_s", "times_real_time")
    assert {key: value for key, value in first_result.items() if key not in wall} == {
        key: value for key, value in second_result.items() if key not in wall
    }


def meets_requirements(demo_result):
    assert demo_result.keys() >= RESULT_KEYS
    assert demo_result["late_us"].keys() >= {"p50", "p99_9", "max"}
    assert (
        demo_result["missed"],
        demo_result["frames_late"],
        demo_result["frames_lost"],
        demo_result["failure"],
    ) == (
        0,
        0,
        0,
        "",
    )
    assert demo_result["object_motion_mm"] < 1.0
    assert demo_result["tension_hold_error_n"] < 2.0
    assert len(demo_result["tracking_rmse_deg"]) == 4
    assert max(demo_result["tracking_rmse_deg"].values()) < 1.0
    assert demo_result["bus_load"] < 0.7
    for digit, force in demo_result["contact_force_n"].items():
        assert force > 0.5, digit
        assert demo_result["tip_equivalent_force_n"][digit] is not None


@pytest.mark.nightly
def test_the_demo_meets_its_requirements(default_demo):
    """The demo of the default hand stays within all limits. The file tests/cli/test_seeds.py tests the hand jamia11."""
    result = default_demo[1]
    meets_requirements(result)
    assert result["tension_rmse_n"] < result["tension_raw_rmse_n"]


@pytest.mark.nightly
def test_the_demo_with_one_motor_per_joint_meets_its_requirements(jamia11_demo):
    result = jamia11_demo[1]
    meets_requirements(result)
    assert result["tension_rmse_n"] < 1.0


def test_ros_reads_every_message(equal_demos):
    path = equal_demos[0][0] / "run.mcap"
    with AnyReader([path]) as reader:
        message_count = 0
        for connection, _, raw in reader.messages():
            assert reader.deserialize(raw, connection.msgtype) is not None
            message_count += 1
    assert message_count == len(messages_of(path))


def test_rerun_finds_the_moving_hand(equal_demos):
    chunks = rerun.chunk.McapReader(equal_demos[0][0] / "run.mcap").stream().to_chunks()
    paths = {str(chunk.entity_path) for chunk in chunks}
    assert "/tf" in paths
    assert any("joint_states" in path for path in paths)


def test_a_report_aligns_the_log_with_the_truth_file(equal_demos, capsys):
    """Reproduce a defect: without ``--truth``, ``handctl report`` did not use the truth file next to the log."""
    demo_folder, result = equal_demos[0]
    tension = f"{result['tension_rmse_n']:.2f} N rms"
    for words in (("--truth", str(demo_folder / "run.truth")), ()):
        page = demo_folder / "page.html"
        assert main(["report", str(demo_folder / "run.mcap"), *words, "--output", str(page)]) == 0
        assert tension in page.read_text()
        page.unlink()
    assert (
        main(["report", str(demo_folder / "run.mcap"), "--output", str(demo_folder / "run.truth")])
        == 2
    )


def test_the_log_is_complete_and_has_every_tick(equal_demos):
    demo_folder, result = equal_demos[0]
    with RunLog(demo_folder / "run.mcap") as run:
        assert not run.warning
        assert not run.gaps
        assert len(run) == result["ticks"]


def test_a_lockstep_run_shows_its_progress(work_folder, capfd):
    (work_folder / "short.toml").write_text(SHORT_TASK)
    assert main(["demo", "--lockstep", "--task", "short.toml", "--log", "run.mcap"]) == 0
    error_output = capfd.readouterr().err
    assert "1.000 s  ACTIVE    bend       tension" in error_output
    assert "pulling thumb_tendon with 3 N" in error_output, "progress of the commissioning is shown"
