"""What ropes, rotors and servos do in a step: the laws of tendons and motors, all in scalars.

Ropes and rotors are rows of an array in compiled laws, objects in a list in plain ones; both have their values by name.

Rope damping and Coulomb-like capstan friction are far too steep for an explicit step of the light links: the engine
takes their slope as a damping of the tendon, implicitly, and what that damping takes now is given back.
"""

import math
from typing import Any

import numpy as np

from firmware_sim.compiled import call, compiled, inner, rows_at
from firmware_sim.plant.rows import RopeRow, RotorRow

CAPSTAN_SPEED = 1e-3
"""Rope speed at which friction is 76 % developed [m/s]. Source: MODEL, section 3, v0."""
COULOMB_SPEED = 0.05
"""Spool speed at which Coulomb friction is 76 % developed [rad/s]; 0.25 mm/s of rope."""
ENCODER_STEP = 2.0 * math.pi / (1 << 14)
"""14 bit at the spool [rad]. Source: MODEL, section 4."""
DIVERGED_RAD_S = 1e5
"""Sum of joint speeds that no hand has [rad/s]."""

DRIVETRAIN = (RopeRow, "counts", "vector", RotorRow)
"""Ropes; joint and moment arm [m] of each pulley, rope by rope; rotors."""


@inner
def _elastic(rope: Any, stretch: float) -> float:
    """Tension of a rope at rest [N] stretched by so much [m]: linear, then softer beyond the knee.

    Source: MODEL, section 3, ``phi``; the softening is a parameter, the paper prints no curve.
    """
    if stretch <= 0.0:
        return 0.0
    x = stretch - rope.knee_stretch
    if x <= 0.0:
        return float(rope.stiffness * stretch)
    width = rope.knee_width
    soft = (rope.stiffness - rope.beyond) * width * (1.0 - math.exp(-x / width))
    return float(rope.knee + rope.beyond * x + soft)


@inner
def _secant(rope: Any, loss: float, tension_angle: float) -> float:
    """Friction over speed [N s/m]; the secant, because the tangent lets friction reverse a light link.

    Args: the rope; loss of tension by friction [N]; tension times angle of wrap [N rad].
    """
    speed = abs(rope.speed)
    if speed < 1e-3 * CAPSTAN_SPEED:
        return float(tension_angle * rope.friction / CAPSTAN_SPEED)
    return float(loss / speed)


@inner
def _at_cell(rope: Any, joints: Any, arms: Any, rotor: Any, q: Any, dq: Any) -> float:
    """Tension at the load cell [N]."""
    stretch, rate = rope.radius * rotor.theta - rope.longer, rope.radius * rotor.omega
    for i in range(rope.first, rope.end):
        stretch -= arms[i] * q[joints[i]]
        rate -= arms[i] * dq[joints[i]]
    if stretch <= 0.0:
        return 0.0
    return max(0.0, float(_elastic(rope, stretch) + rope.damping * rate))


@inner
def _rub(rope: Any, joints: Any, arms: Any, q: Any, torque: Any) -> None:
    """Add the joint torques of a rope under tension to ``torque`` [N m], and note its slope.

    The tension at a pulley is that behind it, its own joint angle's wrap included. Source: MODEL, section 3.
    """
    tension, angle = rope.tension, rope.wrap
    rub, least, most = rope.friction * math.tanh(rope.speed / CAPSTAN_SPEED), tension, tension
    for i in range(rope.first, rope.end):
        angle += q[joints[i]]
        local = tension * math.exp(-rub * angle)
        torque[joints[i]] += arms[i] * local
        if local < least:
            least = local
        elif local > most:
            most = local
    loss = tension - least if tension - least > most - tension else most - tension
    rope.slope = rope.damping + _secant(rope, loss, tension * angle)


@inner
def _pull(rope: Any, joints: Any, arms: Any, rotor: Any, q: Any, dq: Any, torque: Any) -> None:
    """Add the rope's joint torques to ``torque`` [N m]; tension, speed and slope of the rope, load of its rotor."""
    stretch, speed = rope.radius * rotor.theta - rope.longer, 0.0
    for i in range(rope.first, rope.end):
        stretch -= arms[i] * q[joints[i]]
        speed += arms[i] * dq[joints[i]]
    tension = 0.0
    if stretch > 0.0:
        tension = _elastic(rope, stretch) + rope.damping * (rope.radius * rotor.omega - speed)
    rope.speed, rope.slope, rope.tension = speed, 0.0, 0.0
    if tension > 0.0:
        rope.tension = tension
        _rub(rope, joints, arms, q, torque)
    rotor.load = rope.radius * rope.tension


@inner
def _give_back(rope: Any, joints: Any, arms: Any, torque: Any) -> None:
    """Add what the engine's damping of the tendon takes now to ``torque`` [N m]."""
    push = rope.slope * rope.speed
    for i in range(rope.first, rope.end):
        torque[joints[i]] += arms[i] * push


@inner
def encoded(theta: float) -> float:
    """Return the angle of a spool as its encoder shows it [rad]."""
    return math.floor(theta / ENCODER_STEP) * ENCODER_STEP


@inner
def see(rotor: Any) -> None:
    """Measure the angle of the spool."""
    rotor.angle = encoded(rotor.theta)


@inner
def decide(rotor: Any) -> None:
    """The servo's torque [N m] at the velocity that the rotor will have at the end of the step, within its limit."""
    servo, lag, gain = rotor.law, rotor.lag, rotor.gain
    bend = math.tanh(rotor.omega / COULOMB_SPEED)
    slope = rotor.coulomb * (1.0 - bend * bend) / COULOMB_SPEED
    inertia, drag = rotor.inertia / rotor.step + slope, rotor.load + rotor.coulomb * bend
    command, limit = servo.torque, servo.limit
    if servo.kp != 0.0 or servo.kd != 0.0:
        fixed = command + servo.kp * (servo.position - rotor.angle) + servo.kd * servo.velocity
        stiff = servo.kd + rotor.step * servo.kp
        push = inertia * rotor.omega + gain * ((1.0 - lag) * rotor.torque + lag * fixed) - drag
        command = fixed - stiff * push / (inertia + rotor.viscous + gain * lag * stiff)
    if command > limit:
        command = limit
    elif command < -limit:
        command = -limit
    rotor.command, rotor.drag, rotor.stiff = command, drag, inertia


@inner
def turn(rotor: Any) -> None:
    """Let current, rotor and the drive's estimate follow, semi-implicitly."""
    torque = rotor.torque + rotor.lag * (rotor.command - rotor.torque)
    push = rotor.stiff * rotor.omega + rotor.gain * torque - rotor.drag
    omega = push / (rotor.stiff + rotor.viscous)
    rotor.torque, rotor.omega = torque, omega
    rotor.theta += rotor.step * omega
    rotor.velocity += rotor.velocity_lag * (omega - rotor.velocity)
    rotor.heat += rotor.step * torque * torque


@compiled(*DRIVETRAIN, "vector", "vector", "vector")
def tensions(ropes: Any, joints: Any, arms: Any, rotors: Any, q: Any, dq: Any, out: Any) -> None:
    """The tension of each rope at its load cell, now, into ``out`` [N]."""
    for i in range(len(ropes)):
        out[i] = _at_cell(ropes[i], joints, arms, rotors[ropes[i].motor], q, dq)


@compiled(*DRIVETRAIN, "vector", "vector", "vector", "vector", "flag")
def drive(
    ropes: Any, joints: Any, arms: Any, rotors: Any, q: Any, dq: Any, torque: Any, damping: Any, everyone: bool
) -> None:
    """One step without the engine; see ``steps``.

    Args: everyone: whether rotors turn that want to wait, too.
    """
    for i in range(len(torque)):
        torque[i] = 0.0
    for i in range(len(ropes)):
        rope = ropes[i]
        rotor = rotors[rope.motor]
        _pull(rope, joints, arms, rotor, q, dq, torque)
        if everyone or rotor.waits == 0:
            see(rotor)
            decide(rotor)
            turn(rotor)
        _give_back(rope, joints, arms, torque)
        damping[i] = rope.slope


@inner
def _steps(
    count: int, ropes: Any, joints: Any, arms: Any, rotors: Any, q: Any, dq: Any, torque: Any, damping: Any,
    step: int, model: int, data: int,
) -> int:  # fmt: skip
    """Let ropes pull, rotors turn and links move, so many times.

    Args:
        count: of steps. ropes, joints, arms, rotors: the drivetrain.
        q, dq, torque, damping: the engine's own: joint angles and velocities; torques that act on the joints [N m];
            damping of the tendons [N s/m].
        step, model, data: addresses of the engine's step and of its arguments.

    Returns:
        How many steps were made; fewer than asked for if the plant diverged, none if there is a fault in a motor.
    """
    for i in range(len(rotors)):
        if rotors[i].faulty:
            return 0
    for done in range(count):
        speeds = 0.0
        for speed in dq:
            speeds += speed
        if not abs(speeds) < DIVERGED_RAD_S:  # not a number is diverged, too
            return done
        drive(ropes, joints, arms, rotors, q, dq, torque, damping, True)
        call(step, model, data)
    return count


REAL, COUNT, ROPES, ROTORS = np.dtype(np.float64), np.dtype(np.int64), np.dtype(RopeRow), np.dtype(RotorRow)


@compiled("count", "counts")
def steps(count: int, at: Any) -> int:
    """Let ropes pull, rotors turn and links move, so many times; return how many steps were made, see ``_steps``.

    Args: count: of steps. at: address and length of each array of ``_steps``, then its last three arguments.
    """
    return _steps(
        count, rows_at(at[0], at[1], ROPES), rows_at(at[2], at[3], COUNT), rows_at(at[4], at[5], REAL),
        rows_at(at[6], at[7], ROTORS), rows_at(at[8], at[9], REAL), rows_at(at[10], at[11], REAL),
        rows_at(at[12], at[13], REAL), rows_at(at[14], at[15], REAL), at[16], at[17], at[18],
    )  # fmt: skip
