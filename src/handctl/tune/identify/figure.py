"""The picture of an identification: what was measured, what the fit makes of it, and how far the hand file was off."""

from pathlib import Path
from typing import Any

import numpy as np

from handctl.core.identified import UNITS
from handctl.output import save_figure
from handctl.tune.identify.fit import NAMES, on_stop
from handctl.tune.identify.fit_load import LoadParameters
from handctl.tune.identify.identify import BAND_HZ, Found

MEASURED, MODEL, WARN = "#3b6fb6", "#d9822b", "#999999"


def draw(path: Path, found: Found, title: str) -> None:
    """Write the picture of one tendon as PNG.

    Args:
        path: of the picture.
        found: of the tendon.
        title: above it.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(15.0, 8.5), layout="constrained")
    figure.suptitle(title)
    _time(axes[0, 0], found)
    _stop(axes[0, 1], found)
    _free(axes[0, 2], found)
    _motor(axes[1, 0], found)
    _coherence(axes[1, 1], found)
    _parameters(axes[1, 2], found)
    save_figure(figure, path)
    plt.close(figure)


def _time(axis: Any, found: Found) -> None:
    data = found.data
    axis.plot(data.t, data.command, color=MODEL, lw=0.6, label="motor force")
    axis.plot(data.t, data.tension, color=MEASURED, lw=0.6, label="load cell")
    axis.set(title="what was done", xlabel="t [s]", ylabel="force at the cable [N]")
    axis.legend(loc="upper left")


def _drift(found: Found, t: Any) -> Any:
    return np.interp(t, found.fit.problem.knots, found.fit.z[len(NAMES) :])


def _stop(axis: Any, found: Found) -> None:
    seen, values = found.fit.problem.stop, found.fit.values
    axis.set(title="rope, on the open stop", xlabel="cable travel [um]", ylabel="tension [N]")
    if not len(seen.t):
        axis.text(0.5, 0.5, "not in these data", ha="center", transform=axis.transAxes)
        return
    order = np.argsort(seen.travel)
    slope = on_stop(values["rope_stiffness"], values["stop_softness"], found.fit.problem.nominal)
    axis.plot(1e6 * seen.travel, seen.tension - _drift(found, seen.t), ".", color=MEASURED, label="50 ms means")
    line = slope * (seen.travel[order] - values["stretch_offset"])
    label = f"k = {values['rope_stiffness'] / 1e3:.1f} kN/m"
    axis.plot(1e6 * seen.travel[order], line, color=MODEL, label=label)
    axis.legend()


def _free(axis: Any, found: Found) -> None:
    problem = found.fit.problem
    seen = problem.free
    axis.set(title="springs and friction, in free sweeps", xlabel="cable travel [mm]", ylabel="tension [N]")
    if not len(seen.t) or problem.load is None:
        axis.text(0.5, 0.5, "not in these data", ha="center", transform=axis.transAxes)
        return
    p = found.fit.z[: len(NAMES)] * problem.nominal
    model = problem.load.tension(LoadParameters(*p[5:-1].tolist()), seen)
    axis.plot(1e3 * seen.travel, seen.tension - _drift(found, seen.t), ".", ms=4, color=MEASURED, label="10 ms means")
    axis.plot(1e3 * seen.travel, model, ".", ms=3, color=MODEL, label="model")
    axis.legend()


def _motor(axis: Any, found: Found) -> None:
    seen, values, r = found.fit.problem.motor, found.fit.values, found.fit.problem.spool
    drive = values["torque_gain"] * seen.command(values["delay"]) - (seen.tension - _drift(found, seen.t))
    friction = (values["motor_viscous"] / r * seen.speed + values["motor_coulomb"] * seen.sign) / r
    axis.plot(seen.acceleration, drive - friction, ".", ms=3, color=MEASURED, label="force that is left over")
    ends = np.array([seen.acceleration.min(), seen.acceleration.max()])
    label = f"J = {values['motor_inertia']:.3g} kg m2"
    axis.plot(ends, values["motor_inertia"] / r**2 * ends, color=MODEL, label=label)
    axis.set(title="rotor: force less friction", xlabel="cable acceleration [m/s2]", ylabel="[N]")
    axis.legend()


def _coherence(axis: Any, found: Found) -> None:
    f, c = found.spectrum
    axis.plot(f, c, color=MEASURED)
    axis.axvspan(*BAND_HZ, color=MODEL, alpha=0.15, label="swing")
    axis.set(title="coherence of motor force and speed", xlabel="f [Hz]", ylim=(0.0, 1.05), xlim=(0.0, 25.0))
    axis.legend()


def _parameters(axis: Any, found: Found) -> None:
    """Every identified parameter over what the hand file says, with its interval."""
    names = [name for name in UNITS if name != "delay"]
    values, widths, nominal = found.fit.values, found.fit.half_widths, found.fit.problem.nominal
    least, most = 0.4, 1.6
    for row, name in enumerate(names):
        scale = nominal[NAMES.index(name)]
        known = name in found.judged.names
        color = MEASURED if known else WARN
        if known:
            least = min(least, (values[name] - widths[name]) / scale)
            most = max(most, (values[name] + widths[name]) / scale)
            axis.errorbar(values[name] / scale, row, xerr=widths[name] / scale, fmt="o", color=color, capsize=3)
        else:
            axis.text(1.0, row, "not identified", color=color, ha="center", va="center")
    axis.axvline(1.0, color=WARN, lw=0.8)
    axis.set_yticks(range(len(names)), names)
    axis.set(title="over the hand file, 95 %", xlim=(least, most), ylim=(len(names) - 0.5, -0.5))
