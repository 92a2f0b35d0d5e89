"""Joint torque to tendon tension: the bounded least-squares problem of a tendon-driven digit.

minimise |R^T f - tau|^2 / r^2 + regularisation |f - f_bias|^2 subject to f_min <= f <= f_max, with r the mean moment
arm. Where the equations have a solution within the bounds it is taken as it is. If the bounds forbid the torque, the
closest torque is taken, all coordinates weighted alike, and the shortfall is returned. Source: Lee & Tsai (1991).
"""

import numpy as np

from handctl.controller.types import Vector

REGULARISATION = 1e-6
"""Weight of tension [N^2] against torque error as tension; small, so that it decides only among equals."""


def allocate(moment_arms: Vector, torque: Vector, floor: Vector, ceiling: Vector) -> tuple[Vector, Vector]:
    """Tensions that make a torque.

    Args:
        moment_arms: (n_t, n_c) reduced moment arms [m].
        torque: (n_c,) torque in the digit's coordinates [N m].
        floor, ceiling: (n_t,) bounds [N].

    Returns:
        tensions (n_t,) [N] and the torque that is missing (n_c,) [N m].
    """
    tension = _exact(moment_arms, torque)
    if tension is None or (tension < floor).any() or (tension > ceiling).any():
        tension = _bounded(moment_arms, torque, floor, ceiling)
    return tension, torque - moment_arms.T @ tension


def _exact(moment_arms: Vector, torque: Vector) -> Vector | None:
    """The one solution without bounds; None if there are more tendons than coordinates."""
    if moment_arms.shape[0] != moment_arms.shape[1]:
        return None
    if len(torque) == 1:
        return np.asarray(torque / moment_arms[0])
    return np.asarray(np.linalg.solve(moment_arms.T, torque))


def _bounded(moment_arms: Vector, torque: Vector, floor: Vector, ceiling: Vector) -> Vector:
    """The quadratic program, by daqp."""
    from daqp import solve

    arms = moment_arms / np.abs(moment_arms).mean()
    wanted = torque / np.abs(moment_arms).mean()
    weight = np.ascontiguousarray(arms @ arms.T + REGULARISATION * np.eye(len(floor)))
    linear = -(arms @ wanted + REGULARISATION * floor)
    empty = np.zeros((0, len(floor)))
    tension, _, _, _ = solve(weight, linear, empty, ceiling.copy(), floor.copy())
    return np.asarray(np.clip(np.asarray(tension, dtype=np.float64), floor, ceiling))
