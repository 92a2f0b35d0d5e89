"""Figures for tuning.

The figures show the control loops before and after a change of gains, the trials of a search, and a
verification.
"""

from pathlib import Path
from typing import Any

import numpy as np

from handctl.core.hand_model import HandModel
from handctl.hand.description import Hand
from handctl.log.read.reader import RunLog
from handctl.output_files import save_figure
from handctl.report.run_summary import mean_angles
from handctl.report.truth_record import TruthRecord
from handctl.tune.gains_verification import ROUNDS_WITH_OLD_GAINS, GainsRollback
from handctl.tune.loops.linear_models import LoopKind, open_loop
from handctl.tune.loops.margins import (
    MIN_GAIN_MARGIN_DB,
    MIN_PHASE_MARGIN_DEG,
    frequency_grid,
    step_response,
)
from handctl.tune.search.gain_search import SearchResult

OLD_GAINS_COLOR = "#d9822b"
NEW_GAINS_COLOR = "#3b6fb6"
GREY_COLOR = "#9a9a9a"
TRUTH_COLOR = "#000000"
STEP_RESPONSE_S = {LoopKind.MOTION: 0.4, LoopKind.TENSION: 0.4}
"""Duration of the drawn response to a disturbance step, by kind of loop [s]."""
STEP_RESPONSE_UNITS = {
    LoopKind.MOTION: (1e6, "travel [um]"),
    LoopKind.TENSION: (1.0, "tension [N]"),
}
"""Scale and axis label of the drawn response, by kind of loop."""


def _new_figure(width: float, height: float) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    # The figure has its own canvas, which needs neither a display nor the global state of pyplot.
    FigureCanvasAgg(figure)
    return figure


def draw_loops(path: Path, model_before: HandModel, model_after: HandModel, title: str) -> None:
    """Draw both loops of the first tendon with old and new gains: Bode plot, Nyquist plot and disturbance step.

    Args:
        path: PNG file to write.
        model_before: model of the hand with the old gains.
        model_after: model of the hand with the new gains.
        title: title of the figure.
    """
    figure = _new_figure(13, 8)
    figure.suptitle(f"{title}: {model_before.hand.tendon_names[0]}")
    for row, kind in zip(figure.subplots(2, 4), LoopKind, strict=True):
        for model, colour, name in (
            (model_before, OLD_GAINS_COLOR, "before"),
            (model_after, NEW_GAINS_COLOR, "after"),
        ):
            _draw_loop(row, model, kind, colour, name)
        _style_axes(row, kind)
    # If the legend were inside a plot, it would hide a part of the curves.
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper right", ncols=2)
    save_figure(figure, path)


def _draw_loop(axes_row: Any, model: HandModel, kind: LoopKind, colour: str, name: str) -> None:
    system = open_loop(model, 0, kind)
    omega = frequency_grid(system.period)
    L = system.frequency_response(omega)
    gain, phase, plane, step = axes_row
    gain.loglog(omega / (2 * np.pi), np.abs(L), color=colour, label=name)
    phase.semilogx(omega / (2 * np.pi), np.degrees(np.unwrap(np.angle(L))), color=colour)
    plane.plot(L.real, L.imag, color=colour)
    times, values = step_response(model, 0, kind, STEP_RESPONSE_S[kind])
    step.plot(times, values * STEP_RESPONSE_UNITS[kind][0], color=colour)


def _style_axes(axes_row: Any, kind: LoopKind) -> None:
    gain, phase, plane, step = axes_row
    gain.axhline(1.0, color=GREY_COLOR, linewidth=0.8)
    gain.set(title=f"{kind} loop: gain", xlabel="frequency [Hz]")
    phase.axhline(-180.0, color=GREY_COLOR, linewidth=0.8)
    phase.axhline(-180.0 + MIN_PHASE_MARGIN_DEG, color=GREY_COLOR, linewidth=0.8, linestyle=":")
    phase.set(title="phase [deg]", xlabel="frequency [Hz]")
    circle_angles = np.linspace(0.0, 2.0 * np.pi, 200)
    plane.plot(np.cos(circle_angles), np.sin(circle_angles), color=GREY_COLOR, linewidth=0.8)
    plane.plot([-1.0], [0.0], "+", color="black")
    # On the negative real axis, the gain margin is the distance from the origin to -1, divided by
    # the distance from the origin to the curve.
    plane.plot([-(10.0 ** (-MIN_GAIN_MARGIN_DB / 20.0))], [0.0], "|", color="black")
    plane.set(
        title=f"Nyquist; bar: {MIN_GAIN_MARGIN_DB:g} dB",
        xlim=(-2.5, 1.5),
        ylim=(-2.0, 2.0),
        aspect="equal",
    )
    step.set(
        title="force step of 1 N on the rotor",
        xlabel="time [s]",
        ylabel=STEP_RESPONSE_UNITS[kind][1],
    )
    for axes in axes_row:
        axes.grid(alpha=0.3)


def draw_search(path: Path, result: SearchResult, title: str) -> None:
    """Draw two plots of a search: the trials with the Pareto front, and the cost of the best trial so far.

    Args:
        path: PNG file to write.
        result: result of the search with its finished trials.
        title: title of the figure.
    """
    figure = _new_figure(11, 4.8)
    figure.suptitle(title)
    left_axes, right_axes = figure.subplots(1, 2)
    feasible_trials = [trial for trial in result.trials if trial.is_feasible]
    first_trial = result.trials[0]
    effort = [trial.score.effort_Nm_per_s for trial in feasible_trials]
    trial_points = left_axes.scatter(
        [trial.score.tracking_deg for trial in feasible_trials],
        [trial.score.tension_N for trial in feasible_trials],
        c=effort,
        s=22,
        cmap="viridis",
    )
    if feasible_trials:
        figure.colorbar(trial_points, ax=left_axes, label="effort [N m/s]")
    pareto_trials = [trial for trial in feasible_trials if trial.number in result.pareto_front]
    left_axes.plot(
        [trial.score.tracking_deg for trial in pareto_trials],
        [trial.score.tension_N for trial in pareto_trials],
        "o",
        mfc="none",
        mec=OLD_GAINS_COLOR,
        ms=9,
        label="Pareto front",
    )
    if not first_trial.score.failure:
        left_axes.plot(
            first_trial.score.tracking_deg,
            first_trial.score.tension_N,
            "x",
            color="black",
            label="initial gains",
        )
    if result.best:
        left_axes.plot(
            result.best.score.tracking_deg,
            result.best.score.tension_N,
            "*",
            color=NEW_GAINS_COLOR,
            ms=14,
            label="best",
        )
    left_axes.set(
        xlabel="tracking error [deg rms]", ylabel="tension error [N rms]", title="feasible trials"
    )
    # A legend beside the plots does not hide any trial.
    figure.legend(*left_axes.get_legend_handles_labels(), loc="outside lower left", ncols=3)
    costs = [
        result.relative_cost(trial) if trial.is_feasible else np.nan for trial in result.trials
    ]
    right_axes.plot(costs, ".", color=GREY_COLOR)
    if feasible_trials:
        right_axes.step(
            range(len(costs)), np.fmin.accumulate(costs), where="post", color=NEW_GAINS_COLOR
        )
    right_axes.axhline(1.0, color="black", linewidth=0.8, linestyle=":")
    right_axes.set(
        xlabel="trial", ylabel="cost relative to the first trial", title="best trial so far"
    )
    for axes in (left_axes, right_axes):
        axes.grid(alpha=0.3)
    save_figure(figure, path)


def draw_verify(
    path: Path,
    log: RunLog,
    hand: Hand,
    truth: TruthRecord | None,
    offset_ns: int,
    rollback: GainsRollback | None,
) -> None:
    """Draw angles, tensions and motor torques of a verification run, and the times at which the gains changed.

    Args:
        path: PNG file to write.
        log: log of the verification.
        hand: description of the hand of the run.
        truth: true values from the simulator, or None on hardware.
        offset_ns: time on the clock of the simulator at which the time of the run was 0 [ns].
        rollback: record of the return to the old gains during the run. None if the gains were not
            changed back.
    """
    figure = _new_figure(12, 7.5)
    figure.suptitle(f"{hand.name}: {hand.digit_names[0]}, old gains first, new gains shaded")
    angle, tension, torque = figure.subplots(3, 1, sharex=True)
    goal, estimate = (
        np.degrees(mean_angles(hand, log.field(name)))[:, 0] for name in ("q_goal", "q")
    )
    angle.plot(log.times, goal, "--", color=GREY_COLOR, label="command")
    angle.plot(log.times, estimate, color=NEW_GAINS_COLOR, linewidth=0.9, label="estimate")
    tension.plot(
        log.times, log.field("tension_goal")[:, 0], "--", color=GREY_COLOR, label="command"
    )
    tension.plot(
        log.times,
        log.field("tension")[:, 0],
        color=NEW_GAINS_COLOR,
        linewidth=0.9,
        label="estimate",
    )
    if truth is not None:
        t_ns = log.t_ns + offset_ns
        true_angle = mean_angles(
            hand, truth.interpolated_columns([f"q/{joint}" for joint in hand.joints], t_ns)
        )[:, 0]
        angle.plot(
            log.times,
            np.degrees(true_angle),
            color=TRUTH_COLOR,
            linewidth=0.7,
            label="true angle of the plant",
        )
        tension.plot(
            log.times,
            truth.interpolated_column(f"tension/{hand.tendon_names[0]}", t_ns),
            color=TRUTH_COLOR,
            linewidth=0.7,
            label="true tension of the plant",
        )
    torque.plot(
        log.times, log.field("motor_torque_goal")[:, 0], color=NEW_GAINS_COLOR, linewidth=0.6
    )
    phase_start_times = [change.t_ns / 1e9 for change in log.phases if change.name == "settle"]
    for axes, name in (
        (angle, "mean angle [deg]"),
        (tension, f"tension of {hand.tendon_names[0]} [N]"),
        (torque, "commanded torque [N m]"),
    ):
        if len(phase_start_times) > ROUNDS_WITH_OLD_GAINS:
            axes.axvspan(
                phase_start_times[ROUNDS_WITH_OLD_GAINS],
                rollback.t_s if rollback else float(log.times[-1]),
                color=NEW_GAINS_COLOR,
                alpha=0.1,
            )
        if rollback:
            axes.axvline(rollback.t_s, color="#b03030")
        axes.set(ylabel=name)
        axes.grid(alpha=0.3)
        axes.margins(x=0)
    for axes in (angle, tension):
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    torque.set(xlabel=f"time [s]{'; red: ' + rollback.why if rollback else ''}")
    save_figure(figure, path)
