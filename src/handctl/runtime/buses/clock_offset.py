"""Offset between the wall clock and the clock CLOCK_MONOTONIC.

The offset converts the reception times of CAN frames.

The Linux kernel stamps received frames with the time of the wall clock. A run uses CLOCK_MONOTONIC.

The wall clock and CLOCK_MONOTONIC run at the same rate. Therefore the offset between both clocks
changes only when the wall clock is set. If the time stamp of a frame is impossible, the bus
requests a new measurement of the offset. In user-mode Linux, each clock reading is a system call.
In user-mode Linux, two clock readings in each tick would take as much time as the exchange of
frames, so each measured offset is used many times. Source: man 2 clock_gettime, man 7 vdso.
"""

import time

CONVERSIONS_PER_MEASUREMENT = 256
"""Number of times that each measured offset is used before the next measurement.

After a small step of the wall clock, at most this number of conversions uses the wrong offset.
"""
READINGS_PER_MEASUREMENT = 3
"""Number of clock readings in one measurement. The measurement uses the fastest reading."""


class ClockOffset:
    """Offset between wall clock and CLOCK_MONOTONIC.

    The offset is measured again after ``CONVERSIONS_PER_MEASUREMENT`` conversions of a time.
    """

    def __init__(self) -> None:
        """Start without a measurement."""
        self._uses_left = 0
        self._offset_ns = 0

    def offset_ns(self) -> int:
        """Return CLOCK_MONOTONIC minus CLOCK_REALTIME [ns]."""
        if not self._uses_left:
            self._measure_offset()
        self._uses_left -= 1
        return self._offset_ns

    def request_measurement(self) -> None:
        """Request a new measurement of the offset before the next use."""
        self._uses_left = 0

    def _measure_offset(self) -> None:
        """Measure the offset between the clocks.

        The result comes from the fastest of several readings. The operating system may have
        interrupted a slower reading.
        """
        readings = [
            (time.monotonic_ns(), time.time_ns(), time.monotonic_ns())
            for _ in range(READINGS_PER_MEASUREMENT)
        ]
        time_before, wall_ns, time_after = min(readings, key=_reading_duration)
        self._offset_ns = (time_before + time_after) // 2 - wall_ns
        self._uses_left = CONVERSIONS_PER_MEASUREMENT


def _reading_duration(reading: tuple[int, int, int]) -> int:
    """Return the duration of a reading [ns].

    A reading is a tuple of three times: before, wall clock, after.
    """
    return reading[2] - reading[0]
