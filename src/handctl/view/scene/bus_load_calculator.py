"""Load of each bus, computed from the CAN frames in the log."""

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from numpy.typing import NDArray

from handctl.drives.frame import EXTENDED_FLAG, FDF
from handctl.drives.frame_time import frame_time_s
from handctl.view.scene.chunk_arrays import FloatArray
from handctl.view.scene.run_info import RunInfo

MAX_PAYLOAD_BYTES = 64
"""Largest payload of a CAN FD frame [bytes]."""
BUS_LOAD_WINDOW_NS = 100_000_000
"""Length of the time window for which the load is computed [ns].

The window covers several ticks, because the controller often reads the reply to a command only in
the next tick.
"""


class BusLoadCalculator:
    """Calculator for the load of each bus.

    The load is the longest possible duration of all frames in the last `BUS_LOAD_WINDOW_NS`, as a
    fraction of `BUS_LOAD_WINDOW_NS`.

    The caller must pass the ticks in the order of time.
    """

    def __init__(self, run: RunInfo) -> None:
        """Compute how long a frame of each length occupies each bus at most.

        Args:
            run: data about the run and the hand, with the buses and the control period.
        """
        self._period_ns = run.header.period_ns
        seconds = [
            [
                [
                    [
                        frame_time_s(size, fd, bus.bitrate, bus.data_bitrate, extended)
                        for size in range(MAX_PAYLOAD_BYTES + 1)
                    ]
                    for extended in (False, True)
                ]
                for fd in (False, True)
            ]
            for bus in run.hand.bus
        ]
        self._times = np.rint(1e9 * np.array(seconds)).astype(np.int64)
        self._t = np.empty(0, np.int64)
        self._spent = np.empty((0, len(self._times)), np.int64)

    def loads_of_ticks(self, ticks: pa.StructArray) -> FloatArray:
        """Return the load of each bus (0 to 1) in each of the next n ticks, as an array (n, buses)."""
        tick_times = np.asarray(ticks.field("t_ns"))
        t = np.concatenate([self._t, tick_times])
        occupancy_ns = np.concatenate(
            [
                self._spent,
                self._bus_occupancy_ns(ticks.field("received"))
                + self._bus_occupancy_ns(ticks.field("sent")),
            ]
        )
        total = np.concatenate(
            [np.zeros((1, occupancy_ns.shape[1]), np.int64), np.cumsum(occupancy_ns, axis=0)]
        )
        # A difference of two running totals is the sum over a window.
        first_index = np.searchsorted(t, tick_times - BUS_LOAD_WINDOW_NS, side="right")
        window_ns = np.clip(tick_times + self._period_ns, self._period_ns, BUS_LOAD_WINDOW_NS)
        self._t = t[first_index[-1] :]
        self._spent = occupancy_ns[first_index[-1] :]
        return np.asarray(
            (total[len(t) - len(tick_times) + 1 :] - total[first_index]) / window_ns[:, None],
            np.float64,
        )

    def _bus_occupancy_ns(self, frames: pa.ListArray) -> NDArray[np.int64]:
        """Return for how long the frames of each tick occupy each bus (n, buses) [ns].

        The times are integers, because the sum of integers does not depend on the order of the
        additions.
        """
        counts: NDArray[np.int64] = np.diff(np.asarray(frames.offsets))
        tick = np.repeat(np.arange(len(frames)), counts)
        all_frames = frames.flatten()
        names = ("bus", "flags", "length", "can_id")
        bus, flags, size, can_id = (
            np.asarray(all_frames.field(name)).astype(np.intp) for name in names
        )
        is_valid_frame = (bus < len(self._times)) & (size <= MAX_PAYLOAD_BYTES)
        tick = tick[is_valid_frame]
        bus = bus[is_valid_frame]
        flags = flags[is_valid_frame]
        size = size[is_valid_frame]
        extended = (can_id[is_valid_frame] & EXTENDED_FLAG) // EXTENDED_FLAG
        occupancy_ns = np.zeros((len(frames), len(self._times)), np.int64)
        np.add.at(occupancy_ns, (tick, bus), self._times[bus, (flags & FDF) // FDF, extended, size])
        return occupancy_ns
