"""Plot the joint angles, tensions and tip forces in the log of a grasp, and mark its phases.

handctl demo --lockstep --log grasp.mcap
python plot_grasp.py grasp.mcap writes grasp.png. `handctl report grasp.mcap` writes a page with more plots.
"""

import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from handctl.log.read.reader import RunLog

PLOT_ROWS = (
    ("q", "angle [deg]", 180.0 / np.pi),
    ("tension", "tension [N]", 1.0),
    ("tip_force", "tip force [N]", 1.0),
)

LINE_STYLES = ("-", "--", ":", "-.")


def line_looks(line_names):
    """Return a colour and a line style for each name.

    Each digit has its own colour. Each joint or tendon of a digit has its own line style.
    """
    digits = [name.partition("_")[0] for name in line_names]
    colours = {digit: f"C{number}" for number, digit in enumerate(dict.fromkeys(digits))}
    numbers_in_digit = [digits[:i].count(digit) for i, digit in enumerate(digits)]
    return [
        {"color": colours[digit], "linestyle": LINE_STYLES[number_in_digit % len(LINE_STYLES)]}
        for digit, number_in_digit in zip(digits, numbers_in_digit, strict=True)
    ]


with RunLog(sys.argv[1]) as log:
    figure, axes = plt.subplots(len(PLOT_ROWS), sharex=True, figsize=(8, 7), layout="constrained")
    for axis, (field, label, factor) in zip(axes, PLOT_ROWS, strict=True):
        names = log.names(field)
        for name, values, look in zip(names, log.field(field).T, line_looks(names), strict=True):
            axis.plot(log.times, factor * values, label=name, linewidth=1.0, **look)
        axis.set_ylabel(label)
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="x-small", frameon=False)
    starts = [log.times[np.searchsorted(log.k, change.k)] for change in log.phases]
    for change, start, end in zip(log.phases, starts, [*starts[1:], log.times[-1]], strict=True):
        for axis in axes:
            axis.axvline(start, color="0.8", linewidth=0.8, zorder=0)
        if end - start > 0.3:  # short phases get no name, because the names would overlap
            above = axes[0].get_xaxis_transform()
            axes[0].text(start, 1.02, change.name, transform=above, rotation=30, fontsize="small")
    axes[-1].set_xlabel("time [s]")
    figure.savefig("grasp.png", dpi=120)
