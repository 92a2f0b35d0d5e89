"""Test in real time how clients that misbehave affect the hand.

The tests check the effects on the hand with the true values from the simulator.

tests/controller/test_target_streams.py contains similar tests in lockstep.
"""

import os

import pytest

from benchmarks.streaming import CLIENT_BEHAVIOURS, CommissionedHand, measure_clients
from handctl.hand.hand_loading import load_hand
from tests.runtime.processes import HOMED_HAND_OPTIONS, LOCAL_BUS, write_homed_calibration

NIGHTLY = os.environ.get("HANDCTL_NIGHTLY") == "1"
TIME_SCALE = 0.6
TESTED_CLIENTS = list(CLIENT_BEHAVIOURS) if NIGHTLY else ["flooding", "killed"]
HOLD_FAULT = "I11a"
"""Fault of a stream in which no target arrives for 100 ms. After the fault, the controller holds the hand."""
RELAX_FAULT = "I11b"
"""Fault of a stream in which no target arrives for a second.

After the fault, the controller relaxes the hand.
"""
EXPECTED_FAULTS_BY_CLIENT = {
    "paused-500": {HOLD_FAULT}, "nan": {HOLD_FAULT}, "1e308": {HOLD_FAULT}, "late-150": {HOLD_FAULT},
    "killed": {HOLD_FAULT, RELAX_FAULT}, "killed-owner": set(),
}  # fmt: skip
"""For each misbehaving client, the stream faults that it must cause.

A client without an entry in the dictionary must cause no fault.
"""


@pytest.fixture
def commissioned_hand(work_folder) -> CommissionedHand:
    """Return the calibration and the simulator options of a commissioned hand."""
    write_homed_calibration(work_folder / "c.toml", load_hand("jamia"))
    return work_folder / "c.toml", HOMED_HAND_OPTIONS


@pytest.mark.realtime
def test_invalid_clients_do_not_disturb_a_run(commissioned_hand, time_scale_of_attempt):
    rows = measure_clients(
        TESTED_CLIENTS, LOCAL_BUS, TIME_SCALE * time_scale_of_attempt, commissioned_hand
    )
    hand = load_hand("jamia")
    assert list(rows) == TESTED_CLIENTS
    for name, row in rows.items():
        assert row["tension_N"] < min(tendon.tension_trip_N for tendon in hand.tendon), name
        if name != "straining":
            assert row["tension_N"] < min(tendon.tension_max_N for tendon in hand.tendon), name
        faults = {text.split()[0] for text in row["faults"]}
        assert {
            fault for fault in faults if fault.startswith("I11")
        } == EXPECTED_FAULTS_BY_CLIENT.get(name, set()), (
            name,
            row,
        )
        assert (row["mode"] == "ACTIVE") == (not name.startswith("killed")), (name, row)
    assert rows["flooding"]["refused"] == rows["flooding"]["late"] == 0
    assert rows["flooding"]["accepted"] > 200
    if NIGHTLY:
        assert rows["nan"]["refused"] == rows["1e308"]["refused"] > 30
        assert rows["late-150"]["late"] > 30
        assert rows["repeating"]["late"] > 3 * 30
        assert rows["overtaking"]["late"] > 15
        assert rows["jumping"]["clipped"] > 5
        assert rows["straining"]["clipped"] > 30
