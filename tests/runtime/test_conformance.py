"""Test the conformance checks on simulated drives in virtual time.

A good drive passes all conformance checks. A defective drive fails the check that is made for its
defect.
"""

import random
from pathlib import Path

import pytest

from firmware_sim.description.hand_description import SimulatorError
from firmware_sim.faults.faulty_drive import DRIVE_FAULTS, check_fault_has_effect
from handctl.drives.contract import DriveTarget
from handctl.drives.motor_description import PROTOCOL_TRAITS, VERIFIABLE_PROTOCOLS
from handctl.runtime.diagnostics.conformance import (
    CheckVerdict,
    ConformanceCheck,
    DeviceUnderTest,
    release_drive,
    run_checks,
)
from handctl.runtime.diagnostics.drive_rig import DriveRig
from tests.drives.virtual_bench import OPTIONS_BY_PROTOCOL, VirtualBench, make_drive_rig

TORQUE_LIMIT_N_M = 0.1
DRIVES_PAGE = Path(__file__).parents[2] / "docs" / "evidence" / "drives.md"
DEFECT_TABLE_MARK = "and a row for each defect of `--broken`."
OPTIONS_WITHOUT_ENDPOINTS = {"torque_feedback": True}
"""Options of an ODrive whose options ``endpoint_*`` are not set."""


def check_results(
    protocol, drive_fault="", drive_options=None, shaft_inertia=None, delay_ticks=0
) -> tuple[dict[str, ConformanceCheck], VirtualBench, DriveRig]:
    virtual_bench = VirtualBench(protocol, drive_fault, shaft_inertia, delay_ticks)
    rig = make_drive_rig(virtual_bench, protocol, TORQUE_LIMIT_N_M, drive_options)
    return run_checks_by_name(rig), virtual_bench, rig


def run_checks_by_name(rig: DriveRig) -> dict[str, ConformanceCheck]:
    """Run the conformance checks on a drive, and return the results by the name of the check."""
    return {check.name: check for check in run_checks(DeviceUnderTest(rig, TORQUE_LIMIT_N_M, 0.05))}


def run_checks_three_times(virtual_bench, protocol, drive_options=None):
    """Run the conformance checks of a drive three times.

    After each run of the checks, two seconds pass without frames from the host.
    """
    for _ in range(3):
        rig = make_drive_rig(virtual_bench, protocol, TORQUE_LIMIT_N_M, drive_options)
        checks = run_checks_by_name(rig)
        assert release_drive(rig, 0.05)
        virtual_bench.advance_time(2.0)
        yield checks


def read_defect_table() -> list[tuple[str, str, str]]:
    """Read the table of drive defects in the documentation, and return its entries as (defect, column, result)."""
    text = DRIVES_PAGE.read_text(encoding="utf-8").split(DEFECT_TABLE_MARK)[1].strip()
    table = text.split("\n\n")[0].splitlines()
    head, _, *rows = (
        [cell.strip().replace("`", "") for cell in row.split("|")[1:-1]] for row in table
    )
    return [
        (row[0], column, result)
        for row in rows
        for column, result in zip(head[1:], row[1:], strict=True)
    ]


@pytest.fixture(params=VERIFIABLE_PROTOCOLS)
def protocol(request):
    return request.param


def failed_checks(check_results):
    return [name for name, check in check_results.items() if check.verdict is CheckVerdict.FAILED]


def unchecked_results(check_results):
    return [
        name for name, check in check_results.items() if check.verdict is CheckVerdict.NOT_CHECKED
    ]


def test_a_good_drive_passes_every_conformance_check(protocol):
    failures, virtual_bench, rig = check_results(protocol)
    assert [check for check in failures.values() if check.verdict is not CheckVerdict.PASSED] == []
    assert 0.0 < virtual_bench.largest_torque <= TORQUE_LIMIT_N_M * 1.001
    assert rig.confirm_disabled(0.05)
    assert virtual_bench.bench.motors[0].servo.torque == 0.0


@pytest.mark.parametrize("protocol", PROTOCOL_TRAITS)
@pytest.mark.parametrize("seed", range(3))
def test_a_good_drive_passes_although_the_host_is_late(protocol, seed, monkeypatch):
    """In this test, the host stalls and misses up to six ticks in a row.

    On average, one of 40 ticks is followed by a stall of the host. Each stall of the host is
    shorter than the watchdog time of the drive.
    """
    source = random.Random(seed)
    wait = VirtualBench.wait

    def wait_with_stalls(virtual_bench, k):
        late = wait(virtual_bench, k)
        if source.random() < 1.0 / 40.0:
            virtual_bench.advance_time(source.uniform(0.0, 0.03))
            late = wait(virtual_bench, k)
        return late

    monkeypatch.setattr(VirtualBench, "wait", wait_with_stalls)
    checks, virtual_bench, rig = check_results(protocol)
    assert failed_checks(checks) == []
    assert (unchecked_results(checks) == []) is (protocol in VERIFIABLE_PROTOCOLS)
    assert 0.0 < virtual_bench.largest_torque <= TORQUE_LIMIT_N_M * 1.05
    assert rig.confirm_disabled(0.05)


def test_a_good_drive_passes_three_times_running(protocol):
    """Reproduce a defect: after the conformance checks, ODrives and CiA 402 drives had a latched error.

    Because of the latched error, a good drive failed when the checks ran a second time.
    """
    virtual_bench = VirtualBench(protocol)
    for checks in run_checks_three_times(virtual_bench, protocol):
        assert failed_checks(checks) == []
        second_rig = make_drive_rig(virtual_bench, protocol, TORQUE_LIMIT_N_M)
        second_rig.run_tick(DriveTarget.LISTEN)
        second_rig.run_for(DriveTarget.POLL, 0.3)
        assert second_rig.state.error_text == "", (
            "nothing is latched after a silence of two seconds"
        )
        assert release_drive(second_rig, 0.05)


@pytest.mark.parametrize("shaft_inertia", [2e-5, 1e-4, 2e-3])
@pytest.mark.parametrize("delay_ticks", [1, 3])
def test_a_light_shaft_and_a_slow_wire_pass_conformance(protocol, shaft_inertia, delay_ticks):
    failures, virtual_bench, _ = check_results(
        protocol, shaft_inertia=shaft_inertia, delay_ticks=delay_ticks
    )
    assert failed_checks(failures) == []
    assert abs(virtual_bench.bench.motors[0].omega) < 20.0


TORQUE_CUT_CHECK_TITLE = "is cut at once, and cleared on command only"
FAILED_CHECK = {
    "deaf": "disables on command, and reports it",
    "eager": "makes no torque until it is enabled",
    "twin": "is the only drive with its number",
    "mute": "identifies itself, takes its settings and reads them back",
    "readback": "identifies itself, takes its settings and reads them back",
    "sign": "turns the positive way by positive torque",
    "watchdog": "disables itself when the host falls silent, and stays off",
}


@pytest.mark.parametrize(("drive_fault", "protocol_column", "expected_result"), read_defect_table())
def test_each_defect_is_found_or_not_as_the_documentation_says(
    drive_fault, protocol_column, expected_result
):
    """Reproduce three defects.

    Earlier defect: a CubeMars drive that ignores commands passed all checks. Earlier defect: an
    ODrive whose options ``endpoint_*`` are not set passed all checks although it reported wrong
    settings. Earlier defect: an ODrive whose options ``endpoint_*`` are not set failed the watchdog
    check although its watchdog worked.
    """
    protocol = protocol_column.split()[0]
    options = OPTIONS_WITHOUT_ENDPOINTS if "without" in protocol_column else None
    if expected_result == "impossible":
        with pytest.raises(SimulatorError):
            check_fault_has_effect(protocol, drive_fault)
        return
    check_fault_has_effect(protocol, drive_fault)
    checks, virtual_bench, _ = check_results(protocol, drive_fault, options)
    check = checks[FAILED_CHECK[drive_fault]]
    assert (
        check.verdict
        is {
            "found": CheckVerdict.FAILED,
            "not checked": CheckVerdict.NOT_CHECKED,
        }[expected_result]
    )
    if expected_result == "not checked":
        assert failed_checks(checks) == []
    assert virtual_bench.largest_torque <= TORQUE_LIMIT_N_M * 1.05


def test_the_documentation_has_each_defect_of_each_protocol():
    rows = read_defect_table()
    columns = {column for _, column, _ in rows}
    assert columns == {*PROTOCOL_TRAITS, "odrive without endpoints"}
    assert {fault for fault, _, _ in rows} == set(DRIVE_FAULTS)
    assert len(rows) == len(columns) * len(DRIVE_FAULTS)


@pytest.mark.parametrize(
    ("protocol", "expected_identifier"), [("cubemars", "0x021"), ("robstride_mit", "0x000")]
)
def test_a_silent_motor_is_reported_with_the_expected_identifier(protocol, expected_identifier):
    """Reproduce a defect: the result of a check did not name the frames that were missing.

    The check failed because the motor sent no frames, but the result only stated "stays in SILENT"
    as the reason.
    """
    checks, _, _ = check_results(protocol, "mute")
    check = checks[FAILED_CHECK["mute"]]
    assert check.reason == f"no reply; expected frames with the identifier {expected_identifier}"


@pytest.mark.parametrize("drive_fault", ["", "deaf", "twin"])
def test_an_odrive_of_firmware_05_is_judged_without_torque_reports(drive_fault):
    virtual_bench = VirtualBench("odrive", drive_fault, firmware="0.5", usb_watchdog_s=0.1)
    rig = make_drive_rig(virtual_bench, "odrive", TORQUE_LIMIT_N_M, {"firmware": "0.5"})
    checks = {
        check.name: check for check in run_checks(DeviceUnderTest(rig, TORQUE_LIMIT_N_M, 0.1))
    }
    assert failed_checks(checks)[:1] == ([FAILED_CHECK[drive_fault]] if drive_fault else [])
    assert not any("nan" in check.reason for check in checks.values())


def test_a_second_drive_never_turns(protocol):
    """If two drives have the same node number, the checks stop before any drive is enabled.

    The checks detect the second drive by its first reply.
    """
    _, virtual_bench, _ = check_results(protocol, "twin")
    assert virtual_bench.largest_torque == 0.0


def test_a_drive_that_does_not_obey_is_left_to_its_watchdog(protocol):
    _, virtual_bench, rig = check_results(protocol, "deaf")
    assert rig.confirm_disabled(0.05)
    assert virtual_bench.bench.motors[0].servo.torque == 0.0


def test_a_blocked_shaft_is_no_failure(protocol):
    failures, _, _ = check_results(protocol, shaft_inertia=100.0)
    check = failures["turns the positive way by positive torque"]
    assert check.verdict is CheckVerdict.NOT_CHECKED
    assert "did not turn at +0.100 N m" in check.reason


ENDPOINT_OPTIONS = [key for key in OPTIONS_BY_PROTOCOL["odrive"] if key.startswith("endpoint_")]


@pytest.mark.parametrize("given_options", [0, 2, 4])
def test_an_odrive_names_the_options_without_which_a_check_is_not_made(given_options):
    """Reproduce two defects of the checks of a good ODrive whose options ``endpoint_*`` are not set.

    The check of the watchdog failed. The check of the drive's settings passed, although handctl
    cannot read any setting without the options ``endpoint_*``.
    """
    all_options = OPTIONS_BY_PROTOCOL["odrive"]
    options = OPTIONS_WITHOUT_ENDPOINTS | {
        key: all_options[key] for key in ENDPOINT_OPTIONS[:given_options]
    }
    checks, _, _ = check_results("odrive", drive_options=options)
    assert failed_checks(checks) == []
    expected = {0: ["readback", "watchdog"], 2: ["readback"], 4: []}[given_options]
    assert unchecked_results(checks) == [FAILED_CHECK[fault] for fault in expected]
    for fault, missing in (
        ("readback", ENDPOINT_OPTIONS[given_options:]),
        ("watchdog", ENDPOINT_OPTIONS[:2]),
    ):
        if fault in expected:
            assert all(option in checks[FAILED_CHECK[fault]].reason for option in missing)


def test_an_odrive_that_confirms_writes_passes_every_check():
    """Reproduce a defect: handctl counted each confirmation of a written setting as a frame that it could not decode.

    ODrive firmware 0.6.11 and later confirms each write of a setting. The confirmation frame
    contains no value, so it is 4 bytes long.
    """
    options = OPTIONS_BY_PROTOCOL["odrive"]
    virtual_bench = VirtualBench("odrive", **options, confirms_writes=True)
    rig = make_drive_rig(virtual_bench, "odrive", TORQUE_LIMIT_N_M)
    checks = {
        check.name: check for check in run_checks(DeviceUnderTest(rig, TORQUE_LIMIT_N_M, 0.05))
    }
    assert failed_checks(checks) == []
    assert unchecked_results(checks) == []


def test_an_odrive_whose_watchdog_was_set_over_usb_passes_without_options():
    virtual_bench = VirtualBench("odrive", usb_watchdog_s=0.1)
    rig = make_drive_rig(virtual_bench, "odrive", TORQUE_LIMIT_N_M, OPTIONS_WITHOUT_ENDPOINTS)
    checks = {
        check.name: check for check in run_checks(DeviceUnderTest(rig, TORQUE_LIMIT_N_M, 0.1))
    }
    assert checks[FAILED_CHECK["watchdog"]].verdict is CheckVerdict.PASSED


@pytest.mark.parametrize("protocol", sorted(PROTOCOL_TRAITS.keys() - set(VERIFIABLE_PROTOCOLS)))
def test_a_good_motor_without_guards_passes_all_that_can_be_checked_three_times(protocol):
    """Reproduce a defect: a good motor with unreadable protections failed the checks of watchdog and torque cut."""
    virtual_bench = VirtualBench(protocol)
    for checks in run_checks_three_times(virtual_bench, protocol):
        assert failed_checks(checks) == []
        names = unchecked_results(checks)
        assert names == [FAILED_CHECK["readback"], FAILED_CHECK["watchdog"], TORQUE_CUT_CHECK_TITLE]
        assert all("the protocol has no " in checks[name].reason for name in names)


def test_an_odrive_without_endpoint_options_passes_all_that_can_be_checked_three_times():
    virtual_bench = VirtualBench("odrive", **OPTIONS_WITHOUT_ENDPOINTS)
    for checks in run_checks_three_times(virtual_bench, "odrive", OPTIONS_WITHOUT_ENDPOINTS):
        assert failed_checks(checks) == []
        assert len(unchecked_results(checks)) == 2


def test_a_reason_names_a_few_identifiers_of_many():
    """Reproduce a defect: the reason of a failed check contained all 1025 reply identifiers of a RobStride motor."""
    checks, _, _ = check_results("robstride", "mute")
    assert len(checks[FAILED_CHECK["mute"]].reason) < 160


def test_a_motor_in_velocity_mode_is_set_to_mit_mode():
    """In this test, the register CTRL_MODE contains the value 3 (velocity mode), as an earlier client can leave it."""
    virtual_bench = VirtualBench("mit")
    node = virtual_bench.bench.nodes[0]
    node.registers.write(10, (3).to_bytes(4, "little"))
    node._update_derived_values()
    rig = make_drive_rig(virtual_bench, "mit", TORQUE_LIMIT_N_M)
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase.name == "READY", 2.0)
    assert node.mode == 1


@pytest.mark.parametrize("clear_is_answered", ["each", "error", "never"])
def test_an_error_is_cleared_whether_the_clear_command_is_answered_or_not(clear_is_answered):
    """Reproduce a defect: the host waited for a reply to the clear command.

    Without a reply to the clear command, the host never regarded the motor as ready.
    """
    virtual_bench = VirtualBench("mit", clear_answers=clear_is_answered)
    rig = make_drive_rig(virtual_bench, "mit", TORQUE_LIMIT_N_M)
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase.name == "READY", 2.0)
    virtual_bench.bench.faults.inject("error node=33")
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase.name == "FAULT", 1.0)
    rig.clear_faults()
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase.name == "READY", 2.0), (
        rig.state.error_text
    )


@pytest.mark.parametrize("watchdog_ms", ["commands", "frames", "always"])
def test_a_disabled_motor_is_ready_whenever_its_watchdog_fires(watchdog_ms):
    """Register requests do not reset the watchdog of a motor.

    Earlier defect: the watchdog of a disabled motor fired, so the motor had a fault before the hand
    was armed.
    """
    virtual_bench = VirtualBench("mit", watchdog=watchdog_ms)
    rig = make_drive_rig(virtual_bench, "mit", TORQUE_LIMIT_N_M)
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase.name == "READY", 2.0)
    reached_phases = set()

    def note(state):
        reached_phases.add(state.phase.name)
        return False

    rig.run_until(DriveTarget.POLL, note, 1.0)
    assert reached_phases == {"READY"}
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase.name == "ENABLED", 0.1)
    rig.run_for(DriveTarget.ENABLE, 0.2)
    virtual_bench.advance_time(0.3)
    rig.run_tick(DriveTarget.ENABLE)
    rig.run_tick(DriveTarget.ENABLE)
    assert (rig.state.phase.name, rig.state.error_text) == (
        "FAULT",
        "communication lost: the drive's watchdog fired",
    )


def test_a_motor_whose_watchdog_also_fires_while_disabled_passes_three_times():
    virtual_bench = VirtualBench("mit", watchdog="always")
    for _ in range(3):
        rig = make_drive_rig(virtual_bench, "mit", TORQUE_LIMIT_N_M)
        rig.clear_faults()
        checks = {
            check.name: check for check in run_checks(DeviceUnderTest(rig, TORQUE_LIMIT_N_M, 0.05))
        }
        assert failed_checks(checks) == [], {name: check.reason for name, check in checks.items()}
        assert release_drive(rig, 0.05)
