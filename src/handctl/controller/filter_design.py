"""Discrete model and steady-state Kalman gains of the tension filter, once, before arming.

Per tendon the state is [x, v, s, w, d, e, o]: cable travel [m] and speed [m/s] at the spool, excursion [m] and
its rate [m/s], Gauss-Markov disturbance forces on motor and load [N], stretch offset [m]. Inputs: motor force at the
cable [N], known load force [N]. Measurements: encoder travel [m], load cell [N], excursion from joint encoders [m].
Source: linearised tendon plant; van Loan (1978) for the discretisation; the Riccati solution comes from ``control``.
"""

import enum
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from handctl.controller.gains import FilterGains
from handctl.controller.tendon_space import TendonSpace

Matrix = NDArray[np.float64]

STATES, INPUTS, MEASUREMENTS = 7, 2, 3
X, V, S, W, D, E, O = range(STATES)  # noqa: E741 - the states' names in the module's docstring


FORGET_S = 1e4
"""Stretch offset and a held digit's excursion are forgotten this slowly [s]: only so that the Riccati equation has a
solution. What is forgotten within a run pulls the estimate: a millimetre of offset in a minute is 1.7 N a second."""


class Regime(enum.IntEnum):
    """How a tendon's model is coupled."""

    FREE = 0
    """Taut, the digit moves freely."""
    HELD = 1
    """Taut, the digit rests on an object or on its open stop, of unknown stiffness: it moves little, that is all."""
    SLACK = 2
    """No tension: the motor moves alone, springs hold the digit on its open stop, the load cell says nothing."""


@dataclass(frozen=True, slots=True)
class Block:
    """One tendon's filter in one regime.

    Attributes:
        F: transition over one period, (7, 7).
        B: inputs held over one period, (7, 2).
        H: measurements, (3, 7).
        K: steady-state gain of the update, (7, 3).
        tension_row: tension of a state, (7,).
        tension_variance: of the predicted tension [N^2].
        innovation_information: inverse covariance of encoder and load-cell innovations, (2, 2).
    """

    F: Matrix
    B: Matrix
    H: Matrix
    K: Matrix
    tension_row: Matrix
    tension_variance: float
    innovation_information: Matrix


@dataclass(frozen=True, slots=True)
class FilterDesign:
    """Blocks of every tendon and regime; ``blocks[tendon][regime]``.

    Attributes:
        memo: stacks already built, by regimes; contact comes and goes far more rarely than ticks.
    """

    blocks: tuple[tuple[Block, ...], ...]
    memo: dict[tuple[int, ...], "Stacked"] = field(default_factory=dict, compare=False, repr=False)

    def stacked(self, regimes: tuple[int, ...]) -> "Stacked":
        """The N tendons as one filter, each in its regime."""
        found = self.memo.get(regimes)
        if found is None:
            found = self.memo[regimes] = self._stack(regimes)
        return found

    def _stack(self, regimes: tuple[int, ...]) -> "Stacked":
        chosen = [tendon[regime] for tendon, regime in zip(self.blocks, regimes, strict=True)]
        return Stacked(
            F=block_diag(*(block.F for block in chosen)),
            B=block_diag(*(block.B for block in chosen)),
            H=block_diag(*(block.H for block in chosen)),
            K=block_diag(*(block.K for block in chosen)),
            tension=block_diag(*(block.tension_row for block in chosen)),
            sigma=np.sqrt([block.tension_variance for block in chosen]),
            information=tuple(
                np.array([block.innovation_information.flat[at] * times for block in chosen])
                for at, times in ((0, 1.0), (1, 2.0), (3, 1.0))
            ),
            free=np.array(regimes) == Regime.FREE,
            slack=np.array(regimes) == Regime.SLACK,
        )


@dataclass(frozen=True, slots=True)
class Stacked:
    """All tendons as one filter of 7 N states; matrices block diagonal.

    Attributes:
        F: (7N, 7N). B: (7N, 2N). H: (3N, 7N). K: (7N, 3N).
        tension: (N, 7N), tension of a state.
        sigma: (N,), standard deviation of the predicted tension [N].
        information: (N,) each: the innovations' inverse covariance, of encoder squared, both, load cell squared.
        free, slack: (N,) whether a tendon is in this regime.
    """

    F: Matrix
    B: Matrix
    H: Matrix
    K: Matrix
    tension: Matrix
    sigma: Matrix
    information: tuple[Matrix, ...]
    free: NDArray[np.bool_]
    slack: NDArray[np.bool_]


def design_filter(space: TendonSpace, gains: FilterGains, period: float, joint_encoder_noise: Matrix) -> FilterDesign:
    """Design the filter of each tendon in each regime.

    Args:
        space: the hand along its tendons.
        gains: noise intensities assumed.
        period: control period [s].
        joint_encoder_noise: (N,) standard deviation of the excursion measured by joint encoders [m]; inf where there
            are none.
    """
    return FilterDesign(
        tuple(
            tuple(_block(space, i, regime, gains, period, float(joint_encoder_noise[i])) for regime in Regime)
            for i in range(len(space.spool))
        )
    )


def _continuous(space: TendonSpace, i: int, regime: Regime, gains: FilterGains) -> tuple[Matrix, Matrix, Matrix]:
    """A (7, 7), B (7, 2) and the tension row (7,) of one tendon."""
    taut = regime != Regime.SLACK
    k, c = (space.stiffness[i], space.damping[i]) if taut else (0.0, 0.0)
    tension = np.array([k, c, -k, -c, 0.0, 0.0, -k])
    A, B = np.zeros((STATES, STATES)), np.zeros((STATES, INPUTS))
    A[X, V] = A[S, W] = 1.0
    A[V] = -tension / space.motor_mass[i]
    A[V, V] -= space.motor_damping[i] / space.motor_mass[i]
    A[V, D] = B[V, 0] = 1.0 / space.motor_mass[i]
    if regime == Regime.FREE:
        A[W] = tension / space.load_mass[i]
        A[W, S] -= space.load_stiffness[i] / space.load_mass[i]
        A[W, W] -= space.load_damping[i] / space.load_mass[i]
        A[W, E] = B[W, 1] = 1.0 / space.load_mass[i]
    else:
        A[W, W] = -1.0 / gains.held_time_s
        A[S, S] = -1.0 / FORGET_S
    A[D, D] = -1.0 / gains.motor_disturbance_time_s
    A[E, E] = -1.0 / gains.load_disturbance_time_s
    A[O, O] = -1.0 / FORGET_S
    return A, B, tension


def _intensity(space: TendonSpace, i: int, regime: Regime, gains: FilterGains) -> Matrix:
    """Continuous process noise of one tendon, (7, 7): 2 sigma^2 / tau of each Gauss-Markov state, little on speeds."""
    Q = np.zeros(STATES)
    Q[V] = gains.motor_acceleration_noise_N**2 / space.motor_mass[i] ** 2
    Q[W] = gains.load_acceleration_noise_N**2 / space.load_mass[i] ** 2
    if regime != Regime.FREE:
        Q[W] = 2.0 * gains.held_speed_m_s**2 / gains.held_time_s
    Q[D] = 2.0 * gains.motor_disturbance_N**2 / gains.motor_disturbance_time_s
    Q[E] = 2.0 * gains.load_disturbance_N**2 / gains.load_disturbance_time_s
    Q[O] = 2.0 * gains.offset_m**2 / gains.offset_time_s
    return np.diag(Q)


def _discretise(A: Matrix, B: Matrix, Q: Matrix, period: float) -> tuple[Matrix, Matrix, Matrix]:
    """Zero-order hold of A, B and the discrete covariance of continuous noise Q. Source: van Loan (1978)."""
    n, m = B.shape
    held = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * period)
    loan = expm(np.block([[-A, Q], [np.zeros((n, n)), A.T]]) * period)
    F = held[:n, :n]
    noise = loan[n:, n:].T @ loan[:n, n:]
    return F, held[:n, n:], (noise + noise.T) / 2


def _block(space: TendonSpace, i: int, regime: Regime, gains: FilterGains, period: float, joint_noise: float) -> Block:
    A, B, tension = _continuous(space, i, regime, gains)
    F, held, Q = _discretise(A, B, _intensity(space, i, regime, gains), period)
    H = np.zeros((MEASUREMENTS, STATES))
    H[0, X] = 1.0
    H[1] = tension
    H[2, S] = 1.0
    noise = np.array([space.encoder_step[i] * gains.encoder_noise_counts, space.tension_noise[i], joint_noise])
    seen = np.isfinite(noise) & np.any(H != 0.0, axis=1)
    K = np.zeros((STATES, MEASUREMENTS))
    P = _riccati(F, H[seen], Q, np.diag(noise[seen] ** 2))
    innovation = H[seen] @ P @ H[seen].T + np.diag(noise[seen] ** 2)
    K[:, seen] = np.linalg.solve(innovation, H[seen] @ P).T
    both = np.zeros((2, 2))
    measured = np.flatnonzero(seen[:2])
    both[np.ix_(measured, measured)] = np.linalg.inv(innovation[: len(measured), : len(measured)])
    return Block(F, held, H, K, tension, float(tension @ P @ tension), both)


def _riccati(F: Matrix, H: Matrix, Q: Matrix, R: Matrix) -> Matrix:
    """Covariance of the prediction in steady state, solved in units in which the states are of the order of one."""
    from control import dlqe

    scale = np.array([1e-5, 1e-2, 1e-5, 1e-2, 1.0, 1.0, 1e-5])
    rows = 1.0 / np.sqrt(np.diag(R))
    _, P, _ = dlqe(
        F * scale / scale[:, None],
        np.eye(STATES),
        H * scale * rows[:, None],
        Q / np.outer(scale, scale),
        np.eye(len(rows)),
        method="scipy",
    )
    return np.asarray(P) * np.outer(scale, scale)
