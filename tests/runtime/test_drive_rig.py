"""Test the rig (drive, bus and clock) with which the conformance checks run a drive."""

import pytest

from handctl.drives.mit.codec import MotorRanges
from handctl.drives.mit.drive import MitDrive
from handctl.runtime.diagnostics import drive_rig


def test_everything_is_compiled_before_the_clock_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Regression: at the first command, the rig compiled code for a second.

    In this second the watchdog of the drive fired.
    """
    order = []

    class Clock:
        def start(self) -> None:
            order.append("start")

    monkeypatch.setattr(drive_rig, "compile_kernels", lambda: order.append("prepare"))
    drive = MitDrive("m", 0, 1, 0x101, MotorRanges(12.5, 50.0, 0.8), 1, 0.0, 1000)
    drive_rig.DriveRig(drive, None, Clock())  # type: ignore[arg-type]
    assert order == ["prepare", "start"]
