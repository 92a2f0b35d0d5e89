"""What a fit's data cannot tell: parameters without information, directions in which they trade off.

Looks at the Jacobian of the data alone, in units of the hand file's values and of the load cell's noise: a column or a
combination of columns that hardly changes the residuals is not in the data, whatever a solver returns for it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import coherence

from handctl.core.identified import UNITS
from handctl.hand.file.sections import Tendon
from handctl.tune.identify.data import Array, TendonData
from handctl.tune.identify.fit import INFORMED, NAMES, SCALE_DELAY_S, Fit

CORRELATED = 0.95
SEGMENTS = 6
"""Parts of the excitation over which coherence is averaged; one part alone is coherent with anything."""


@dataclass(frozen=True, slots=True)
class Identifiability:
    """Of one tendon.

    Attributes:
        names: what the data tell.
        missing: what they do not tell, each with the reason.
        rank, columns: of the data's Jacobian without the drift.
        condition: its largest over its smallest singular value.
        weakest: the combination that the data tell least of, as text.
        correlated: pairs of identified parameters that trade off, with their correlation.
    """

    names: tuple[str, ...]
    missing: tuple[str, ...]
    rank: int
    columns: int
    condition: float
    weakest: str
    correlated: tuple[tuple[str, str, float], ...]


def identifiability(fit: Fit, tendon: Tendon) -> Identifiability:
    """Judge a fit.

    Args:
        fit: of a tendon.
        tendon: that tendon in the hand file.
    """
    jacobian = fit.sensitivity
    _, sizes, directions = np.linalg.svd(jacobian, full_matrices=False)
    widths, values = fit.half_widths, fit.values
    names = tuple(name for name in UNITS if _known(name, values[name], widths[name]) and _excited(jacobian, name))
    spread = np.sqrt(np.diag(fit.covariance))
    correlation = fit.covariance / np.outer(spread, spread)
    pairs = [(a, b, float(correlation[NAMES.index(a), NAMES.index(b)])) for a in names for b in names if a < b]
    return Identifiability(
        names=names,
        missing=(*(f"{name}: {_why(jacobian, name)}" for name in UNITS if name not in names), *_never(fit, tendon)),
        rank=int((1.96 / np.maximum(sizes, 1e-12) < INFORMED).sum()),
        columns=len(NAMES),
        condition=float(sizes[0] / max(sizes[-1], 1e-12)),
        weakest=_combination(directions[-1]),
        correlated=tuple(pair for pair in pairs if abs(pair[2]) > CORRELATED),
    )


def _known(name: str, value: float, width: float) -> bool:
    """Whether an interval is narrow enough to be of use; a delay counts in milliseconds, not in parts of itself."""
    scale = SCALE_DELAY_S if name == "delay" else abs(value)
    return bool(width < INFORMED * scale)


def _excited(jacobian: Array, name: str) -> bool:
    """Whether the parameter acts on any row of data."""
    return bool(np.linalg.norm(jacobian[:, NAMES.index(name)]) > 1e-6)


def _why(jacobian: Array, name: str) -> str:
    if not _excited(jacobian, name):
        return "nothing in the data depends on it"
    if name == "delay":
        return f"the 95 % interval is wider than {1e3 * INFORMED * SCALE_DELAY_S:g} ms to either side"
    return f"the 95 % interval is wider than {100 * INFORMED:.0f} % of the value to either side"


def _never(fit: Fit, tendon: Tendon) -> list[str]:
    """What this excitation cannot show, however long it lasts."""
    problem = fit.problem
    tension = np.concatenate([problem.motor.tension, problem.stop.tension, problem.free.tension])
    found = [
        "load-cell gain: torque gain, inertia, friction, rope and springs all scale with it; the load cell is taken as "
        "the measure of force",
        "link masses: taken from the hand file, within 30 %",
    ]
    if float(tension.max(initial=0.0)) < tendon.knee_N:
        found.append(
            f"knee of the rope: the data end at {tension.max(initial=0.0):.0f} N, the knee is at {tendon.knee_N:g} N"
        )
    rates = np.abs(problem.stop.speed)
    quick = float(rates.max(initial=0.0))
    share = tendon.damping_N_s_per_m * quick
    found.append(
        f"rope damping: on the stop it makes at most {share:.3f} N, the load cell hisses {problem.sigma:.2f} N"
    )
    return found


def _combination(direction: Array) -> str:
    """The largest parts of a direction."""
    order = np.argsort(-np.abs(direction))[:3]
    return ", ".join(f"{direction[i]:+.2f} {NAMES[i]}" for i in order if abs(direction[i]) > 0.1)


def excitation_coherence(data: TendonData) -> tuple[Array, Array]:
    """Coherence of motor force and cable speed where the digit moves: frequencies [Hz] and values from 0 to 1.

    1 means that the speed follows from the force by a linear law, less that noise, friction or something else moves it.
    """
    use = data.acting & np.isfinite(data.travel)
    force, travel = data.command[use], data.travel[use]
    if len(force) < 64:
        return np.zeros(0), np.zeros(0)
    speed = np.gradient(travel, data.period)
    f, c = coherence(force, speed, fs=1.0 / data.period, nperseg=max(64, len(force) // SEGMENTS))
    return np.asarray(f), np.asarray(c)
