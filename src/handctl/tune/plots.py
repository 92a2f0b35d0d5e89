"""The pictures of a tuning: loops before and after, the Pareto front, the verification."""

from pathlib import Path
from typing import Any

import numpy as np

from handctl.core.model import HandModel
from handctl.hand.description import Hand
from handctl.log.read.reader import RunLog
from handctl.output import save_figure
from handctl.report.summary import mean_angles
from handctl.report.truth import Truth
from handctl.tune.loops.linear import LoopKind, loop
from handctl.tune.loops.margins import GAIN_MARGIN_DB, PHASE_MARGIN_DEG, grid, step_response
from handctl.tune.search.search import Found
from handctl.tune.verify import OLD_ROUNDS, Return

BEFORE, AFTER, GREY = "#d9822b", "#3b6fb6", "#9a9a9a"
STEP_S = {LoopKind.MOTION: 0.4, LoopKind.TENSION: 0.4}
STEP_UNIT = {LoopKind.MOTION: (1e6, "travel [um]"), LoopKind.TENSION: (1.0, "tension [N]")}


def _figure(width: float, height: float) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def draw_loops(path: Path, before: HandModel, after: HandModel, title: str) -> None:
    """Bode, Nyquist and disturbance step of the first tendon's two loops, before and after.

    Args:
        path: PNG to write.
        before, after: the hand with old and new gains.
        title: above it.
    """
    figure = _figure(13, 8)
    figure.suptitle(f"{title}: {before.hand.tendon_names[0]}")
    for row, kind in zip(figure.subplots(2, 4), LoopKind, strict=True):
        for model, colour, name in ((before, BEFORE, "before"), (after, AFTER, "after")):
            _loop(row, model, kind, colour, name)
        _frame(row, kind)
    save_figure(figure, path)


def _loop(row: Any, model: HandModel, kind: LoopKind, colour: str, name: str) -> None:
    system = loop(model, 0, kind)
    omega = grid(system.period)
    L = system.response(omega)[:, 0, 0]
    gain, phase, plane, step = row
    gain.loglog(omega / (2 * np.pi), np.abs(L), color=colour, label=name)
    phase.semilogx(omega / (2 * np.pi), np.degrees(np.unwrap(np.angle(L))), color=colour)
    plane.plot(L.real, L.imag, color=colour)
    times, values = step_response(model, 0, kind, STEP_S[kind])
    step.plot(times, values * STEP_UNIT[kind][0], color=colour)


def _frame(row: Any, kind: LoopKind) -> None:
    gain, phase, plane, step = row
    gain.axhline(1.0, color=GREY, linewidth=0.8)
    gain.set(title=f"{kind} loop: gain", xlabel="frequency [Hz]")
    gain.legend()
    phase.axhline(-180.0, color=GREY, linewidth=0.8)
    phase.axhline(-180.0 + PHASE_MARGIN_DEG, color=GREY, linewidth=0.8, linestyle=":")
    phase.set(title="phase [deg]", xlabel="frequency [Hz]")
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    plane.plot(np.cos(turn), np.sin(turn), color=GREY, linewidth=0.8)
    plane.plot([-1.0], [0.0], "+", color="black")
    plane.plot([-(10.0 ** (-GAIN_MARGIN_DB / 20.0))], [0.0], "|", color="black")
    plane.set(title=f"Nyquist; bar: {GAIN_MARGIN_DB:g} dB", xlim=(-2.5, 1.5), ylim=(-2.0, 2.0), aspect="equal")
    step.set(title="push of 1 N on the rotor", xlabel="time [s]", ylabel=STEP_UNIT[kind][1])
    for axes in row:
        axes.grid(alpha=0.3)


def draw_search(path: Path, found: Found, title: str) -> None:
    """The trials of a search with their Pareto front, and how the best came down.

    Args:
        path: PNG to write.
        found: finished trials.
        title: above it.
    """
    figure = _figure(11, 4.8)
    figure.suptitle(title)
    left, right = figure.subplots(1, 2)
    good = [one for one in found.trials if one.good]
    first = found.trials[0]
    effort = [one.score.effort_Nm_per_s for one in good]
    dots = left.scatter(
        [one.score.tracking_deg for one in good], [one.score.tension_N for one in good], c=effort, s=22, cmap="viridis"
    )
    if good:
        figure.colorbar(dots, ax=left, label="effort [N m/s]")
    front = [one for one in good if one.number in found.front]
    left.plot(
        [one.score.tracking_deg for one in front],
        [one.score.tension_N for one in front],
        "o",
        mfc="none",
        mec=BEFORE,
        ms=9,
        label="Pareto front",
    )
    if not first.score.failure:
        left.plot(first.score.tracking_deg, first.score.tension_N, "x", color="black", label="where it began")
    if found.best:
        left.plot(found.best.score.tracking_deg, found.best.score.tension_N, "*", color=AFTER, ms=14, label="chosen")
    left.set(xlabel="tracking error [deg rms]", ylabel="tension error [N rms]", title="good trials")
    left.legend()
    costs = [found.cost(one) if one.good else np.nan for one in found.trials]
    right.plot(costs, ".", color=GREY)
    if good:
        right.step(range(len(costs)), np.fmin.accumulate(costs), where="post", color=AFTER)
    right.axhline(1.0, color="black", linewidth=0.8, linestyle=":")
    right.set(xlabel="trial", ylabel="cost, the first trial's is 1", title="the best so far")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    save_figure(figure, path)


def draw_verify(path: Path, log: RunLog, hand: Hand, truth: Truth | None, offset_ns: int, back: Return | None) -> None:
    """Angles, tensions and motor torques of a verification, with where new gains came and went.

    Args:
        path: PNG to write.
        log: of the verification.
        hand: that ran.
        truth: of the simulator, or None.
        offset_ns: the run's t = 0 on the simulator's clock [ns].
        back: the way back, if it was taken.
    """
    figure = _figure(12, 7.5)
    figure.suptitle(f"{hand.name}: {hand.digit_names[0]}, old gains first, new ones shaded")
    angle, tension, torque = figure.subplots(3, 1, sharex=True)
    goal, estimate = (np.degrees(mean_angles(hand, log.field(name)))[:, 0] for name in ("q_goal", "q"))
    angle.plot(log.times, goal, "--", color=GREY, label="goal")
    angle.plot(log.times, estimate, color=AFTER, linewidth=0.9, label="estimate")
    tension.plot(log.times, log.field("tension_goal")[:, 0], "--", color=GREY)
    tension.plot(log.times, log.field("tension")[:, 0], color=AFTER, linewidth=0.9)
    if truth is not None:
        t_ns = log.t_ns + offset_ns
        real = mean_angles(hand, truth.table([f"q/{joint}" for joint in hand.joints], t_ns))[:, 0]
        angle.plot(log.times, np.degrees(real), color=BEFORE, linewidth=0.7, label="truth")
        tension.plot(log.times, truth.at(f"tension/{hand.tendon_names[0]}", t_ns), color=BEFORE, linewidth=0.7)
    torque.plot(log.times, log.field("motor_torque_goal")[:, 0], color=AFTER, linewidth=0.6)
    begins = [change.t_ns / 1e9 for change in log.phases if change.name == "settle"]
    for axes, name in ((angle, "mean angle [deg]"), (tension, "tension [N]"), (torque, "motor torque [N m]")):
        if len(begins) > OLD_ROUNDS:
            axes.axvspan(begins[OLD_ROUNDS], back.t_s if back else float(log.times[-1]), color=AFTER, alpha=0.1)
        if back:
            axes.axvline(back.t_s, color="#b03030")
        axes.set(ylabel=name)
        axes.grid(alpha=0.3)
        axes.margins(x=0)
    angle.legend(loc="upper right")
    torque.set(xlabel=f"time [s]{'; red: ' + back.why if back else ''}")
    save_figure(figure, path)
