"""Test handctl and the simulated hand in two processes with a real-time clock.

The tests cover the start and the end of runs. Simulated time is slower than real time, so that a
stall of the machine does not end a run.
"""

import itertools
import signal

import pytest

from handctl.hand.file.toml_text import toml_text
from handctl.hand.hand_loading import hand_content, load_hand
from handctl.log.read.reader import RunLog
from handctl.report.truth_record import read_truth
from handctl.runtime.mailbox import StatusWatcher
from tests.runtime.processes import (
    LOCAL_BUS,
    end_process,
    modes_of_complete_log,
    process_result,
    run_handctl,
    socket_names,
    start_hand,
    start_handctl,
    wait_for_phase,
    write_homed_calibration,
)

pytestmark = pytest.mark.realtime


def run_short_task(work_folder, started_processes, time_scale_options):
    """Commission a new simulated hand and run a short task.

    Return the result of ``handctl run`` and the path of its log.
    """
    truth = work_folder / "hand.truth"
    log = work_folder / "run.mcap"
    started_processes.append(start_hand(truth, "--hand", "jamia", *time_scale_options))
    words = (
        "--task",
        "short.toml",
        "--json",
        "--log",
        str(log),
        *time_scale_options,
        "--truth",
        str(truth),
    )
    started_processes.append(start_handctl("run", "--hand", "jamia", "--bus", LOCAL_BUS, *words))
    result = process_result(started_processes.pop())
    end_process(started_processes.pop())
    return result, log


def test_a_run_commissions_moves_and_reports_its_result(
    work_folder, started_processes, time_scale_options
):
    (code, result, err), log = run_short_task(work_folder, started_processes, time_scale_options)
    assert code == 0, err
    assert err.startswith("commissioning jamia first: there is no jamia.calibration.toml")
    assert result["failure"] == ""
    assert result["log_complete"] is True
    assert result["ticks"] + result["missed"] > 500
    assert result["frames_lost"] < 0.01 * result["frames_rx"]
    assert set(result["late_us"]) == {"p50", "p99_9", "max"}
    assert max(result["tracking_rmse_deg"].values()) < 1.0
    modes = modes_of_complete_log(log)
    order = ["SILENT", "INVENTORY", "READY", "ARMING", "ACTIVE", "RELAX", "DISARM", "DONE"]
    assert modes == [f"{a} -> {b}" for a, b in itertools.pairwise(order)]
    assert not [name for name in socket_names() if name.endswith(".requests")]


def start_long_task(started_processes, calibration_options, *extra_options):
    """Start a run that stays in the last phase of its task until it is stopped. Wait for the last phase."""
    process = start_handctl(
        "run",
        *calibration_options,
        "--task",
        "long.toml",
        "--json",
        "--log",
        "run.mcap",
        *extra_options,
    )
    started_processes.append(process)
    watcher = StatusWatcher(LOCAL_BUS)
    try:
        wait_for_phase("stay", watcher, process)
    finally:
        watcher.close()
    return process


def test_a_stop_from_another_process_ends_the_run(
    work_folder, hand_truth_file, calibration_options, started_processes, time_scale_options
):
    process = start_long_task(started_processes, calibration_options, *time_scale_options)
    second_process_result = run_handctl(
        "run",
        *calibration_options,
        "--task",
        "long.toml",
        *time_scale_options,
        "--log",
        "second.mcap",
    )
    assert second_process_result.returncode == 1
    assert second_process_result.stderr.startswith(
        f"handctl: bus {LOCAL_BUS}: another controller runs here"
    )
    assert second_process_result.stderr.count("\n") == 1
    stop = run_handctl("stop", "--bus", LOCAL_BUS)
    assert stop.returncode == 0
    code, _, err = process_result(process)
    assert code == 0, err
    assert modes_of_complete_log(work_folder / "run.mcap")[-3:] == [
        "ACTIVE -> RELAX",
        "RELAX -> DISARM",
        "DISARM -> DONE",
    ]


def test_the_first_ctrl_c_relaxes_disables_and_confirms(
    work_folder, hand_truth_file, calibration_options, started_processes, time_scale_options
):
    process = start_long_task(started_processes, calibration_options, *time_scale_options)
    process.send_signal(signal.SIGINT)
    code, result, err = process_result(process)
    assert (code, result["failure"]) == (0, ""), err
    assert modes_of_complete_log(work_folder / "run.mcap")[-3:] == [
        "ACTIVE -> RELAX",
        "RELAX -> DISARM",
        "DISARM -> DONE",
    ]
    with RunLog(work_folder / "run.mcap") as run:
        tension_before = run.field("tension")[-400:].max()
        phases = run.field("drive_phase")[-1]
        assert tension_before > 8.0
        assert run.field("tension")[-1].max() < 8.5
        assert len(set(phases)) == 1, "all drives report the same phase, disabled"


def test_the_second_ctrl_c_cuts(
    work_folder, hand_truth_file, calibration_options, started_processes, time_scale_options
):
    process = start_long_task(started_processes, calibration_options, *time_scale_options)
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGTERM)  # Linux can merge two SIGINT signals into one
    code, _, err = process_result(process)
    assert code == 0, err
    assert modes_of_complete_log(work_folder / "run.mcap")[-3:] == [
        "RELAX -> CUT",
        "CUT -> DISARM",
        "DISARM -> DONE",
    ]


def test_a_missing_motor_is_named(
    work_folder, hand_truth_file, started_processes, time_scale_options
):
    content = hand_content("jamia")
    content["motor"][2]["node_id"] = 9
    (work_folder / "mine.toml").write_text(toml_text(content))
    write_homed_calibration(work_folder / "c.toml", load_hand("mine.toml"))
    words = (
        "--hand",
        "mine.toml",
        "--bus",
        LOCAL_BUS,
        "--calibration",
        "c.toml",
        *time_scale_options,
    )
    refused_process_result = run_handctl(
        "run", *words, "--task", "short.toml", "--log", "run.mcap", "--json"
    )
    assert refused_process_result.returncode == 1
    assert refused_process_result.stderr == "handctl: no answer from ring_motor\n"
    truth = read_truth(hand_truth_file)
    assert (
        max(
            truth.values[:, truth.columns.index(f"motor/{name}_motor")].max()
            for name in ("index", "ring")
        )
        < 0.05
    )
