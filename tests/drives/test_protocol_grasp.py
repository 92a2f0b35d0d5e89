"""Test commissioning and a grasp in lockstep with drives of each protocol."""

import json
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.drives.motor_description import PROTOCOL_TRAITS
from tests.drives.protocol_bench import hand_file


@pytest.mark.parametrize(
    "protocols",
    [
        *[
            pytest.param([name], id=name, marks=pytest.mark.nightly)
            for name in PROTOCOL_TRAITS
            if name != "mit"
        ],
        pytest.param(["mit", "odrive", "cubemars", "cia402"], id="unlike drives in one hand"),
        pytest.param(
            ["moteus", "robstride", "mit", "cia402"],
            id="29-bit identifiers beside 11-bit ones",
            marks=pytest.mark.nightly,
        ),
    ],
)
def test_a_hand_grasps(
    protocols: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, log = hand_file(tmp_path, protocols), tmp_path / "run.mcap"
    assert main(["demo", "--lockstep", "--hand", str(path), "--log", str(log), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["failure"] == ""
    assert result["tracking_rmse_rad"] < 0.01
    assert result["tension_hold_error_n"] < 2.0
    assert min(result["contact_force_n"].values()) > 1.0, "it holds something"
