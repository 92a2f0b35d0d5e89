"""Small pictures of a run: the pose in each phase, the lateness of its ticks, the load of its buses; as SVG text."""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.controller.types import Mode
from handctl.drives.frame import FDF
from handctl.drives.load import frame_time_s
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.kinematics import points, to_palm
from handctl.log.reader import RunLog
from handctl.report.figure import COLOURS, QUIET

Array = NDArray[np.float64]

LOAD_WINDOW_S = 0.1


def poses(log: RunLog, hand: Hand) -> str:
    """The hand from the side (along the hinges) in the middle of each phase in which it acts."""
    moments = _moments(log)
    figure, row = _figure(max(1, len(moments)), 2.2, 2.5)
    digits = [DigitModel.of(hand, name) for name in hand.digit_names]
    q = log.field("q")
    for axes, (name, index) in zip(row, moments, strict=False):
        for d, digit in enumerate(digits):
            path = 1e3 * to_palm(digit, points(digit, q[index, digit.joints]))
            axes.plot(path[:, 0], path[:, 1], "o-", color=COLOURS[d % len(COLOURS)], markersize=2.5, linewidth=1.8)
        axes.set_title(f"{name}\n{log.times[index]:.2f} s", fontsize=8)
        axes.set_aspect("equal")
        axes.set(xlim=(-10, 100), ylim=(-75, 75))
        axes.tick_params(labelsize=6)
        axes.grid(alpha=0.3)
    row[0].set_ylabel("y [mm]", fontsize=7)
    row[0].set_xlabel("x, out of the palm [mm]", fontsize=7)
    return _svg(figure)


def _moments(log: RunLog) -> list[tuple[str, int]]:
    """Name and tick index of the middle of each phase in which the hand acts."""
    changes = log.phases
    ends = [change.k for change in changes[1:]] + [int(log.k[-1])]
    middles = [(c.name, int(np.searchsorted(log.k, (c.k + end) // 2))) for c, end in zip(changes, ends, strict=True)]
    return [(name, i) for name, i in middles if name not in QUIET and log.mode[i] == int(Mode.ACTIVE)][:9]


def lateness(log: RunLog) -> str:
    """Histogram of how late the ticks began, with the period's quarter, from which on a tick counts as late."""
    figure, (axes,) = _figure(1, 6.0, 2.2)
    late = log.late_ns / 1e3
    quarter = log.header.period_ns / 4e3
    axes.hist(late, bins=np.linspace(0.0, max(quarter, float(late.max(initial=0.0))), 80), color=COLOURS[0])
    axes.axvline(quarter, color=COLOURS[3], linewidth=0.8)
    axes.text(quarter, 0.9, " quarter period ", ha="right", fontsize=7, transform=axes.get_xaxis_transform())
    axes.set_yscale("symlog", linthresh=1)
    axes.set(xlabel="lateness [us]", ylabel="ticks")
    return _svg(figure)


def loads(log: RunLog, hand: Hand) -> tuple[str, Array]:
    """Share of each bus taken by the frames of the run over time, by their worst-case times.

    Returns:
        picture, (buses,) largest share in a window of ``LOAD_WINDOW_S``.
    """
    busy = np.zeros((len(log), len(hand.bus)))
    for i, tick in enumerate(log.ticks()):
        for frame in tick.tick_in.frames + tick.frames:
            if frame.bus < len(hand.bus):
                bus = hand.bus[frame.bus]
                fd = bool(frame.flags & FDF)
                busy[i, frame.bus] += frame_time_s(len(frame.data), fd, bus.bitrate, bus.data_bitrate)
    window = max(1, round(LOAD_WINDOW_S * 1e9 / log.header.period_ns))
    kernel = np.ones(window) / (window * log.header.period_ns * 1e-9)
    share = np.column_stack([np.convolve(column, kernel, "same") for column in busy.T])
    figure, (axes,) = _figure(1, 6.0, 2.2)
    for index, name in enumerate(hand.bus_names):
        axes.plot(log.times, 100 * share[:, index], color=COLOURS[index % len(COLOURS)], linewidth=0.9, label=name)
    axes.set(xlabel="time [s]", ylabel="bus load [%]", ylim=(0, None))
    axes.legend(fontsize=7, loc="lower right")
    return _svg(figure), share.max(axis=0, initial=0.0)


def _figure(columns: int, width: float, height: float) -> tuple[Any, list[Any]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width * columns, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(figure.subplots(1, columns, squeeze=False, sharey=True)[0])


def _svg(figure: Any) -> str:
    """The figure as an SVG element that stands in a page."""
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    return svg[svg.index("<svg") :]
