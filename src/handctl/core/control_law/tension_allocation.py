"""Conversion of joint torques to tendon tensions, by a bounded least-squares problem per digit.

The least-squares problem is: minimise |R^T f - tau|^2 / r^2 + regularisation |f - f_min|^2 subject
to f_min <= f <= f_max. Here r is the mean moment arm. If the equations R^T f = tau have a unique
solution, and the solution is within the bounds, the result is this solution. If no tensions within
the bounds make the required torque, the result is the tensions whose torque is closest to the
required torque. The torque errors of all coordinates have equal weights. ``tensions_for_torque``
returns the tensions, and the part of the required torque that these tensions do not make. Source:
Lee & Tsai (1991).
"""

from typing import NamedTuple

import numpy as np
from daqp import solve

from handctl.core.tick_types import Vector

REGULARISATION_WEIGHT = 1e-6
"""Weight of squared tension against squared torque error, both in newtons.

The weight is so small that it only selects one of several solutions with equal torque.
"""


def tensions_for_torque(
    moment_arms: Vector, torque: Vector, floor: Vector, ceiling: Vector
) -> tuple[Vector, Vector]:
    """Return the tensions of a digit for a required torque, and the part of the torque that these tensions do not make.

    Args:
        moment_arms: (n_t, n_c) reduced moment arms [m].
        torque: (n_c,) required torque in the digit's coordinates [N m].
        floor: (n_t,) smallest allowed tensions [N].
        ceiling: (n_t,) largest allowed tensions [N].

    Returns:
        The tensions (n_t,) [N], and the part of the torque that the tensions cannot make (n_c,) [N
        m].
    """
    tension = _unique_solution(moment_arms, torque)
    if tension is None or (tension < floor).any() or (tension > ceiling).any():
        tension = solve_bounded_tensions(
            moment_arms, torque, floor, ceiling, floor if tension is None else tension
        )
    return tension, torque - moment_arms.T @ tension


def _unique_solution(moment_arms: Vector, torque: Vector) -> Vector | None:
    """Return the solution of the least-squares problem without bounds, if the solution is unique.

    Return None if the digit has more tendons than coordinates.
    """
    if moment_arms.shape[0] != moment_arms.shape[1]:
        return None
    if len(torque) == 1:
        return np.asarray(torque / moment_arms[0])
    return np.asarray(np.linalg.solve(moment_arms.T, torque))


class _AllocationProblem(NamedTuple):
    """Constants of a digit's quadratic program.

    Attributes:
        arms: (n_t, n_c) moment arms divided by their mean.
        mean: mean of the moment arms [m].
        weight: (n_t, n_t) matrix of the quadratic form.
        empty_constraints: (0, n_t) matrix without rows, because the quadratic program has no linear
            constraints.
    """

    arms: Vector
    mean: float
    weight: Vector
    empty_constraints: Vector


_cached_problems: dict[int, tuple[Vector, _AllocationProblem]] = {}
MAX_CACHED_ALLOCATIONS = 64
"""Largest number of quadratic programs in the cache."""


def _cached_allocation_problem(moment_arms: Vector) -> _AllocationProblem:
    """Return the quadratic program for given moment arms.

    If the array of moment arms is read-only, the quadratic program is cached for later calls with
    the same array.
    """
    result = _cached_problems.get(id(moment_arms))
    if result is not None and result[0] is moment_arms:
        return result[1]
    if len(_cached_problems) >= MAX_CACHED_ALLOCATIONS:
        _cached_problems.clear()
    n = len(moment_arms)
    mean = float(np.abs(moment_arms).mean())
    arms = moment_arms / mean
    weight = np.ascontiguousarray(arms @ arms.T + REGULARISATION_WEIGHT * np.eye(n))
    problem = _AllocationProblem(arms, mean, weight, np.zeros((0, n)))
    if not moment_arms.flags.writeable:
        _cached_problems[id(moment_arms)] = moment_arms, problem
    return problem


def solve_bounded_tensions(
    moment_arms: Vector, torque: Vector, floor: Vector, ceiling: Vector, preferred_tension: Vector
) -> Vector:
    """Solve the quadratic program by the solver daqp, and return the tensions (n_t,) within the bounds.

    Args:
        moment_arms: see ``tensions_for_torque``.
        torque: see ``tensions_for_torque``.
        floor: see ``tensions_for_torque``.
        ceiling: see ``tensions_for_torque``.
        preferred_tension: (n_t,) start tensions [N], for example the solution without bounds. The
            bounds that the start tensions violate are the first active set of the solver. A good
            first active set halves the number of steps of the solver.
    """
    arms, mean, weight, empty_constraints = _cached_allocation_problem(moment_arms)
    gradient_at_zero = -(arms.dot(torque / mean) + REGULARISATION_WEIGHT * floor)
    start = np.minimum(np.maximum(preferred_tension, floor), ceiling)
    # The bounds and the weights are copied, because daqp can change the arrays in its arguments.
    result = solve(
        weight.copy(),
        gradient_at_zero,
        empty_constraints,
        ceiling.copy(),
        floor.copy(),
        primal_start=start,
    )
    return np.minimum(np.maximum(np.asarray(result[0], dtype=np.float64), floor), ceiling)
