"""Who is told that time can be slowed: whoever simulates a hand that does not keep up, and nobody else."""

from types import SimpleNamespace
from typing import cast

import pytest

from handctl.cli.main import main
from handctl.cli.plan import Plan
from handctl.cli.session import Outcome, remedy
from handctl.controller.gains import Gains
from handctl.controller.state import State
from handctl.hand.description import load_hand
from handctl.runtime.loop import LoopStats

LATE, TORN = ("B03b", "N02"), ("T01",)


def ended(*rows: str) -> Outcome:
    """A run that these rows ended."""
    safety = SimpleNamespace(latched=[SimpleNamespace(id=row) for row in rows])
    state = SimpleNamespace(safety=safety, failure="fault" if rows else "")
    return Outcome(cast(State, state), LoopStats(), {}, None, 0)


@pytest.mark.parametrize(
    ("bus", "rows", "told"),
    [
        ("local:lab", LATE, True),
        ("socketcan:vcan0", LATE, True),
        ("socketcan:can0", LATE, False),
        ("local:lab", TORN, False),
        ("local:lab", (), False),
        ("", LATE, False),
    ],
    ids=["simulated", "virtual", "real", "torn rope", "nothing", "lockstep"],
)
def test_slower_time_is_for_simulated_hands_that_are_late(bus: str, rows: tuple[str, ...], told: bool) -> None:
    plan = Plan(load_hand("jamia"), Gains(), 500.0, (0.6,), (bus,) if bus else ())
    assert ("--time-scale" in remedy(plan, ended(*rows))) == told


def test_virtual_time_is_not_slowed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--lockstep", "--time-scale", "0.5"]) == 2
    assert "--time-scale: 0.5; expected no --lockstep" in capsys.readouterr().err
