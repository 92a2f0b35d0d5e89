"""Known forces along the tendons: what springs and gravity ask, and what friction leaves of a tension."""

from dataclasses import dataclass

import numpy as np

from handctl.controller.filter_design import S, V
from handctl.controller.model import HandModel
from handctl.controller.types import Vector
from handctl.hand.tendons import FRICTION_SPEED


@dataclass(frozen=True, slots=True)
class LoadStatics:
    """Static forces along the tendons, (N,) each.

    Attributes:
        resistance: tension that return springs and gravity balance [N].
        efficiency: share of the load cell's tension that reaches the joints (above 1 when paying out).
        pull: tension at the load cell times its efficiency [N].
    """

    resistance: Vector
    efficiency: Vector
    pull: Vector


def load_statics(model: HandModel, table: Vector, tension: Vector) -> LoadStatics:
    """Evaluate them for a filter state.

    Friction takes its direction from the cable's speed at the spool: the digit's own, a light mass on a spring, is
    estimated so roughly that its sign would chatter.

    Args:
        model: the hand.
        table: (N, 7) filter state.
        tension: (N,) at the load cells [N].
    """
    q = model.excursion_to_joints.dot(table[:, S])
    resistance = model.torque_to_tension.dot(model.all_digits.static_torque(q))
    efficiency = tendon_efficiency(model, q, table[:, V])
    return LoadStatics(resistance, efficiency, tension * efficiency)


def tendon_efficiency(model: HandModel, q: Vector, speed: Vector) -> Vector:
    """Share of each tendon's load-cell tension that acts at its joints, the mean over its pulleys, (N,).

    Args:
        model: the hand.
        q: (J,) joint angles [rad].
        speed: (N,) winding speeds [m/s].

    Source: capstan equation.
    """
    angle = model.wrap[:, None] + np.add.accumulate(model.pulleys * q, axis=1)
    rub = model.friction * np.tanh(speed / FRICTION_SPEED)
    return np.asarray(np.add.reduce(model.pulley_weights * np.exp(-rub[:, None] * angle), axis=1))


def sliding_efficiency(model: HandModel, q: Vector) -> Vector:
    """The same while the rope winds so fast that friction is fully developed, (N,); paying out, about one over it.

    Args:
        model: the hand.
        q: (J,) joint angles [rad].
    """
    angle = model.wrap[:, None] + np.add.accumulate(model.pulleys * q, axis=1)
    return np.asarray(np.add.reduce(model.pulley_weights * np.exp(-model.friction[:, None] * angle), axis=1))
