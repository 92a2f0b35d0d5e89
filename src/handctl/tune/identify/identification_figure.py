"""Figure of an identification, with measurements, fitted model, and differences from the hand file."""

from pathlib import Path
from typing import Any

import numpy as np

from handctl.core.identified_parameters import PARAMETER_UNITS
from handctl.output_files import save_figure
from handctl.tune.identify.fit_load import LoadParameters
from handctl.tune.identify.fit_tendon import LOAD_PARAMETERS, PARAMETER_NAMES, stop_stiffness
from handctl.tune.identify.identify import EXCITATION_BAND_HZ, TendonResult

MEASURED_COLOR = "#3b6fb6"
MODEL_COLOR = "#d9822b"
WARN_COLOR = "#999999"


def draw_identification(path: Path, result: TendonResult, title: str) -> None:
    """Draw the result of the identification of a tendon as a PNG file.

    Args:
        path: path of the file to write.
        result: result of the identification of the tendon.
        title: title of the figure.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(15.0, 8.5), layout="constrained")
    figure.suptitle(title)
    _draw_tension_over_time(axes[0, 0], result)
    _draw_stop_stretch(axes[0, 1], result)
    _draw_free_sweep(axes[0, 2], result)
    _draw_motor_equation(axes[1, 0], result)
    _draw_coherence(axes[1, 1], result)
    _draw_parameters(axes[1, 2], result)
    save_figure(figure, path)
    plt.close(figure)


def _draw_tension_over_time(axes: Any, result: TendonResult) -> None:
    data = result.data
    axes.plot(data.t, data.command, color=MODEL_COLOR, lw=0.6, label="motor force")
    axes.plot(data.t, data.tension, color=MEASURED_COLOR, lw=0.6, label="load cell")
    axes.set(title="signals", xlabel="t [s]", ylabel="force at the tendon [N]")
    axes.legend(loc="upper left")


def _drift_at(result: TendonResult, t: Any) -> Any:
    return np.interp(t, result.fit.problem.drift_knots, result.fit.z[len(PARAMETER_NAMES) :])


def _draw_stop_stretch(axes: Any, result: TendonResult) -> None:
    bins = result.fit.problem.open_stop_bins
    values = result.fit.parameter_values
    axes.set(title="tendon, on the open stop", xlabel="tendon travel [um]", ylabel="tension [N]")
    if not len(bins.t):
        axes.text(0.5, 0.5, "no such data", ha="center", transform=axes.transAxes)
        return
    order = np.argsort(bins.travel)
    # The tendon and the open stop act as springs in series.
    slope = stop_stiffness(
        values["tendon_stiffness"], values["stop_softness"], result.fit.problem.parameter_scales
    )
    axes.plot(
        1e6 * bins.travel,
        bins.tension - _drift_at(result, bins.t),
        ".",
        color=MEASURED_COLOR,
        label="50 ms means",
    )
    line = slope * (bins.travel[order] - values["stretch_offset"])
    label = f"k = {values['tendon_stiffness'] / 1e3:.1f} kN/m"
    axes.plot(1e6 * bins.travel[order], line, color=MODEL_COLOR, label=label)
    axes.legend()


def _draw_free_sweep(axes: Any, result: TendonResult) -> None:
    problem = result.fit.problem
    bins = problem.free_motion_bins
    axes.set(
        title="springs and friction, in free sweeps",
        xlabel="tendon travel [mm]",
        ylabel="tension [N]",
    )
    if not len(bins.t) or problem.digit_load is None:
        axes.text(0.5, 0.5, "no such data", ha="center", transform=axes.transAxes)
        return
    p = result.fit.z[: len(PARAMETER_NAMES)] * problem.parameter_scales
    model = problem.digit_load.expected_tension(LoadParameters(*p[LOAD_PARAMETERS].tolist()), bins)
    axes.plot(
        1e3 * bins.travel,
        bins.tension - _drift_at(result, bins.t),
        ".",
        ms=4,
        color=MEASURED_COLOR,
        label="10 ms means",
    )
    axes.plot(1e3 * bins.travel, model, ".", ms=3, color=MODEL_COLOR, label="model")
    axes.legend()


def _draw_motor_equation(axes: Any, result: TendonResult) -> None:
    windows = result.fit.problem.motor_windows
    values = result.fit.parameter_values
    r = result.fit.problem.spool_radius_m
    drive = values["torque_gain"] * windows.delayed_command(values["delay"]) - (
        windows.tension - _drift_at(result, windows.t)
    )
    friction = (
        values["motor_viscous"] / r * windows.speed + values["motor_coulomb"] * windows.sign
    ) / r
    axes.plot(
        windows.acceleration,
        drive - friction,
        ".",
        ms=3,
        color=MEASURED_COLOR,
        label="remaining force",
    )
    acceleration_range = np.array([windows.acceleration.min(), windows.acceleration.max()])
    label = f"J = {values['motor_inertia']:.3g} kg m2"
    axes.plot(
        acceleration_range,
        values["motor_inertia"] / r**2 * acceleration_range,
        color=MODEL_COLOR,
        label=label,
    )
    axes.set(title="rotor: force less friction", xlabel="tendon acceleration [m/s2]", ylabel="[N]")
    axes.legend()


def _draw_coherence(axes: Any, result: TendonResult) -> None:
    f, c = result.spectrum
    axes.plot(f, c, color=MEASURED_COLOR)
    axes.axvspan(*EXCITATION_BAND_HZ, color=MODEL_COLOR, alpha=0.15, label="swing")
    axes.set(
        title="coherence of motor force and speed",
        xlabel="f [Hz]",
        ylim=(0.0, 1.05),
        xlim=(0.0, 25.0),
    )
    axes.legend()


def _draw_parameters(axes: Any, result: TendonResult) -> None:
    """Draw the identified parameters and their confidence intervals.

    Each parameter is divided by its value in the hand file.
    """
    names = [name for name in PARAMETER_UNITS if name != "delay"]
    values = result.fit.parameter_values
    half_widths = result.fit.half_widths
    nominal = result.fit.problem.parameter_scales
    low = 0.4
    high = 1.6
    for row, name in enumerate(names):
        scale = nominal[PARAMETER_NAMES.index(name)]
        identified = name in result.identifiability.names
        color = MEASURED_COLOR if identified else WARN_COLOR
        if identified:
            low = min(low, (values[name] - half_widths[name]) / scale)
            high = max(high, (values[name] + half_widths[name]) / scale)
            axes.errorbar(
                values[name] / scale,
                row,
                xerr=half_widths[name] / scale,
                fmt="o",
                color=color,
                capsize=3,
            )
        else:
            axes.text(1.0, row, "not identified", color=color, ha="center", va="center")
    axes.axvline(1.0, color=WARN_COLOR, lw=0.8)
    axes.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    axes.set(title="over the hand file, 95 %", xlim=(low, high), ylim=(len(names) - 0.5, -0.5))
