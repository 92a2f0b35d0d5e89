"""Test commissioning, arming and a grasp in lockstep with drives of each protocol."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from handctl.campaign.run_stages import hand_with_protocol
from handctl.cli.main import main
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, TickOut
from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.programs.live_session import LiveProgram
from handctl.session.lockstep_simulation import SimulatedRun, SimulatorSettings, homed_controller
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


@pytest.mark.parametrize(
    "protocol",
    [
        pytest.param(name, marks=() if name in ("mit", "odrive") else pytest.mark.nightly)
        for name in PROTOCOL_TRAITS
    ],
)
def test_arming_reports_no_fault(protocol: str) -> None:
    """Reproduce a defect: an ODrive sent no feedback in the tick after its settings were verified.

    The missing feedback caused the fault B01 (a reply is missing).
    """
    model = HandModel.from_hand(hand_with_protocol("jamia", protocol), Gains(), 400.0)
    controller = homed_controller(model, LiveProgram())
    with SimulatorSettings(model.hand, None, 0, homed=True).begin_run(controller) as run:
        events = [event for out in iter_until_active(run) for event in out.events]
    assert not [event.text for event in events if event.name == "fault"]


def iter_until_active(run: SimulatedRun) -> Iterator[TickOut]:
    """Yield the output of each tick, until the hand has been active for half a second."""
    active_ticks = 0
    while active_ticks < 200:
        out = run.run_tick()
        active_ticks += out.mode == HandMode.ACTIVE
        assert out.mode < HandMode.RELAX
        yield out
