"""Test the conformance checks on simulated drives in virtual time.

A good drive passes all checks. A broken drive fails the check that is made for its fault.
"""

import random

import pytest

from firmware_sim.faults.faulty_drive import DRIVE_FAULTS
from firmware_sim.nodes import PROTOCOL_SPECS as SIMULATED
from handctl.drives.contract import DriveTarget
from handctl.drives.motor_description import GUARDED_PROTOCOLS, PROTOCOL_TRAITS
from handctl.runtime.diagnostics.conformance import (
    CheckVerdict,
    ConformanceCheck,
    DeviceUnderTest,
    release_drive,
    run_checks,
)
from handctl.runtime.diagnostics.drive_rig import DriveRig
from tests.drives.virtual_bench import VirtualBench, drive_rig_on

TORQUE_LIMIT_N_M = 0.1


def check_results(
    protocol, fault="", options=None, inertia=None, delay=0
) -> tuple[dict[str, ConformanceCheck], VirtualBench, DriveRig]:
    place = VirtualBench(protocol, fault, inertia, delay)
    rig = drive_rig_on(place, protocol, TORQUE_LIMIT_N_M, options)
    return (
        {check.name: check for check in run_checks(DeviceUnderTest(rig, TORQUE_LIMIT_N_M, 0.05))},
        place,
        rig,
    )


@pytest.fixture(params=GUARDED_PROTOCOLS)
def protocol(request):
    return request.param


def failed_checks(found):
    return [name for name, check in found.items() if check.verdict is CheckVerdict.FAILED]


def test_a_good_drive_passes_every_conformance_check(protocol):
    failures, place, rig = check_results(protocol)
    assert [check for check in failures.values() if check.verdict is not CheckVerdict.PASSED] == []
    assert 0.0 < place.largest_torque <= TORQUE_LIMIT_N_M * 1.001
    assert rig.confirm_off(0.05)
    assert place.bench.motors[0].servo.torque == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_a_good_drive_passes_although_the_host_is_late(protocol, seed, monkeypatch):
    """In this test, the host stalls on average in every 40th tick, and then misses up to six ticks.

    Such a stall is shorter than the watchdog time of the drive.
    """
    source = random.Random(seed)
    wait = VirtualBench.wait

    def wait_and_stall(place, k):
        late = wait(place, k)
        if source.random() < 1.0 / 40.0:
            place.pass_time(source.uniform(0.0, 0.03))
            late = wait(place, k)
        return late

    monkeypatch.setattr(VirtualBench, "wait", wait_and_stall)
    found, place, rig = check_results(protocol)
    assert [check for check in found.values() if check.verdict is not CheckVerdict.PASSED] == []
    assert 0.0 < place.largest_torque <= TORQUE_LIMIT_N_M * 1.001
    assert rig.confirm_off(0.05)


def test_a_good_drive_passes_three_times_running(protocol):
    """Reproduce a defect: after the conformance checks, ODrives and CiA 402 drives had a latched error.

    These drives therefore failed when the checks ran a second time.
    """
    place = VirtualBench(protocol)
    for _ in range(3):
        rig = drive_rig_on(place, protocol, TORQUE_LIMIT_N_M)
        found = {
            check.name: check for check in run_checks(DeviceUnderTest(rig, TORQUE_LIMIT_N_M, 0.05))
        }
        assert failed_checks(found) == []
        assert release_drive(rig, 0.05)
        place.pass_time(2.0)
        late = drive_rig_on(place, protocol, TORQUE_LIMIT_N_M)
        late.run_tick(DriveTarget.LISTEN)
        late.run_for(DriveTarget.POLL, 0.3)
        assert late.state.error_text == "", "nothing is latched after a silence of two seconds"
        assert release_drive(late, 0.05)


@pytest.mark.parametrize("inertia", [2e-5, 1e-4, 2e-3])
@pytest.mark.parametrize("delay", [1, 3])
def test_a_light_shaft_and_a_slow_wire_pass_conformance(protocol, inertia, delay):
    failures, place, _ = check_results(protocol, inertia=inertia, delay=delay)
    assert failed_checks(failures) == []
    assert abs(place.bench.motors[0].omega) < 20.0


FAILED_CHECK = {
    "deaf": "disables on command, and reports it",
    "eager": "makes no torque until it is enabled",
    "twin": "is the only drive with its number",
    "mute": "identifies itself, takes its settings and reads them back",
    "readback": "identifies itself, takes its settings and reads them back",
    "sign": "turns the positive way by positive torque",
    "watchdog": "disables itself when the host falls silent, and stays off",
}


@pytest.mark.parametrize("fault", sorted(DRIVE_FAULTS))
def test_a_broken_drive_fails_its_check(protocol, fault):
    if fault == "eager" and not SIMULATED[protocol].force_command:
        pytest.skip("its simulated drive cannot follow a torque command while disabled")
    failures, place, _ = check_results(protocol, fault)
    assert FAILED_CHECK[fault] in failed_checks(failures)
    assert place.largest_torque <= TORQUE_LIMIT_N_M * 1.001


@pytest.mark.parametrize("fault", ["deaf", "eager", "mute", "sign", "twin"])
@pytest.mark.parametrize("protocol", sorted(PROTOCOL_TRAITS.keys() - set(GUARDED_PROTOCOLS)))
def test_a_broken_motor_without_guards_fails_its_check(protocol, fault):
    """Reproduce a defect: a CubeMars drive that ignores commands passed all checks.

    The feedback of such a drive does not report whether the drive is enabled.
    """
    good, _, _ = check_results(protocol)
    broken, place, _ = check_results(protocol, fault)
    assert FAILED_CHECK[fault] not in failed_checks(good)
    assert FAILED_CHECK[fault] in failed_checks(broken)
    assert place.largest_torque <= TORQUE_LIMIT_N_M * 1.05


@pytest.mark.parametrize(
    ("protocol", "identifier"), [("cubemars", "0x021"), ("robstride_mit", "0x000")]
)
def test_a_silent_motor_is_reported_with_the_expected_identifier(protocol, identifier):
    """Reproduce a defect: the printed reason "stays in SILENT" did not name the identifier for which handctl waited."""
    found, _, _ = check_results(protocol, "mute")
    check = found[FAILED_CHECK["mute"]]
    assert check.reason == f"no reply; expected frames with the identifier {identifier}"


@pytest.mark.parametrize("fault", ["", "deaf", "twin"])
def test_an_odrive_of_firmware_05_is_judged_without_torque_reports(fault):
    place = VirtualBench("odrive", fault, firmware="0.5", usb_watchdog_s=0.1)
    rig = drive_rig_on(place, "odrive", TORQUE_LIMIT_N_M, {"firmware": "0.5"})
    found = {check.name: check for check in run_checks(DeviceUnderTest(rig, TORQUE_LIMIT_N_M, 0.1))}
    assert failed_checks(found)[:1] == ([FAILED_CHECK[fault]] if fault else [])
    assert not any("nan" in check.reason for check in found.values())


def test_a_second_drive_never_turns(protocol):
    """The second drive is never enabled, because the checks stop when a second drive replies."""
    _, place, _ = check_results(protocol, "twin")
    assert place.largest_torque == 0.0


def test_a_drive_that_does_not_obey_is_left_to_its_watchdog(protocol):
    _, place, rig = check_results(protocol, "deaf")
    assert rig.confirm_off(0.05)
    assert place.bench.motors[0].servo.torque == 0.0


def test_a_blocked_shaft_is_no_failure(protocol):
    failures, _, _ = check_results(protocol, inertia=100.0)
    check = failures["turns the positive way by positive torque"]
    assert check.verdict is CheckVerdict.NOT_APPLICABLE
    assert "did not turn at +0.100 N m" in check.reason


def test_an_odrive_without_watchdog_fails_that_check_only():
    failures, _, _ = check_results("odrive", options={"torque_feedback": True})
    assert failed_checks(failures) == [FAILED_CHECK["watchdog"]]
    assert "CANSimple cannot read it" in failures[FAILED_CHECK["watchdog"]].reason
    for option in ("endpoint_enable_watchdog", "endpoint_watchdog_timeout"):
        assert option in failures[FAILED_CHECK["watchdog"]].reason


def test_a_motor_in_velocity_mode_is_set_to_mit_mode():
    """An earlier client may have left the value 3 (velocity mode) in the register CTRL_MODE."""
    place = VirtualBench("mit")
    node = place.bench.nodes[0]
    node.registers.write(10, (3).to_bytes(4, "little"))
    node._update_derived()
    rig = drive_rig_on(place, "mit", TORQUE_LIMIT_N_M)
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase.name == "READY", 2.0)
    assert node.mode == 1


@pytest.mark.parametrize("answers", ["each", "error", "never"])
def test_an_error_is_cleared_whether_the_clear_command_is_answered_or_not(answers):
    """Reproduce a defect: the host waited for a reply to the clear command.

    Without such a reply, the motor never became ready.
    """
    place = VirtualBench("mit", clear_answers=answers)
    rig = drive_rig_on(place, "mit", TORQUE_LIMIT_N_M)
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase.name == "READY", 2.0)
    place.bench.faults.inject("error node=33")
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase.name == "FAULT", 1.0)
    rig.clear_faults()
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase.name == "READY", 2.0), (
        rig.state.error_text
    )


@pytest.mark.parametrize("watchdog", ["commands", "frames", "always"])
def test_a_disabled_motor_is_ready_whenever_its_watchdog_fires(watchdog):
    """Register requests do not reset the watchdog of a motor.

    Earlier defect: the watchdog of a disabled motor fired, so the motor had a fault before it was
    armed.
    """
    place = VirtualBench("mit", watchdog=watchdog)
    rig = drive_rig_on(place, "mit", TORQUE_LIMIT_N_M)
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase.name == "READY", 2.0)
    seen = set()

    def note(state):
        seen.add(state.phase.name)
        return False

    rig.run_until(DriveTarget.POLL, note, 1.0)
    assert seen == {"READY"}
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase.name == "ENABLED", 0.1)
    rig.run_for(DriveTarget.ENABLE, 0.2)
    place.pass_time(0.3)
    rig.run_tick(DriveTarget.ENABLE)
    rig.run_tick(DriveTarget.ENABLE)
    assert (rig.state.phase.name, rig.state.error_text) == (
        "FAULT",
        "communication lost: the drive's watchdog fired",
    )


def test_a_motor_whose_watchdog_also_fires_while_disabled_passes_three_times():
    place = VirtualBench("mit", watchdog="always")
    for _ in range(3):
        rig = drive_rig_on(place, "mit", TORQUE_LIMIT_N_M)
        rig.clear_faults()
        found = {
            check.name: check for check in run_checks(DeviceUnderTest(rig, TORQUE_LIMIT_N_M, 0.05))
        }
        assert failed_checks(found) == [], {name: check.reason for name, check in found.items()}
        assert release_drive(rig, 0.05)
