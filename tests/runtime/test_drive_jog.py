"""Test the jogging of a simulated drive in virtual time: drive modes, limits, protections, and final drive state."""

import math
import struct
from itertools import pairwise

import pytest

from firmware_sim.bus.frame import Frame as SimFrame
from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.drive_modes import DriveMode, MotionLimits
from handctl.drives.protocol_registry import make_drive, make_mode_drive
from handctl.errors import ConfigError
from handctl.runtime.diagnostics.conformance import release_drive
from handctl.runtime.diagnostics.drive_jog import (
    MAX_MISSED_TICKS,
    JogGoal,
    distance_at,
    jog_drive,
)
from handctl.runtime.diagnostics.drive_rig import PERIOD_NS, DriveRig
from tests.drives.protocol_bench import motor_on_bench
from tests.drives.virtual_bench import DRIVE_NODE_ID, OPTIONS_BY_PROTOCOL, VirtualBench

TORQUE_LIMIT_N_M = 0.2
MOTION_LIMITS = MotionLimits(3.0, 10.0)
JOG_PROTOCOLS = ("mit", "odrive", "cia402")
PROTOCOL_MODES = [
    (protocol, mode)
    for protocol in JOG_PROTOCOLS
    for mode in (DriveMode.POSITION, DriveMode.VELOCITY)
]
PROTOCOL_MODES.append(("mit", DriveMode.FORCE_POSITION))


def make_jog_bench(
    protocol,
    drive_mode,
    drive_fault="",
    motor_direction=1,
    motor_zero=0.0,
    motion_limits=MOTION_LIMITS,
):
    virtual_bench = VirtualBench(protocol, drive_fault)
    motor = motor_on_bench(
        protocol,
        DRIVE_NODE_ID,
        TORQUE_LIMIT_N_M,
        OPTIONS_BY_PROTOCOL[protocol],
        direction=motor_direction,
        zero_rad=motor_zero,
    )
    return (
        virtual_bench,
        DriveRig(
            make_mode_drive(motor, 0, drive_mode, motion_limits), virtual_bench, virtual_bench
        ),
        make_drive(motor, 0),
    )


def make_jog_goal(drive_mode, target_value, duration_s=2.0, travel_limit=10.0):
    return JogGoal(
        drive_mode, target_value, duration_s, MOTION_LIMITS, TORQUE_LIMIT_N_M, travel_limit
    )


@pytest.mark.parametrize(("protocol", "drive_mode"), PROTOCOL_MODES)
@pytest.mark.parametrize(
    ("motor_direction", "motor_zero", "target_sign"), [(1, 0.0, 1), (-1, 0.7, 1), (1, -1.3, -1)]
)
def test_a_drive_moves_in_its_own_mode_and_ends_at_rest(
    protocol, drive_mode, motor_direction, motor_zero, target_sign
):
    virtual_bench, rig, torque_drive = make_jog_bench(
        protocol, drive_mode, motor_direction=motor_direction, motor_zero=motor_zero
    )
    motor = virtual_bench.bench.motors[0]
    result = jog_drive(rig, make_jog_goal(drive_mode, 2.0 * target_sign))
    assert result.failure == ""
    expected = 2.0 * target_sign if drive_mode != DriveMode.VELOCITY else 2.0 * target_sign * 2.0
    assert result.moved_rad == pytest.approx(
        expected, rel=0.15 if drive_mode == DriveMode.VELOCITY else 0.02
    )
    assert motor_direction * motor.theta == pytest.approx(result.moved_rad, abs=0.05)
    assert result.max_speed_rad_s < 1.1 * MOTION_LIMITS.speed
    assert result.final_speed_rad_s < 0.05
    assert release_drive(rig, 0.05, torque_drive)
    assert rig.state.phase == DrivePhase.READY
    assert (motor.servo.kp, motor.servo.kd, motor.servo.torque) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("protocol", ["mit", "odrive", "cia402", "moteus", "robstride", "cubemars"])
def test_every_protocol_has_the_torque_mode(protocol):
    virtual_bench, rig, torque_drive = make_jog_bench(protocol, DriveMode.TORQUE)
    result = jog_drive(
        rig,
        JogGoal(DriveMode.TORQUE, 0.05, 0.3, MotionLimits(200.0, 10.0), TORQUE_LIMIT_N_M, 500.0),
    )
    assert result.failure == ""
    assert result.moved_rad > 0.01
    assert virtual_bench.largest_torque <= 0.06
    assert release_drive(rig, 0.05, torque_drive)


@pytest.mark.parametrize("protocol", ["moteus", "robstride", "cubemars"])
def test_a_protocol_without_the_mode_says_so(protocol):
    with pytest.raises(ConfigError, match="cia402, mit, odrive"):
        make_jog_bench(protocol, DriveMode.POSITION)


@pytest.mark.parametrize("protocol", ["odrive", "cia402"])
def test_force_position_is_a_mode_of_damiao_motors(protocol):
    with pytest.raises(ConfigError, match="force-position"):
        make_jog_bench(protocol, DriveMode.FORCE_POSITION)


@pytest.mark.parametrize(("protocol", "drive_mode"), PROTOCOL_MODES)
@pytest.mark.parametrize("target_value", [math.nan, math.inf, -math.inf, 1e3, -1e3])
def test_no_command_beyond_its_range_is_encoded(protocol, drive_mode, target_value):
    _, rig, _ = make_jog_bench(protocol, drive_mode)
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase == DrivePhase.READY, 5.0)
    rig.idle_command = lambda state: state.position if "position" in drive_mode.value else 0.0
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.ENABLED, 5.0)
    with pytest.raises(ValueError, match="expected at most"):
        rig.drive.advance(rig.state, rig.t_ns, DriveTarget.ENABLE, target_value)


@pytest.mark.parametrize(("protocol", "drive_mode"), PROTOCOL_MODES)
def test_a_drive_that_is_turned_away_stays_where_it_is_when_it_is_enabled(protocol, drive_mode):
    """The drive of this test starts at 5 rad.

    If the drive is at 5 rad, a position command of zero at the moment of enabling would move it by
    5 rad.
    """
    virtual_bench, rig, torque_drive = make_jog_bench(protocol, drive_mode)
    virtual_bench.bench.motors[0].theta = 5.0
    result = jog_drive(rig, make_jog_goal(drive_mode, 0.0, 1.0, 0.2))
    assert result.failure == ""
    assert virtual_bench.bench.motors[0].theta == pytest.approx(5.0, abs=0.01)
    assert release_drive(rig, 0.05, torque_drive)


@pytest.mark.parametrize(("protocol", "drive_mode"), PROTOCOL_MODES)
def test_travel_beyond_its_limit_stops_the_drive(protocol, drive_mode):
    virtual_bench, rig, _ = make_jog_bench(protocol, drive_mode)
    result = jog_drive(rig, make_jog_goal(drive_mode, 2.5, 4.0, 0.5))
    assert "expected at most 0.5" in result.failure
    assert rig.confirm_disabled(0.05)
    assert virtual_bench.bench.motors[0].servo.kd == 0.0


@pytest.mark.parametrize(("protocol", "drive_mode"), PROTOCOL_MODES)
def test_a_shaft_driven_too_fast_stops_the_drive(protocol, drive_mode):
    virtual_bench, rig, _ = make_jog_bench(protocol, drive_mode)
    wait = virtual_bench.wait

    def wait_with_fast_shaft(k):
        virtual_bench.bench.motors[0].omega = (
            20.0
            if virtual_bench.bench.t_ns > 2_000_000_000
            else virtual_bench.bench.motors[0].omega
        )
        return wait(k)

    virtual_bench.wait = wait_with_fast_shaft
    result = jog_drive(rig, make_jog_goal(drive_mode, 0.1, 4.0, 1e6))
    assert "rad/s, expected at most 3" in result.failure or "error" in result.failure
    assert rig.confirm_disabled(0.05)


@pytest.mark.parametrize(("protocol", "drive_mode"), PROTOCOL_MODES)
def test_the_watchdog_disables_a_drive_if_the_host_falls_silent(protocol, drive_mode):
    virtual_bench, rig, _ = make_jog_bench(protocol, drive_mode)
    assert jog_drive(rig, make_jog_goal(drive_mode, 1.0, 0.5)).failure == ""
    rig.run_for(DriveTarget.LISTEN, 0.5)
    assert (virtual_bench.bench.motors[0].servo.kd, virtual_bench.bench.motors[0].servo.torque) == (
        0.0,
        0.0,
    )
    rig.run_for(DriveTarget.ENABLE, 0.3)
    assert rig.state.phase == DrivePhase.FAULT, "the fault is latched"


@pytest.mark.parametrize(("protocol", "drive_mode"), PROTOCOL_MODES)
def test_a_drive_that_sends_nothing_is_not_enabled(protocol, drive_mode):
    virtual_bench, rig, _ = make_jog_bench(protocol, drive_mode, drive_fault="mute")
    assert jog_drive(rig, make_jog_goal(drive_mode, 1.0)).failure
    assert virtual_bench.bench.motors[0].theta == 0.0


def test_a_target_beyond_the_range_is_refused_before_it_is_enabled():
    virtual_bench, rig, _ = make_jog_bench("mit", DriveMode.POSITION)
    virtual_bench.bench.motors[0].theta = 11.0
    assert (
        "beyond its range of 12.5 rad"
        in jog_drive(rig, make_jog_goal(DriveMode.POSITION, 2.0)).failure
    )
    assert rig.state.phase == DrivePhase.READY


def test_a_drive_that_loses_its_largest_speed_is_a_fault():
    virtual_bench, rig, _ = make_jog_bench("mit", DriveMode.VELOCITY)
    assert jog_drive(rig, make_jog_goal(DriveMode.VELOCITY, 1.0, 0.5)).failure == ""
    virtual_bench.bench.receive(SimFrame(0x7FF, struct.pack("<HBBf", DRIVE_NODE_ID, 0x55, 6, 25.0)))
    rig.run_for(DriveTarget.ENABLE, 2.5)
    assert "MAX_SPD" in rig.state.error_text


def test_a_blocked_cia402_drive_reports_its_following_error():
    virtual_bench, rig, _ = make_jog_bench("cia402", DriveMode.POSITION)
    wait = virtual_bench.wait

    def blocked(k):
        virtual_bench.bench.motors[0].theta = virtual_bench.bench.motors[0].omega = 0.0
        return wait(k)

    virtual_bench.wait = blocked
    result = jog_drive(rig, make_jog_goal(DriveMode.POSITION, 3.0, 4.0))
    assert result.failure == "following error"
    assert result.moved_rad == pytest.approx(0.0, abs=0.01)


def stall_host(virtual_bench, rig, stall_time_s, missed_ticks):
    """Let the host miss consecutive ticks, ``stall_time_s`` seconds after the drive was enabled.

    Return the time [ns] and the command of each tick in which the drive is enabled.
    """
    wait, advance_drive = virtual_bench.wait, rig.drive.advance
    commands = []
    remaining_stalls = [missed_ticks]

    class CommandRecordingDrive:
        """Drive that stores the commands of the host."""

        def __getattr__(self, name):
            return getattr(drive, name)

        def advance(self, state, t_ns, target, command):
            if state.phase == DrivePhase.ENABLED and target == DriveTarget.ENABLE:
                commands.append((t_ns, command))
            return advance_drive(state, t_ns, target, command)

    def wait_with_stalls(k):
        if (
            remaining_stalls
            and commands
            and (k * PERIOD_NS - commands[0][0]) * 1e-9 >= stall_time_s
        ):
            # During the stall of the host, the test sends commands to the drive. Without commands,
            # the watchdog of the drive would end the jog.
            for n in range(remaining_stalls.pop()):
                wait(k + n)
                command = commands[-1][1]
                virtual_bench.send(
                    advance_drive(rig.state, rig.t_ns, DriveTarget.ENABLE, command)[1]
                )
                virtual_bench.advance_time(PERIOD_NS * 1e-9)
        return wait(k)

    drive, rig.drive, virtual_bench.wait = rig.drive, CommandRecordingDrive(), wait_with_stalls
    return commands


@pytest.mark.parametrize("missed_ticks", [1, 5, MAX_MISSED_TICKS])
@pytest.mark.parametrize("stall_time_s", [0.1, 1.98])
@pytest.mark.parametrize("drive_mode", [DriveMode.TORQUE, DriveMode.POSITION, DriveMode.VELOCITY])
def test_a_ramp_keeps_its_time_although_ticks_are_missed(drive_mode, stall_time_s, missed_ticks):
    """Reproduce a defect: after a stall of the host, the host sent the commands of all missed ticks at once."""
    ramp_samples = []
    for stall in (0, missed_ticks):
        virtual_bench, rig, _ = make_jog_bench("mit", drive_mode)
        commands = stall_host(virtual_bench, rig, stall_time_s, stall)
        target = {DriveMode.TORQUE: 0.005}.get(drive_mode, 2.0)
        goal = make_jog_goal(drive_mode, target)._replace(
            limits=MotionLimits(1e3, 10.0), max_travel_rad=1e4
        )
        assert jog_drive(rig, goal).failure == ""
        ramp_samples.append(commands)
    undisturbed_ramp, ramp = ramp_samples
    gaps = [time_after - time_before for (time_before, _), (time_after, _) in pairwise(ramp)]
    assert min(gaps) == PERIOD_NS, "no two commands in one period"
    assert max(gaps) == (missed_ticks + 1) * PERIOD_NS
    at_time = dict(undisturbed_ramp)
    late = gaps.index(max(gaps)) + 1
    # The command of the late tick was computed before the stall of the host. All later commands
    # follow the ramp. If the host stalls beyond the planned end of the motion, the motion ends
    # later.
    if stall_time_s < 1.0:
        for t_ns, command in ramp[late + 1 : late + 20]:
            assert command == pytest.approx(at_time[t_ns], abs=1e-6)
    assert ramp[-1][1] == pytest.approx(undisturbed_ramp[-1][1], abs=1e-6)


@pytest.mark.parametrize(("protocol", "drive_mode"), PROTOCOL_MODES)
def test_a_host_that_misses_too_many_ticks_ends_the_jog(protocol, drive_mode):
    """The jog ends because of the missed ticks.

    The watchdog of the drive cannot be the reason, because the drive gets commands during the stall
    of the host.
    """
    virtual_bench, rig, _ = make_jog_bench(protocol, drive_mode)
    commands = stall_host(virtual_bench, rig, 0.5, MAX_MISSED_TICKS + 1)
    result = jog_drive(rig, make_jog_goal(drive_mode, 1.0))
    assert f"missed {MAX_MISSED_TICKS + 1} ticks in a row" in result.failure
    assert 0.4 < (commands[-1][0] - commands[0][0]) * 1e-9 < 0.7
    assert rig.confirm_disabled(0.05)


@pytest.mark.parametrize(
    ("distance", "speed", "acceleration"), [(3.0, 1.0, 2.0), (-3.0, 10.0, 2.0), (0.0, 1.0, 1.0)]
)
def test_the_host_ramp_has_no_jump_and_keeps_its_limits(distance, speed, acceleration):
    step = 1e-3
    positions = [distance_at(i * step, distance, speed, acceleration) for i in range(6000)]
    speeds = [(b - a) / step for a, b in zip(positions, positions[1:], strict=False)]  # noqa: RUF007
    slopes = [(b - a) / step for a, b in zip(speeds, speeds[1:], strict=False)]  # noqa: RUF007
    assert (positions[0], positions[-1]) == (0.0, distance)
    assert max(map(abs, speeds)) <= speed * 1.001
    assert max(map(abs, slopes)) <= acceleration * 1.01


@pytest.mark.parametrize(
    "motion_limits", [MotionLimits(0.0, 1.0), MotionLimits(1.0, math.nan), MotionLimits(-1.0, 1.0)]
)
def test_limits_are_positive(motion_limits):
    with pytest.raises(ConfigError, match="more than 0"):
        make_jog_bench("mit", DriveMode.VELOCITY, motion_limits=motion_limits)
