"""What the law makes of a model and its gains once, instead of every tick."""

import functools
from dataclasses import dataclass

import numpy as np

from handctl.core.model import HandModel
from handctl.core.types import Vector

MOTOR_FRICTION_SPEED = 2.5e-3
"""Cable speed at which motor friction is taken as fully developed [m/s]: 0.5 rad/s at a 5 mm spool."""
UNWIND_SHARE = 0.3
"""Share of the torque limit that may be used to pay out: enough to brake the rotor, little to throw rope off."""


@dataclass(frozen=True, slots=True, eq=False)
class Constants:
    """What the law makes of a model and its gains once, (N,) each.

    Attributes:
        limit, unwind: largest and smallest motor force at the cable [N].
        mass: that the feedback accelerates [kg]. inertia: that the way's acceleration moves [kg].
        rejection: share of the disturbance that is taken off.
        friction, frictionless: share of the capstan's efficiency that counts, and the rest.
        damping, coulomb: of the motor's friction, as far as it is fed forward [N s/m], [N].
        half: speed that a force makes in half a period [m/(N s)]. stopping: scale of speeds that friction stops [m/s].
    """

    limit: Vector
    unwind: Vector
    mass: Vector
    inertia: Vector
    rejection: Vector
    friction: Vector
    frictionless: Vector
    damping: Vector
    coulomb: Vector
    half: Vector
    stopping: Vector


@functools.lru_cache(maxsize=16)
def constants(model: HandModel) -> Constants:
    """The constants of a hand; models are told apart by identity."""
    space, gains = model.space, model.gains.motion
    limit, all_of_it = model.torque_limit / space.spool, np.ones(model.tendon_count)
    half = 0.5 * model.period / space.motor_mass
    return Constants(
        limit=limit,
        unwind=-UNWIND_SHARE * limit,
        mass=space.motor_mass + space.load_mass,
        inertia=gains.inertia_share * space.motor_mass,
        rejection=gains.disturbance_rejection * all_of_it,
        friction=gains.friction_share * all_of_it,
        frictionless=(1.0 - gains.friction_share) * all_of_it,
        damping=gains.friction_share * space.motor_damping,
        coulomb=gains.friction_share * space.coulomb,
        half=half,
        stopping=MOTOR_FRICTION_SPEED + half * space.coulomb,
    )
