"""Test that handctl advises a slower time scale only if the computer was too slow for a simulated hand."""

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from handctl.cli.main import main
from handctl.controller.controller_state import ControllerState
from handctl.core.gains.gains import Gains
from handctl.hand.hand_loading import hand_path, load_hand
from handctl.runtime.loop import LoopStats
from handctl.session import time_scale_advice
from handctl.session.run import RunOutcome
from handctl.session.run_plan import RunPlan
from handctl.session.time_scale_advice import late_run_advice

TORQUE_LIMIT = ("--torque-limit-Nm", "0.1")
LATE_FAULTS, TORN_TENDON_FAULTS = ("B03b", "N02"), ("T01",)


def run_with_faults(*fault_ids: str, cpu_s: float = 0.0) -> RunOutcome:
    """Return the outcome of a run that ended with the given faults.

    In the returned outcome, the CPU time of the control loop is ``cpu_s`` [s].
    """
    latched_faults = [SimpleNamespace(id=row) for row in fault_ids]
    state = SimpleNamespace(
        latched_faults=latched_faults, failure="fault" if fault_ids else "", k=1000
    )
    return RunOutcome(cast(ControllerState, state), LoopStats(cpu_s=cpu_s), {}, None, 0)


@pytest.mark.parametrize(
    ("bus_text", "fault_ids", "is_advised"),
    [
        ("local:lab", LATE_FAULTS, True),
        ("socketcan:vcan0", LATE_FAULTS, True),
        ("socketcan:can0", LATE_FAULTS, False),
        ("local:lab", TORN_TENDON_FAULTS, False),
        ("local:lab", (), False),
        ("", LATE_FAULTS, False),
    ],
    ids=["simulated", "virtual", "real", "torn tendon", "nothing", "lockstep"],
)
def test_slower_time_is_advised_only_for_late_simulated_hands(
    bus_text: str, fault_ids: tuple[str, ...], is_advised: bool
) -> None:
    plan = RunPlan(load_hand("jamia"), Gains(), 500.0, (0.6,), (bus_text,) if bus_text else ())
    assert ("--time-scale" in late_run_advice(plan, run_with_faults(*fault_ids))) == is_advised


@pytest.mark.parametrize(
    ("cpu_s", "measured_capacity", "advised_scale", "number"),
    [
        (0.0, None, None, 0.7),
        (4.0, None, None, 0.3),
        (0.2, 0.5, None, 0.3),
        (0.2, 3.0, None, 0.7),
        (0.2, 3.0, 0.01, 0.01),
    ],
    ids=[
        "nothing measured",
        "slow controller",
        "slow simulator",
        "a stall",
        "what the simulator saw",
    ],
)
def test_the_advised_pace_is_measured(
    monkeypatch: pytest.MonkeyPatch,
    cpu_s: float,
    measured_capacity: float | None,
    advised_scale: float | None,
    number: float,
) -> None:
    """handctl computes the advised time scale from measurements in the run.

    The run in this test has 1000 ticks at 500 Hz.

    Earlier defect: the advised time scale was always 0.5.
    """
    answer = {"pace": {"advice": advised_scale, "plant_s_per_cpu_s": measured_capacity}}
    monkeypatch.setattr(
        time_scale_advice,
        "ask_simulator",
        lambda path, question: answer if question == {"pace": True} else {},
    )
    monkeypatch.setattr(time_scale_advice, "usable_cores", lambda: 2)
    plan = RunPlan(load_hand("jamia"), Gains(), 500.0, (0.6,), ("local:lab",))
    assert late_run_advice(plan, run_with_faults(*LATE_FAULTS, cpu_s=cpu_s)).endswith(
        f"handctl sim with --time-scale {number:g}"
    )


def test_simulator_and_controller_share_a_core(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = {"pace": {"advice": None, "plant_s_per_cpu_s": 2.0}}
    monkeypatch.setattr(time_scale_advice, "ask_simulator", lambda path, question: answer)
    monkeypatch.setattr(time_scale_advice, "usable_cores", lambda: 1)
    plan = RunPlan(load_hand("jamia"), Gains(), 500.0, (0.6,), ("local:lab",))
    assert (
        time_scale_advice.slower_time_scale(plan, run_with_faults(*LATE_FAULTS, cpu_s=1.8)) == 0.5
    )


def test_virtual_time_is_not_slowed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--lockstep", "--time-scale", "0.5"]) == 2
    assert "--time-scale: 0.5; expected 1 with --lockstep" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command_words", "expected_command"),
    [
        (
            ("commission", "--hand", "ak hand.toml"),
            "handctl sim --hand 'ak hand.toml' --bus local:nobody",
        ),
        (("bus", "watch", "--hand", "jamia11"), "handctl sim --hand jamia11 --bus local:nobody"),
        (("scan",), "handctl sim --bus local:nobody"),
        (
            ("conformance", "--protocol", "odrive", "--node", "3", *TORQUE_LIMIT, "--yes"),
            "python -m firmware_sim drive odrive --ids 3 --bus local:nobody",
        ),
    ],
    ids=["hand file", "packaged hand", "no hand", "one drive"],
)
def test_a_missing_simulator_is_named_with_the_hand_of_the_command(
    command_words: tuple[str, ...],
    expected_command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Reproduce a defect: the error message about a missing simulator always named jamia, for any hand."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path))
    shutil.copy(hand_path("t42"), "ak hand.toml")
    assert main([*command_words, "--bus", "local:nobody"]) == 1
    last_line = capsys.readouterr().err.splitlines()[-1]
    assert last_line.startswith("handctl: local:nobody: no simulator serves this bus: ")
    assert last_line.endswith(f"; expected a simulator there; type: {expected_command}")
