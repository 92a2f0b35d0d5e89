"""Fitting one tendon: all equations at once, with the load cell's slow drift as part of what is unknown.

Parameters are scaled by what the hand file says, so that they are all of the order of one. Residuals are in standard
deviations of the load cell.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from handctl.errors import LogError
from handctl.hand.description import Hand
from handctl.hand.dynamics import DigitModel
from handctl.tune.identify.contact import Ramp, steepest
from handctl.tune.identify.data import Array, TendonData
from handctl.tune.identify.fit_load import Bins, DigitLoad, LoadParameters, bins
from handctl.tune.identify.fit_motor import MotorWindows, motor_windows
from handctl.tune.identify.solve import Solution, solve

NAMES = (
    "torque_gain", "motor_inertia", "motor_viscous", "motor_coulomb", "delay",
    "rope_stiffness", "spring_stiffness", "spring_preload", "capstan", "joint_damping", "link_mass",
    "stretch_offset", "stop_softness",
)  # fmt: skip
"""Parameters of a tendon, in the order of the fit; the load cell's drift follows."""
SCALE_DELAY_S, SCALE_OFFSET_M = 1e-3, 1e-4
PRIOR = {"link_mass": 0.3, "stop_softness": 0.5, "stretch_offset": 1000.0}
"""Spread, in scales, of what is known beforehand: masses are weighed. The rest is as good as unknown."""
SOFTNESS = 0.04
"""A stop gives way, too: by this share of what the hand file's rope does, give or take half of it. An assumption: at
the load cell rope and stop are springs in a row, and nothing that is measured tells them apart. The packaged
simulator's stops give way by 3.8e-7 m/N at the cable, which is 0.038."""
VAGUE = 3.0
"""Relative spread of everything else: it keeps a fit finite that has no data for a parameter."""
OFFSET_N = 1.0
"""Spread of what a tared load cell reads without tension [N]."""
KNOT_S = 1.0
"""Distance of the knots of the drift."""
STOP_BIN_S = 0.05
"""On the stop the cable creeps: only over this long does it cross enough encoder counts for their steps to average."""
LEAST, MOST = 0.02, 20.0
"""Of what a hand file says: what is beyond is no hand."""
CONFIDENCE = 0.95
INFORMED = 0.5
"""A parameter whose interval is wider than this share of its value is not identified."""


@dataclass(frozen=True, slots=True)
class Problem:
    """Everything that one fit looks at.

    Attributes:
        spool: [m]. nominal: (13,) scale of each parameter. load: the digit; None if it has several tendons.
        motor: windows. free, stop, limp: bins. knots: (k,) times of the drift's knots [s].
        sigma: of a load-cell sample [N]. step: of the drift from knot to knot [N].
    """

    spool: float
    nominal: Array
    load: DigitLoad | None
    motor: MotorWindows
    free: Bins
    stop: Bins
    limp: Bins
    knots: Array
    sigma: float
    step: float

    @staticmethod
    def of(data: TendonData, hand: Hand) -> "Problem":
        """Put the problem of a tendon together.

        Raises:
            LogError: nothing of it moves in the log.
        """
        index = hand.tendon_names.index(data.tendon)
        tendon, motor, digit = hand.tendon[index], hand.motor_of(data.tendon), DigitModel.of(hand, data.digit)
        spool = motor.spool_radius_m
        if not data.acting.any() or len(data.t) < 2:
            raise LogError(f"{data.tendon} is never driven", "the log", "a run with the hand armed")
        span = float(data.t[-1] - data.t[0])
        windows = motor_windows(data, spool)
        if len(windows.t) < 20:
            raise LogError(f"{data.tendon} hardly moves", "the log", "a run in which it moves")
        nominal = np.array(
            [
                *(1.0, motor.inertia_kg_m2, motor.viscous_N_m_s_per_rad, motor.coulomb_N_m, SCALE_DELAY_S),
                *(tendon.stiffness_N_per_m, 1.0, 1.0, tendon.friction_coefficient, 1.0, 1.0),
                *(SCALE_OFFSET_M, SOFTNESS),
            ]
        )
        single = digit.moment_arms.shape[0] == 1
        return Problem(
            spool=spool,
            nominal=np.where(nominal > 0.0, nominal, 1e-3),
            load=DigitLoad.of(digit) if single else None,
            motor=windows,
            free=bins(data, data.free, moving=True),
            stop=bins(data, data.stop, moving=False, bin_s=STOP_BIN_S),
            limp=bins(data, data.limp, moving=False, bin_s=STOP_BIN_S),
            knots=np.linspace(data.t[0], data.t[-1], max(2, round(span / KNOT_S) + 1)),
            sigma=_noise(data, hand.sensor_node.tension_noise_N),
            step=max(hand.sensor_node.tension_bias_drift_N, 1e-3) * (KNOT_S / 100.0) ** 0.5,
        )

    def start(self) -> Array:
        """(13 + k,) scaled parameters to begin with: what the hand file says."""
        first = np.ones(len(NAMES))
        first[NAMES.index("delay")] = 1.0
        first[NAMES.index("stretch_offset")] = self._first_offset() / SCALE_OFFSET_M
        return np.append(first, np.zeros(len(self.knots)))

    def bounds(self) -> tuple[Array, Array]:
        """Least and greatest scaled parameters: what is a matter of size stays positive."""
        free = np.full(len(NAMES) + len(self.knots), np.inf)
        low, high = -free, free
        sized = [i for i, name in enumerate(NAMES) if name not in ("delay", "stretch_offset")]
        low[sized], high[sized] = LEAST, MOST
        return low, high

    def _first_offset(self) -> float:
        """Stretch offset that the data on the stop speak for [m]; else the least travel in free motion."""
        stiffness = self.nominal[NAMES.index("rope_stiffness")]
        if len(self.stop.t):
            return float(np.mean(self.stop.travel - self.stop.tension / stiffness))
        return float(self.free.travel.min()) if len(self.free.t) else 0.0

    def residuals(self, z: Array) -> Array:
        """(rows,) in standard deviations: motor, free, stop, limp, drift, priors."""
        p = z[: len(NAMES)] * self.nominal
        drift = z[len(NAMES) :]
        return np.concatenate([*self._data(p, drift), *self._prior(z, drift)])

    def _data(self, p: Array, drift: Array) -> list[Array]:
        gain, inertia, viscous, coulomb, delay, stiffness = p[:6].tolist()
        m, r = self.motor, self.spool
        asked = gain * m.command(delay)
        lost = (inertia / r * m.acceleration + viscous / r * m.speed) / r + coulomb / r * m.sign
        rows = [(asked - lost - (m.tension - self._offset(m.t, drift))) / (self.sigma * m.spread)]
        for seen, model in self._expected(p, stiffness):
            rows.append((seen.tension - self._offset(seen.t, drift) - model) / (self.sigma / seen.count**0.5))
        return rows

    def _expected(self, p: Array, stiffness: float) -> list[tuple[Bins, Array]]:
        """Bins and the tension that they should show."""
        rows = [
            (self.stop, on_stop(stiffness, p[-1], self.nominal) * (self.stop.travel - p[-2])),
            (self.limp, np.zeros_like(self.limp.t)),
        ]
        if self.load is not None and len(self.free.t):
            rows.append((self.free, self.load.tension(LoadParameters(*p[5:-1].tolist()), self.free)))
        return rows

    def _offset(self, t: Array, drift: Array) -> Array:
        return np.asarray(np.interp(t, self.knots, drift))

    def _prior(self, z: Array, drift: Array) -> list[Array]:
        spread = np.array([PRIOR.get(name, VAGUE) for name in NAMES])
        return [np.diff(drift) / self.step, drift[:1] / OFFSET_N, (z[: len(NAMES)] - 1.0) / spread]


def on_stop(stiffness: float, softness: float, nominal: Array) -> float:
    """Stiffness of rope and stop in a row [N/m]."""
    return stiffness / (1.0 + softness * stiffness / float(nominal[NAMES.index("rope_stiffness")]))


@dataclass(frozen=True, slots=True)
class Fit:
    """What a fit found.

    Attributes:
        z: scaled parameters, drift included. covariance: of them. freedom: of each parameter's spread.
        sensitivity: (rows, 13), weighted Jacobian of the rows that are data.
        residual: (rows,), priors included.
        ramp: of tension that the free sweeps leave unexplained; None if the fit has none.
    """

    problem: Problem
    z: Array
    covariance: Array
    freedom: Array
    sensitivity: Array
    residual: Array
    ramp: Ramp | None = None

    @property
    def values(self) -> dict[str, float]:
        """Parameters in SI units, or as factors."""
        return dict(zip(NAMES, (self.z[: len(NAMES)] * self.problem.nominal).tolist(), strict=True))

    @property
    def half_widths(self) -> dict[str, float]:
        """Half of each 95 % interval, in the parameter's unit."""
        return self.half_widths_of(1)

    def half_widths_of(self, count: int) -> dict[str, float]:
        """Half of intervals that cover ``count`` parameters all at once with 95 %, in the parameters' units.

        Source: Sidak (1967): no less likely than if the parameters were independent.
        """
        spread = np.sqrt(np.diag(self.covariance))[: len(NAMES)] * self.problem.nominal
        wide = student.ppf(0.5 + 0.5 * CONFIDENCE ** (1.0 / count), self.freedom[: len(NAMES)])
        return dict(zip(NAMES, (wide * spread).tolist(), strict=True))


def fit(problem: Problem) -> Fit:
    """Solve for all parameters of a tendon."""
    times = _times(problem)
    found = solve(problem.residuals, problem.start(), problem.bounds(), times)
    sensitivity = found.jacobian[: len(times), : len(NAMES)]
    ramp = _ramp(problem, found)
    return Fit(problem, found.z, found.covariance, found.freedom, sensitivity, found.residual, ramp)


def _ramp(problem: Problem, found: Solution) -> Ramp | None:
    """Return the ramp of tension that the free sweeps leave unexplained."""
    free, load = problem.free, problem.load
    if load is None or not len(free.t):
        return None
    first = len(problem.motor.t) + len(problem.stop.t) + len(problem.limp.t)
    offset = float(found.z[NAMES.index("stretch_offset")]) * SCALE_OFFSET_M
    stiffness = float(found.z[NAMES.index("rope_stiffness")] * problem.nominal[NAMES.index("rope_stiffness")])
    angle = (free.travel - offset - free.tension / stiffness) / load.arms.sum()
    unit = np.full(len(free.t), free.count**0.5 / problem.sigma)
    return steepest(found.jacobian, found.residual, first, np.asarray(angle), (unit,))


def _times(problem: Problem) -> Array:
    """Time of every row that is data, in the order of the residuals."""
    parts = [problem.motor.t, problem.stop.t, problem.limp.t]
    if problem.load is not None and len(problem.free.t):
        parts.append(problem.free.t)
    return np.concatenate(parts)


def _noise(data: TendonData, stated: float) -> float:
    """Standard deviation of a load-cell sample [N]: from rest and slow stretching, where neighbours differ by noise."""
    quiet = data.tension[data.limp | data.stop]
    quiet = quiet[np.isfinite(quiet)]
    return stated if len(quiet) < 200 else max(float(np.std(np.diff(quiet))) / 2**0.5, 0.1 * stated, 1e-3)
