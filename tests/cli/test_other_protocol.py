"""Test the option --protocol.

With the option ``--protocol``, a simulated hand has drives of another protocol than in its hand
file. The option ``--protocol`` works in ``handctl demo``. The option ``--protocol`` also works if
simulator and controller are two processes.
"""

import argparse
import json
import os
from pathlib import Path

import pytest

from handctl.campaign.fault_matrix import ALL_PROTOCOLS
from handctl.cli.main import main
from handctl.cli.runs.protocol_hand_file import use_protocol_hand_file
from handctl.hand.hand_loading import load_hand, packaged_hands
from tests.cli.command_refusals import refusal_line

ABSENT_BUS_OPTION = ("--bus", "local:does-not-exist")


@pytest.mark.parametrize("protocol", ALL_PROTOCOLS)
@pytest.mark.parametrize("hand", packaged_hands())
def test_the_temporary_hand_file_has_all_drives_in_the_protocol(hand: str, protocol: str) -> None:
    args = argparse.Namespace(hand=hand, protocol=protocol, motor_type=None)
    with use_protocol_hand_file(args):
        path = Path(args.hand)
        assert {motor.protocol for motor in load_hand(path).motor} == {protocol}
    assert args.hand == hand
    assert not path.exists()


def test_a_simulator_leaves_the_file_that_its_controller_needs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["sim", "--hand", "jamia", "--protocol", "odrive", *ABSENT_BUS_OPTION]
    assert main([*words, "--dry-run", "--json"]) == 0
    command = json.loads(capsys.readouterr().out)["command"]
    assert command[command.index("--hand") + 1] == "jamia-odrive.toml"
    assert not list(tmp_path.iterdir()), "a dry run writes no files"
    started: list[list[str]] = []
    monkeypatch.setattr(os, "execv", lambda program, command: started.append(command) or 0)
    for _ in range(2):
        assert main(words) == 0
        assert load_hand("jamia-odrive.toml").motor[0].protocol == "odrive"
    assert [command_words[command_words.index("--hand") + 1] for command_words in started] == [
        "jamia-odrive.toml"
    ] * 2
    Path("jamia-odrive.toml").write_text("mine")
    line = refusal_line(capsys, *words)
    assert line.endswith(
        ": jamia-odrive.toml exists and describes another hand; expected a folder without it\n"
    )
    assert Path("jamia-odrive.toml").read_text() == "mine"


def test_an_unknown_protocol_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert "argument --protocol: invalid choice: 'none'" in refusal_line(
        capsys, "demo", "--lockstep", "--protocol", "none"
    )


def test_a_simulated_hand_can_have_motors_without_guards(
    work_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reproduce a defect: `handctl sim` did not accept `--protocol cubemars`."""
    monkeypatch.setattr(os, "execv", lambda program, command: 0)
    words = ["sim", "--hand", "jamia", *ABSENT_BUS_OPTION, "--motor-type", "ak60-6"]
    assert main([*words, "--protocol", "cubemars", "--dry-run"]) == 0
    assert main([*words, "--protocol", "cubemars"]) == 0
    motors = load_hand("jamia-cubemars.toml").motor
    assert {motor.options["motor_type"] for motor in motors} == {"ak60-6"}
    capsys.readouterr()
    assert "--motor-type: ak60-6; expected --protocol with it" in refusal_line(capsys, *words)
    assert "expected one of rs00" in refusal_line(capsys, *words, "--protocol", "robstride")
