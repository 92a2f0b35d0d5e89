"""``handctl bus plan``: what it computes, and that a split it proposes really fits."""

import json

import pytest

from handctl.cli.bus import plan, split
from handctl.cli.main import main
from handctl.cli.plan import tick_times_s
from handctl.controller.setup import make_drives
from handctl.drives.load import MOST, bus_time_s
from handctl.hand.description import load_hand


def test_the_packaged_hand_fits_at_its_rate(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bus", "plan", "--hand", "jamia", "--rate", "500", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    (bus,) = result["buses"]
    assert bus["tick_us"] == pytest.approx(4 * 270 + 125 + 65, rel=0.001), "commands, answers, tensions, SYNC"
    assert bus["load"] == pytest.approx(bus["tick_us"] * 500e-6)


def test_what_does_not_fit_is_said_and_split(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bus", "plan", "--hand", "jamia11", "--rate", "500"]) == 1
    assert "3 buses of this kind would hold it" in capsys.readouterr().out


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0])
def test_every_bus_of_a_split_fits(rate: float) -> None:
    hand = load_hand("jamia11")
    drives = {drive.name: drive for drive in make_drives(hand)}
    buses = split(hand, rate)
    assert sorted(name for names in buses for name in names) == sorted(drives)
    for names in buses:
        frames = [(size, fd, 1.0) for name in names for size, fd in drives[name].exchange]
        assert rate * bus_time_s(frames, 1e6) <= MOST


def test_a_rate_that_no_split_reaches_is_said() -> None:
    hand = load_hand("jamia")
    assert plan(hand, tick_times_s(hand), 5000.0)["split"] == []


def test_a_rate_that_is_none_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bus", "plan", "--rate", "nan"]) == 2
    assert "--rate" in capsys.readouterr().err
