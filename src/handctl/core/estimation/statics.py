"""Known forces along the tendons: what springs and gravity ask, and what friction leaves of a tension.

All that is linear in the filter's state comes from one product with it; what a tick pays for is the number of arrays.
"""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from handctl.choose import chosen
from handctl.core.estimation.filter_stack import STATES, S, V
from handctl.core.model import HandModel
from handctl.core.types import Vector
from handctl.hand.tendons import ROPE_FRICTION_SPEED


class LoadStatics(NamedTuple):
    """Static forces along the tendons, (N,) each.

    Attributes:
        resistance: tension that return springs and gravity balance [N].
        pull: tensions at the joints that make the torques of those at the load cells, friction taken off [N].
        eager: the same by the cable's speed alone, which is the first to tell that a digit leaves a stop [N].
    """

    resistance: Vector
    pull: Vector
    eager: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Readout:
    """Constants that make statics of a state; L links, P pulleys at most on a tendon.

    Gravity turns with a link's angle: w_x sin - w_y cos is one sine of the angle less a phase.

    Attributes:
        rows: (L + N + P N, 7 N) link angles, spring tensions [N] and wrapped angles, from the state.
        offsets: what is added to them.
        links, springs, wraps: where they are.
        weight: (N, L) tension of each sine [N].
        path: (P N, J) joint angles that a tendon has wrapped at its first, second .. pulley. wrap: (P N,) [rad].
        friction: (N,) capstan coefficient, negative. frictions: (P N,) the same.
        shares: (N, P N) of each pulley in a tendon's moment arms.
        pulls: (N, P N) tensions at the joints that make the torque of a tension at each pulley.
    """

    rows: Vector
    offsets: Vector
    links: slice
    springs: slice
    wraps: slice
    weight: Vector
    path: Vector
    wrap: Vector
    friction: Vector
    frictions: Vector
    shares: Vector
    pulls: Vector

    def passed(self, wrapped: Vector, developed: Vector) -> Vector:
        """(P, N) share of the load cell's tension at each pulley.

        Args:
            wrapped: (P N,) angles [rad]. developed: (N,) how far friction is, 1 winding, -1 paying out.
        """
        rub = self.friction * developed
        return np.asarray(np.exp(wrapped.reshape(-1, len(rub)) * rub))


@functools.lru_cache(maxsize=16)
def readout(model: HandModel) -> Readout:
    """The constants of a hand."""
    digits, arms, n = model.all_digits, model.torque_to_tension, model.tendon_count
    path, shares, pulls = _pulleys(model)
    links, steps = len(digits.spring), np.arange(n) * STATES + S
    joints = np.zeros((links, n * STATES))
    joints[:, steps] = model.excursion_to_joints
    phase = np.arctan2(digits.weight_y, digits.weight_x)
    wrap = np.tile(model.wrap, len(path) // n)
    return Readout(
        rows=np.concatenate((digits.inward @ joints, arms * digits.spring @ joints, path @ joints)),
        offsets=np.concatenate((-phase, arms @ (digits.spring * digits.preload), wrap)),
        links=slice(links),
        springs=slice(links, links + n),
        wraps=slice(links + n, None),
        weight=arms @ digits.inward.T * np.hypot(digits.weight_x, digits.weight_y),
        path=path,
        wrap=wrap,
        friction=-model.friction,
        frictions=np.tile(-model.friction, len(path) // n),
        shares=shares,
        pulls=pulls,
    )


def _pulleys(model: HandModel) -> tuple[Vector, Vector, Vector]:
    """(P N, J) joints up to each pulley, and (N, P N) its shares; 0 for the pulleys that a tendon does not have."""
    n, joints = model.pulleys.shape
    most = int(model.pulleys.sum(axis=1).max())
    path, shares, pulls = np.zeros((most, n, joints)), np.zeros((n, most, n)), np.zeros((n, most, n))
    for tendon in range(n):
        for place, joint in enumerate(np.flatnonzero(model.pulleys[tendon])):
            path[place:, tendon, joint] = 1.0
            shares[tendon, place, tendon] = model.pulley_weights[tendon, joint]
            pulls[:, place, tendon] = model.torque_to_tension[:, joint] * model.hand.moment_arms[tendon, joint]
    return path.reshape(-1, joints), shares.reshape(n, -1), pulls.reshape(n, -1)


def load_statics(model: HandModel, table: Vector, tension: Vector, friction_state: Vector | None = None) -> LoadStatics:
    """Evaluate them for a filter state.

    Where nothing better is known, friction takes its direction from the cable's speed at the spool: the digit's own, a
    light mass on a spring, is estimated so roughly that its sign would chatter.

    Args:
        model: the hand.
        table: (N, 7) filter state.
        tension: (N,) at the load cells [N].
        friction_state: (N,) how far friction is developed where that is known, 1 winding, -1 paying out; NaN elsewhere.
    """
    known = readout(model)
    found = known.rows.dot(table.reshape(-1)) + known.offsets
    resistance = known.weight.dot(np.sin(found[known.links])) + found[known.springs]
    developed = np.tanh(table[:, V] / ROPE_FRICTION_SPEED)
    eager = pull = known.pulls.dot((known.passed(found[known.wraps], developed) * tension).reshape(-1))
    if friction_state is not None:
        developed = chosen(np.isnan(friction_state), developed, friction_state)
        pull = known.pulls.dot((known.passed(found[known.wraps], developed) * tension).reshape(-1))
    return LoadStatics(resistance, pull, eager)


def tendon_efficiency(model: HandModel, q: Vector, speed: Vector) -> Vector:
    """Share of each tendon's load-cell tension that acts at its joints, the mean over its pulleys, (N,).

    Args:
        model: the hand.
        q: (J,) joint angles [rad].
        speed: (N,) winding speeds [m/s].

    Source: capstan equation.
    """
    known = readout(model)
    passed = known.passed(known.path.dot(q) + known.wrap, np.tanh(speed / ROPE_FRICTION_SPEED))
    return np.asarray(known.shares.dot(passed.reshape(-1)))


def winding_efficiency(model: HandModel, q: Vector) -> Vector:
    """The same while the rope winds so fast that friction is fully developed, (N,); paying out, about one over it.

    Args:
        model: the hand.
        q: (J,) joint angles [rad].
    """
    known = readout(model)
    wrapped = known.path.dot(q) + known.wrap
    return np.asarray(known.shares.dot(np.exp(wrapped * known.frictions)))
