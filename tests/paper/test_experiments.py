"""Test the experiments of the paper with the simulated hand, and the evaluation of recorded experiments."""

import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handctl.errors import HandctlError
from handctl.hand.hand_loading import load_hand
from handctl.paper import sections
from handctl.paper.bench import experiments, force_displacement, payload, worker_pool
from handctl.report.truth_record import TruthRecord

REPOSITORY_ROOT = Path(__file__).parents[2]
RESULTS_FILE = REPOSITORY_ROOT / "docs" / "evidence" / "paper-results.json"


def test_the_bench_hand_reaches_forces_that_its_sensors_distinguish() -> None:
    hand = load_hand("jamia_bench")
    for tendon in hand.tendon:
        noise = hand.sensor_node.tension_noise_N
        assert tendon.tension_max_N > 200.0, "beyond the first knee"
        assert tendon.tension_max_N + 5.0 * noise < tendon.tension_trip_N < 249.9
        assert hand.motor_of_tendon(tendon.name).torque_max_N_m == pytest.approx(
            tendon.drive_limit_N * 0.005
        )


def test_a_blocked_finger_shows_the_knee_of_its_tendon(tmp_path: Path) -> None:
    pull_results = json.loads(json.dumps(experiments.run_job({"do": "pull"}, tmp_path)))
    bent_finger_curve, straight_finger_curve = force_displacement.curves_of_tendons(pull_results)
    for curve in (bent_finger_curve, straight_finger_curve):
        assert curve.stiffness == pytest.approx(1e5, rel=0.01)
        assert curve.force.max() > 240.0
        assert curve.force.min() < 30.0
    assert bent_finger_curve.knee == pytest.approx(200.0, abs=5.0)
    assert straight_finger_curve.knee is None
    end = bent_finger_curve.force > 235.0
    assert (
        np.median(bent_finger_curve.force[end] / bent_finger_curve.displacement[end])
        < 0.95e-3 * bent_finger_curve.stiffness
    )


def falling_object_truth(fall_speed: float, fall_start_s: float) -> TruthRecord:
    """Return a truth record with one row per millisecond.

    In the returned record, the object rests until ``fall_start_s``, and then falls at
    ``fall_speed`` [m/s].
    """
    t = np.arange(4000)
    z = -fall_speed * np.maximum(0.0, t / 1000.0 - fall_start_s)
    return TruthRecord(
        {}, t * 1_000_000, np.column_stack([0 * z, 0 * z, z]), ("object/x", "object/y", "object/z")
    )


@pytest.mark.parametrize(
    ("fall_speed", "expected_end", "time_s"),
    [
        (0.9e-3, "moved", 1.0 + 2.0 / 0.9),
        (1.5e-3, "creep", 1.0 + 0.1 / 1.5),
        (0.5, "creep", 1.001),
        (1e-5, "held", 3.9),
    ],
)
def test_slip_is_creep_or_displacement(fall_speed: float, expected_end: str, time_s: float) -> None:
    row, how = payload._find_slip(falling_object_truth(fall_speed, 1.0), 100, 3900)
    assert how == expected_end
    assert row / 1000.0 == pytest.approx(time_s, abs=0.003)


def test_a_worker_that_ends_is_an_error() -> None:
    progress_reports: list[tuple[str, bool]] = []
    with (
        worker_pool.worker_pool(
            2, lambda job, done: progress_reports.append((job["do"], done))
        ) as workers,
        pytest.raises(HandctlError, match="worker"),
    ):
        workers([{"do": "nothing"}, {"do": "nothing"}])
    assert ("nothing", False) in progress_reports
    assert all(not done for _, done in progress_reports)


def test_workers_do_not_outlive_their_owner() -> None:
    with worker_pool.worker_pool(1, lambda job, done: None):
        pass
    process_list = subprocess.run(
        ["ps", "-eo", "ppid,args"], capture_output=True, text=True, check=True
    ).stdout
    remaining_workers = [
        line
        for line in process_list.splitlines()
        if line.split()[:1] == [str(os.getpid())] and worker_pool.WORKER_MODULE in line
    ]
    assert not remaining_workers


@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_all_experiments_finish_within_three_minutes(tmp_path: Path) -> None:
    report, figures = tmp_path / "out.html", tmp_path / "figures"
    words = ["paper", "--json", "--output", str(report), "--figures", str(figures)]
    start_s = time.monotonic()
    completed_process = subprocess.run(
        [sys.executable, "-c", HANDCTL_CODE, *words],
        capture_output=True,
        text=True,
        cwd=REPOSITORY_ROOT,
        check=True,
    )
    assert time.monotonic() - start_s < 180.0
    items: list[dict[str, Any]] = json.loads(completed_process.stdout)
    stored_values = {
        item.id: item.computed
        for item in sections.page_errata(experiments.load_results(RESULTS_FILE))
    }
    payloads = [
        item for item in items if item["id"].startswith(("payload.x.", "payload.y.", "payload.z."))
    ]
    assert len(payloads) == 9
    assert all(
        item["computed"] == pytest.approx(stored_values[item["id"]], rel=0.25) for item in payloads
    ), "the page is stale"
    assert all(0.5 < item["computed"] < 3.0 for item in payloads)
    axis_payloads = [item for item in payloads if item["id"].startswith("payload.z")]
    assert all(item["verdict"] == "bound" for item in axis_payloads), (
        "the paper's payload is met along the cylinder's axis"
    )
    assert report.stat().st_size > 500_000
    assert len(list(figures.iterdir())) == 16
    assert not math.isnan(sum(item["computed"] for item in payloads))


HANDCTL_CODE = "import sys; from handctl.cli.main import main; sys.exit(main(sys.argv[1:]))"
