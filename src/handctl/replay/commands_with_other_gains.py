"""Commands that the controller would have given with other gains, computed for a recorded run.

The result compares the commands with other gains and the logged commands, as numbers and as a
figure. The controller is executed on the measurements in the log. The figure shows the new command
in each tick. The figure does not show the motion that the new commands would cause.

The measurements in the log are the result of the old commands, so the new commands and the
measurements do not match. If the commands contradict the measurements, the safety monitor can see a
fault and relax the hand. When the safety monitor has relaxed the hand, the commands no longer
depend on the gains, and the comparison ends.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import TickEvent, TickIn, TickOut
from handctl.log.read.reader import RunLog
from handctl.output_files import save_figure
from handctl.replay.run_comparison import rms_and_peak_difference

Array = NDArray[np.float64]
LOGGED_COMMAND_COLOUR = "#3b6fb6"
"""Colour of the line that shows the logged command."""
NEW_COMMAND_COLOUR = "#d9822b"
"""Colour of the line that shows the command of the other gains."""


class CommandCollector:
    """Collector of the commands that the controller gives while a log is executed again.

    Pass the method `add_tick` to `execute_log` as `observer`.
    """

    def __init__(self) -> None:
        """Start without any tick."""
        self._torque: list[Array] = []
        self._tension: list[Array] = []
        self._reactions: list[tuple[int, int]] = []
        self._faults: list[tuple[int, TickEvent]] = []

    def add_tick(self, entry: TickIn, tick_output: TickOut) -> None:
        """Add the commands of one tick."""
        self._faults += [
            (len(self._torque), event) for event in tick_output.events if event.name == "fault"
        ]
        self._reactions.append((int(tick_output.mode), int(tick_output.action)))
        self._torque.append(tick_output.telemetry.motor_torque_goal)
        self._tension.append(tick_output.telemetry.tension_goal)

    def comparable_ticks(self, log: RunLog) -> int:
        """Return the number of ticks that can be compared with the log.

        The comparison ends at the first tick with another mode, or with another reaction to faults,
        than in the log.
        """
        mode, action = np.array(self._reactions).T
        is_different = (mode != log.mode) | (action != log.action)
        return int(np.argmax(is_different)) if is_different.any() else len(is_different)

    def texts_of_faults_in_tick(self, tick_index: int) -> list[str]:
        """Return the texts of the faults that became active in the tick with a given index."""
        return [event.text for at, event in self._faults if at == tick_index]

    @property
    def motor_torques(self) -> Array:
        """Return the commanded torque of each motor (ticks, M) [N m]."""
        return np.array(self._torque)

    @property
    def tendon_tensions(self) -> Array:
        """Return the commanded tension of each tendon (ticks, N) [N]."""
        return np.array(self._tension)


def command_differences(
    log: RunLog, commands: CommandCollector, tick_count: int
) -> dict[str, dict[str, dict[str, float]]]:
    """Return the RMS and the peak of the difference between new and logged commands.

    The result has torques [N m] by motor and tensions [N] by tendon.

    Args:
        log: log of the run.
        commands: commands that the controller gave with the new gains.
        tick_count: number of ticks to compare, see ``CommandCollector.comparable_ticks``.
    """
    torque = (commands.motor_torques - log.field("motor_torque_goal"))[:tick_count]
    tension = (commands.tendon_tensions - log.field("tension_goal"))[:tick_count]
    return {
        "motor_torque_N_m": {
            name: rms_and_peak_difference(torque[:, i]) for i, name in enumerate(log.header.motors)
        },
        "tension_N": {
            name: rms_and_peak_difference(tension[:, i])
            for i, name in enumerate(log.header.tendons)
        },
    }


def draw_commands(
    path: Path, log: RunLog, commands: CommandCollector, tick_count: int, title: str
) -> None:
    """Draw the commanded tension and motor torque of each tendon as a PNG file.

    The figure shows the logged commands and the commands with other gains. After the first tick
    whose reaction to a fault differs from the log, the commands cannot be compared. In the figure,
    a grey background marks all ticks without a comparison.

    Args:
        path: PNG file to write.
        log: log of the run.
        commands: commands that the controller gave with the other gains.
        tick_count: number of comparable ticks.
        title: title of the figure.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    n = len(log.header.tendons)
    figure = Figure(figsize=(13, 1.0 + 1.6 * n), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(n, 2, sharex=True, squeeze=False)
    figure.suptitle(title)
    pairs = (
        (
            "commanded tension [N]",
            log.header.tendons,
            log.field("tension_goal"),
            commands.tendon_tensions,
        ),
        (
            "commanded torque [N m]",
            log.header.motors,
            log.field("motor_torque_goal"),
            commands.motor_torques,
        ),
    )
    for column, (unit, names, logged_values, new_values) in enumerate(pairs):
        for i, name in enumerate(names):
            axes = rows[i, column]
            axes.plot(
                log.times,
                logged_values[:, i],
                color=LOGGED_COMMAND_COLOUR,
                linewidth=0.9,
                label="as logged",
            )
            axes.plot(
                log.times,
                new_values[:, i],
                color=NEW_COMMAND_COLOUR,
                linewidth=0.7,
                label="these gains",
            )
            if tick_count < len(log.times):
                axes.axvspan(
                    log.times[tick_count], log.times[-1], color="0.85", label="not comparable"
                )
            axes.set_ylabel(f"{name}\n{unit}", fontsize=8)
            axes.grid(alpha=0.3)
            axes.margins(x=0)
        rows[-1, column].set_xlabel("time [s]")
    lines, labels = rows[0, 0].get_legend_handles_labels()
    figure.legend(lines, labels, fontsize=8, loc="outside upper right", ncols=3)
    save_figure(figure, path, 100)
