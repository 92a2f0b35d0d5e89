"""An injected fault reaches a running simulator, and the simulator reports the effect of the fault."""

import json
import subprocess
import sys

import pytest

from handctl.cli.main import main
from handctl.runtime.socket_paths import run_dir


@pytest.fixture
def simulator(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path))
    command = [sys.executable, "-m", "firmware_sim", "--hand", "jamia", "--bus", "local:lab"]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert "ready" in child.stdout.readline()
    yield child
    child.terminate()
    child.wait(20)
    assert not list(run_dir().glob("*.faults")), "the simulator removes its socket"


def test_injected_faults_are_listed(simulator, capsys):
    assert main(["fault", "inject", "hot node=1 size=95", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["faults"]
    assert [(fault["fault"], fault["state"], fault["felt"]) for fault in listed] == [
        ("hot node=1 size=95", "acting", 1)
    ]
    assert main(["fault", "inject", "snap tendon=thumb_tendon at=100s", "--bus", "local:lab"]) == 0
    assert main(["fault", "list"]) == 0
    shown_lines = capsys.readouterr().out.splitlines()
    assert shown_lines[-3].split() == ["state", "felt", "fault"]
    assert shown_lines[-1].split() == ["waiting", "0", "snap", "tendon=thumb_tendon", "at=100s"]
    assert main(["fault", "inject", "explode node=1"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert simulator.poll() is None, "invalid requests do not end the simulator"


def test_the_faults_that_can_be_injected_are_listed(simulator, capsys):
    assert main(["fault", "list"]) == 0
    assert "handctl fault kinds" in capsys.readouterr().out
    assert main(["fault", "kinds"]) == 0
    shown_text = capsys.readouterr().out
    assert "snap       on tendon: a tendon breaks; size 0" in shown_text
    assert "tendon     index_tendon, middle_tendon, ring_tendon, thumb_tendon" in shown_text
    assert main(["fault", "kinds", "--json"]) == 0
    kinds = {kind["kind"]: kind for kind in json.loads(capsys.readouterr().out)["kinds"]}
    assert "sensors" in kinds["drop"]["on"]["node"]
    assert "sensors" not in kinds["hot"]["on"]["node"]
    assert main(["fault", "inject", "hot node=sensors size=3"]) == 2
    assert "no node 'sensors'" in capsys.readouterr().err
    assert main(["fault", "inject", "off node=sensors"]) == 0
    assert simulator.poll() is None


def test_inject_without_a_simulator_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path))
    assert main(["fault", "list"]) == 1
    assert "none" in capsys.readouterr().err
    assert main(["fault", "list", "--bus", "local:nope"]) == 1
    assert "no simulator answers" in capsys.readouterr().err
