"""Test the rig (drive, bus and clock) with which the conformance checks run a drive."""

import pytest

from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.mit.codec import MotorRanges
from handctl.drives.mit.drive import MitDrive
from handctl.runtime.diagnostics import drive_rig
from handctl.runtime.diagnostics.drive_rig import PERIOD_NS
from tests.drives.virtual_bench import OPTIONS_BY_PROTOCOL, VirtualBench, make_drive_rig


def test_everything_is_compiled_before_the_clock_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reproduce a defect: at the first command, the rig compiled code, which took a second.

    During the compilation, the watchdog of the drive fired.
    """
    order = []

    class Clock:
        def start(self) -> None:
            order.append("start")

    monkeypatch.setattr(drive_rig, "compile_kernels", lambda: order.append("prepare"))
    drive = MitDrive("m", 0, 1, 0x101, MotorRanges(12.5, 50.0, 0.8), 1, 0.0, 1000)
    drive_rig.DriveRig(drive, None, Clock())  # type: ignore[arg-type]
    assert order == ["prepare", "start"]


@pytest.mark.parametrize("protocol", OPTIONS_BY_PROTOCOL)
@pytest.mark.parametrize("missed_ticks", [1, 3, 100])
def test_missed_ticks_are_skipped_and_not_executed_later(protocol: str, missed_ticks: int) -> None:
    """Reproduce a defect: after a stall of the host, the rig sent the commands of all missed ticks at once."""
    virtual_bench = VirtualBench(protocol)
    rig = make_drive_rig(virtual_bench, protocol, 0.1)
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase == DrivePhase.READY, 5.0)
    first_tick = rig.k
    virtual_bench.advance_time((missed_ticks + 0.5) * PERIOD_NS * 1e-9)
    times = []
    send = virtual_bench.send
    virtual_bench.send = lambda frames: times.append(virtual_bench.now_ns()) or send(frames)  # type: ignore[method-assign]
    for _ in range(5):
        rig.run_tick(DriveTarget.POLL)
    # The stall ends half a period after a tick was due. The rig executes this tick at once.
    assert [t_ns // PERIOD_NS for t_ns in times] == [
        first_tick - 1 + missed_ticks + i for i in range(5)
    ]
    assert rig.t_ns == (first_tick - 1 + missed_ticks + 5) * PERIOD_NS
    assert rig.missed_ticks == 0


@pytest.mark.parametrize("protocol", OPTIONS_BY_PROTOCOL)
def test_a_drive_that_was_never_heard_is_not_confirmed_off(protocol: str) -> None:
    """Reproduce a defect: a drive counted as disabled although none of its replies had arrived.

    Another host can have enabled a drive whose replies do not arrive.
    """
    virtual_bench = VirtualBench(protocol, "mute")
    rig = make_drive_rig(virtual_bench, protocol, 0.1)
    rig.run_for(DriveTarget.POLL, 0.5)
    assert not rig.confirm_disabled(0.05)


@pytest.mark.parametrize("protocol", OPTIONS_BY_PROTOCOL)
@pytest.mark.parametrize("ticks", [0, 1, 3, 60])
def test_a_drive_whose_replies_end_after_the_enable_command_is_not_confirmed_off(
    protocol: str, ticks: int
) -> None:
    virtual_bench = VirtualBench(protocol)
    rig = make_drive_rig(virtual_bench, protocol, 0.1)
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase == DrivePhase.READY, 5.0)
    for _ in range(ticks):
        rig.run_tick(DriveTarget.ENABLE)
    virtual_bench.drain = list  # type: ignore[method-assign]
    virtual_bench.send = len  # type: ignore[method-assign]
    rig.run_tick(DriveTarget.ENABLE)
    assert not rig.confirm_disabled(0.05)


@pytest.mark.parametrize("protocol", OPTIONS_BY_PROTOCOL)
@pytest.mark.parametrize("ticks", [0, 1, 2, 5, 20, 60, 200])
def test_a_good_drive_is_confirmed_off_at_any_time_of_its_setup(protocol: str, ticks: int) -> None:
    rig = make_drive_rig(VirtualBench(protocol), protocol, 0.1)
    for _ in range(ticks):
        rig.run_tick(DriveTarget.POLL)
    assert rig.confirm_disabled(0.05)


@pytest.mark.parametrize("missed_ticks", [0, 6, 20])
@pytest.mark.parametrize("delay_ticks", [0, 1])
def test_the_velocity_after_missed_ticks_is_that_of_the_shaft(
    missed_ticks: int, delay_ticks: int
) -> None:
    """Reproduce a defect.

    The rig computed the velocity as if the ticks before and after a stall of the host were
    adjacent, so the computed velocity of the shaft was too high after the stall.
    """
    virtual_bench = VirtualBench("mit", delay_ticks=delay_ticks)
    motor = virtual_bench.bench.motors[0]
    wait = virtual_bench.wait

    def wait_while_shaft_turns(k: int) -> int:
        late = wait(k)
        motor.theta, motor.omega = virtual_bench.now_ns() * 1e-9, 0.0  # the shaft turns at 1 rad/s
        return int(late)

    virtual_bench.wait = wait_while_shaft_turns  # type: ignore[method-assign]
    rig = make_drive_rig(virtual_bench, "mit", 0.1)
    assert rig.run_until(DriveTarget.POLL, lambda state: state.phase == DrivePhase.READY, 2.0)
    rig.run_for(DriveTarget.POLL, 0.1)
    virtual_bench.advance_time(missed_ticks * PERIOD_NS * 1e-9)
    speeds = []
    for _ in range(20):
        rig.run_tick(DriveTarget.POLL)
        speeds.append(rig.velocity_rad_s)
    assert speeds == pytest.approx([1.0] * 20, rel=0.3)
