"""Test a stream of targets to a hand on real SocketCAN.

The client, the controller and the simulated hand are three processes.
"""

import contextlib
from pathlib import Path
from typing import Any

import pytest

from benchmarks import streaming
from handctl import DriveError, UnconfirmedError
from handctl.hand.hand_loading import load_hand
from tests.runtime.processes import HOMED_HAND_OPTIONS, write_homed_calibration
from tests.vcan.inside.conftest import SIMULATOR_CODE, STALL_FAULTS, TIME_SCALE

TIME_SCALE_BY_ATTEMPT = (TIME_SCALE, 0.7 * TIME_SCALE, 0.4 * TIME_SCALE)
"""Time scale of each attempt to complete the stream.

With a smaller time scale, an interruption of the guest system takes less simulated time. A defect
has the same effect at any time scale.
"""
TRACKED_DURATION_S = 2.5
"""Duration of the streamed motion [s]. The tracking error of the first second does not count."""
MAX_ERROR_RATIO = 1.5
"""Largest permitted tracking error of a stream, divided by the tracking error of the same motion in a task."""


@pytest.mark.nightly
@pytest.mark.timeout(1200)
def test_a_streamed_sine_is_followed_like_a_task(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streaming, "SIMULATOR_ARGUMENTS", ["-c", SIMULATOR_CODE])
    monkeypatch.setattr(streaming, "TRACKED_DURATION_S", TRACKED_DURATION_S)
    monkeypatch.setattr(streaming, "INTERPOLATION_NAMES", ("minimum_jerk",))
    calibration = tmp_path / "jamia.calibration.toml"
    write_homed_calibration(calibration, load_hand("jamia"))
    for time_scale in TIME_SCALE_BY_ATTEMPT:
        with contextlib.suppress(GuestStoppedError):
            result = measure_tracking(time_scale, calibration)
            break
    else:
        pytest.fail("the guest stood still in every attempt")
    print(f"time scale {time_scale:g}: {result}")
    assert result["minimum_jerk_ratio"] < MAX_ERROR_RATIO


class GuestStoppedError(Exception):
    """Error for a run that ended because the only core of the guest was busy."""


def measure_tracking(time_scale: float, calibration_file: Path) -> dict[str, Any]:
    """Measure the tracking error of the same motion twice: as a stream of targets, and as a task.

    Raises:
        GuestStoppedError: the client, the controller or the simulated hand did not run for some
            time.
    """
    try:
        return streaming.measure_tracking(
            "socketcan:vcan0", time_scale, (calibration_file, HOMED_HAND_OPTIONS)
        )
    except UnconfirmedError as error:  # the controller ended before it received a request
        raise GuestStoppedError from error
    except DriveError as error:
        if any(fault in str(error) for fault in STALL_FAULTS):
            raise GuestStoppedError from error
        raise
