"""Joint torque to tendon tension: the bounded least-squares problem of a tendon-driven digit.

minimise |R^T f - tau|^2 / r^2 + regularisation |f - f_bias|^2 subject to f_min <= f <= f_max, with
the mean moment arm r. A solution of the equations within the bounds is used directly. If the bounds
forbid the torque, the closest torque is used, with equal weights of all coordinates, and the
shortfall is returned. Source: Lee & Tsai (1991).
"""

from typing import NamedTuple

import numpy as np

from handctl.core.types import Vector

REGULARISATION = 1e-6
"""Weight of tension [N^2] against torque error as tension. Small: only a choice between equal solutions."""


def tensions_for_torque(moment_arms: Vector, torque: Vector, floor: Vector, ceiling: Vector) -> tuple[Vector, Vector]:
    """Compute the tensions for a torque.

    Args:
        moment_arms: (n_t, n_c) reduced moment arms [m].
        torque: (n_c,) torque in the digit's coordinates [N m].
        floor: (n_t,) smallest tensions [N].
        ceiling: (n_t,) largest tensions [N].

    Returns:
        Tensions (n_t,) [N] and missing torque (n_c,) [N m].
    """
    tension = _unique_solution(moment_arms, torque)
    if tension is None or (tension < floor).any() or (tension > ceiling).any():
        tension = solve_bounded(moment_arms, torque, floor, ceiling, floor if tension is None else tension)
    return tension, torque - moment_arms.T @ tension


def _unique_solution(moment_arms: Vector, torque: Vector) -> Vector | None:
    """Return the unique solution without bounds, None with more tendons than coordinates."""
    if moment_arms.shape[0] != moment_arms.shape[1]:
        return None
    if len(torque) == 1:
        return np.asarray(torque / moment_arms[0])
    return np.asarray(np.linalg.solve(moment_arms.T, torque))


class _Problem(NamedTuple):
    """Constants of a digit's quadratic program: arms over their mean, the mean [m], and the weights."""

    arms: Vector
    mean: float
    weight: Vector
    unconstrained: Vector


_problems: dict[int, tuple[Vector, _Problem]] = {}
MAX_CACHED_PROBLEMS = 64


def _cached_problem(moment_arms: Vector) -> _Problem:
    """Return the program of moment arms, cached by identity, because moment arms are constant."""
    result = _problems.get(id(moment_arms))
    if result is not None and result[0] is moment_arms:
        return result[1]
    if len(_problems) >= MAX_CACHED_PROBLEMS:
        _problems.clear()
    n = len(moment_arms)
    mean = float(np.abs(moment_arms).mean())
    arms = moment_arms / mean
    weight = np.ascontiguousarray(arms @ arms.T + REGULARISATION * np.eye(n))
    problem = _Problem(arms, mean, weight, np.zeros((0, n)))
    if not moment_arms.flags.writeable:
        _problems[id(moment_arms)] = moment_arms, problem
    return problem


def solve_bounded(moment_arms: Vector, torque: Vector, floor: Vector, ceiling: Vector, near: Vector) -> Vector:
    """Solve the quadratic program by daqp: tensions (n_t,) within the bounds, see ``tensions_for_torque``.

    Args:
        moment_arms: see ``tensions_for_torque``.
        torque: see ``tensions_for_torque``.
        floor: see ``tensions_for_torque``.
        ceiling: see ``tensions_for_torque``.
        near: (n_t,) tensions [N], for example the solution without bounds. Tensions out of bounds
            form the solver's first active set. This halves the steps and needs no memory.
    """
    from daqp import solve

    arms, mean, weight, unconstrained = _cached_problem(moment_arms)
    linear = -(arms.dot(torque / mean) + REGULARISATION * floor)
    start = np.minimum(np.maximum(near, floor), ceiling)
    # Copies, because daqp may write into its arguments.
    result = solve(weight.copy(), linear, unconstrained, ceiling.copy(), floor.copy(), primal_start=start)
    return np.minimum(np.maximum(np.asarray(result[0], dtype=np.float64), floor), ceiling)
