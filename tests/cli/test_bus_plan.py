"""Test ``handctl bus plan``: the computed bus load, and the proposed buses.

The buses that ``bus plan`` proposes can carry the frames of all motors.
"""

import json
from pathlib import Path

import pytest

from handctl.cli.checks.bus_plan import bus_plan_report
from handctl.cli.main import main
from handctl.controller.bus_load import bus_loads, split_motors_over_buses
from handctl.controller.run_setup import make_drives
from handctl.drives.frame_time import MAX_BUS_LOAD, bus_time_s
from handctl.hand.hand_loading import hand_path, load_hand


def test_the_packaged_hand_fits_at_its_rate(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bus", "plan", "--hand", "jamia", "--rate", "500", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    (bus,) = result["buses"]
    assert bus["tick_us"] == pytest.approx(4 * 270 + 125 + 65, rel=0.001), (
        "commands, answers, tensions, SYNC"
    )
    settings_bus_load = 4 * 2 * 135e-6 * 2.0
    """Bus load due to the settings that the controller repeatedly reads from the drives.

    The controller reads a setting of each drive twice a second. The request frame takes 135 us on
    the bus, and the reply frame takes the same time.
    """
    assert bus["load"] == pytest.approx(bus["tick_us"] * 500e-6 + settings_bus_load)


def test_overloaded_bus_is_reported_and_split(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bus", "plan", "--hand", "jamia11", "--rate", "500"]) == 1
    assert "3 buses of this kind are enough" in capsys.readouterr().out


@pytest.mark.parametrize("rate_hz", [250.0, 500.0, 1000.0])
def test_every_bus_of_a_split_fits(rate_hz: float) -> None:
    hand = load_hand("jamia11")
    drives = {drive.name: drive for drive in make_drives(hand)}
    buses = split_motors_over_buses(hand, rate_hz)
    assert sorted(name for names in buses for name in names) == sorted(drives)
    for names in buses:
        frames = [(size, fd, 1.0) for name in names for size, fd in drives[name].frames_per_tick]
        assert rate_hz * bus_time_s(frames, 1e6) <= MAX_BUS_LOAD


def test_rate_above_every_split_is_reported() -> None:
    hand = load_hand("jamia")
    assert bus_plan_report(hand, bus_loads(hand), 5000.0)["split"] == []


def test_invalid_rate_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bus", "plan", "--rate", "nan"]) == 2
    assert "--rate" in capsys.readouterr().err


def test_bus_load_rows_add_up_to_the_total(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bus", "plan", "--hand", "jamia11", "--rate", "200", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    for bus in result["buses"]:
        rows = bus["frames"]
        assert sum(row["per_tick"] * row["frame_us"] for row in rows) == pytest.approx(
            bus["tick_us"]
        )
        assert bus["load"] == pytest.approx(200e-6 * bus["tick_us"] + bus["by_time"])
    assert main(["bus", "plan", "--hand", "jamia", "--verbose"]) == 0
    assert "tensions" in capsys.readouterr().out


EXPECTED_BUS_LOADS = [
    ("MIT", False, 4, 1215, (30, 61, 121), 658),
    ("MIT", False, 11, 3375, (84, 169, 338), 237),
    ("MIT", True, 4, 517, (13, 26, 52), 1546),
    ("MIT", True, 11, 1351, (34, 68, 135), 592),
    ("CiA 402", False, 4, 1110, (28, 56, 111), 721),
    ("CiA 402", False, 11, 2990, (75, 150, 299), 268),
    ("CiA 402, four torques in one RPDO", False, 4, 865, (22, 43, 86), 925),
    ("ODrive, torque and encoder", False, 4, 1055, (26, 53, 106), 758),
    ("ODrive, with torque feedback", False, 4, 1755, (44, 88, 176), 456),
]
"""Test cases with bus loads that were calculated independently of handctl.

The last three entries of each test case are the bus time per tick [us], the bus loads at control
rates of 250, 500 and 1000 Hz [%], and the control rate at a bus load of 80 % [Hz].
"""


@pytest.mark.parametrize(
    ("protocol", "can_fd", "motor_count", "tick_us", "expected_loads", "highest_rate_hz"),
    EXPECTED_BUS_LOADS,
)
def test_load_table_has_the_expected_times_and_rates(
    protocol: str, can_fd: bool, motor_count: int, tick_us: float, expected_loads: tuple[float, ...],
    highest_rate_hz: float,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    assert main(["bus", "plan", "--table", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    (row,) = [
        row
        for row in rows
        if (row["protocol"], row["fd"], row["motors"]) == (protocol, can_fd, motor_count)
    ]
    assert row["tick_us"] == pytest.approx(tick_us, rel=0.02)
    assert row["max_hz"] == pytest.approx(highest_rate_hz * MAX_BUS_LOAD / 0.80, rel=0.02), (
        "maximum rate at the usual limit of the bus load"
    )
    assert [100 * row["load"][rate] for rate in ("250", "500", "1000")] == pytest.approx(
        expected_loads, rel=0.02
    )


def test_bus_load_table_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bus", "plan", "--table"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + len(EXPECTED_BUS_LOADS)
    assert lines[1].endswith("Hz at 70%"), "largest bus load that the runner permits"


def test_run_refuses_an_overloaded_bus(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", "--hand", "jamia11", "--bus", "local:nobody", "--rate", "500", "--dry-run"]
    assert main(words) == 2
    assert "bus main would be" in capsys.readouterr().err


def test_a_bus_too_slow_for_the_watchdogs_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """handctl refuses a run if a bus is too slow for the watchdogs of the drives.

    The slow bus of this test can carry the frames of at most 20 ticks per second, so one tick takes
    50 ms. The watchdog of a drive fires after 50 ms without a frame.
    """
    slow = tmp_path / "slow.toml"
    slow.write_text(hand_path("jamia11").read_text().replace("1_000_000", "125_000"))
    assert main(["run", "--hand", str(slow), "--bus", "local:nobody", "--dry-run"]) == 2
    assert (
        "bus main with 125000 bit/s and 11 motors allows a control rate of only 20 Hz; expected at least 100 ms"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("bus_text", "exit_code"),
    [("socketcan:can0", 2), ("pcan:PCAN_USBBUS1", 2), ("socketcan:vcan0", 0)],
)
def test_real_motors_are_not_run_in_slow_motion(
    bus_text: str, exit_code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """handctl refuses to run real motors in slow motion.

    The gains of the controller are designed for one tick every 2 ms. With one tick every 20 ms, the
    hand would oscillate.
    """
    assert (
        main(["run", "--hand", "jamia", "--bus", bus_text, "--time-scale", "0.1", "--dry-run"])
        == exit_code
    )
    assert ("may have real motors; expected 1, or" in capsys.readouterr().err) == bool(exit_code)
