"""Kernels that advance tendons, rotors and servos by a step, in scalar arithmetic.

In compiled kernels, tendons and rotors are the rows of an array. In interpreted Python, tendons and
rotors are objects in a list. A row of an array and an object have attributes of the same names, so
each kernel works with rows and with objects.

The damping force of a tendon and the Coulomb-like capstan friction rise steeply with the speed of
the tendon. The links are light, so an explicit integration step would be unstable. Therefore the
rigid-body engine integrates both forces implicitly. The kernels compute the derivative of damping
force and capstan friction with respect to the tendon speed. The engine uses this slope as a damping
coefficient of the tendon. The kernels compensate the joint torque that the damping coefficient of
the tendon causes, so that only the exact friction remains.
"""

import math
from typing import Any

import numpy as np

from firmware_sim.compiled import array_at, call_c_function, compiled, kernel_helper
from firmware_sim.plant.plant_structs import RotorStruct, TendonStruct

CAPSTAN_SPEED_M_PER_S = 1e-3
"""Tendon speed at which capstan friction reaches 76 % of its final value [m/s].

Source: MODEL, section 3, v0.
"""
COULOMB_SPEED_RAD_PER_S = 0.05
"""Spool speed at which Coulomb friction reaches 76 % of its final value [rad/s].

At a spool speed of 0.05 rad/s, the tendon moves at 0.25 mm/s.
"""
ENCODER_STEP_RAD = 2.0 * math.pi / (1 << 14)
"""Resolution of the encoder [rad]: 14 bits for one turn of the spool. Source: MODEL, section 4."""
DIVERGENCE_SPEED_RAD_S = 1e5
"""Sum of joint speeds above which the plant counts as diverged [rad/s]."""

PRISMATIC_FLAG_INDEX = 10
"""Index of the prismatic flag among the parameters of a pulley.

The flag is 1 at a prismatic joint. See ``tendon.PRISMATIC_FLAG_INDEX``.
"""
PARAMETERS_PER_PULLEY = 11
"""Number of array elements of ``arms`` for each pulley, see ``tendon.PARAMETERS_PER_PULLEY``."""

DRIVETRAIN_ARGUMENT_TYPES = (TendonStruct, "counts", "vector", RotorStruct)
"""Types of the kernel arguments: tendons, joint index of each pulley, numbers of each pulley, rotors."""


@kernel_helper
def _moment_arm_at(arms: Any, i: int, q: float) -> float:
    """Return the moment arm [m] of pulley i at the joint angle q [rad]."""
    at = PARAMETERS_PER_PULLEY * i
    if arms[at + 1] == 0.0:
        return float(arms[at])
    angle = min(max(q, arms[at + 2]), arms[at + 3])
    arm = 0.0
    power = 1.0
    for k in range(4, PRISMATIC_FLAG_INDEX):
        arm += arms[at + k] * power
        power *= angle
    return float(arm)


@kernel_helper
def _wrapped_tendon_length(arms: Any, i: int, q: float) -> float:
    """Return the tendon length [m] that pulley i takes up while the joint turns from 0 to the angle q [rad]."""
    at = PARAMETERS_PER_PULLEY * i
    if arms[at + 1] == 0.0:
        return float(arms[at] * q)
    angle = min(max(q, arms[at + 2]), arms[at + 3])
    length = 0.0
    power = angle
    for k in range(4, PRISMATIC_FLAG_INDEX):
        length += arms[at + k] * power / (k - 3.0)
        power *= angle
    # At joint angles beyond the limits, the moment arm is constant.
    return float(length + _moment_arm_at(arms, i, q) * (q - angle))


@kernel_helper
def _elastic_tension(tendon: Any, stretch: float) -> float:
    """Compute the elastic tension [N] of a tendon at a stretch [m].

    Above the stretch at the knee of the tension-stretch curve, the tendon is softer.

    Source: MODEL, section 3, ``phi``. The stiffness above the knee is a parameter, because the
    paper prints no curve.
    """
    if stretch <= 0.0:
        return 0.0
    x = stretch - tendon.knee_stretch
    if x <= 0.0:
        return float(tendon.stiffness * stretch)
    width = tendon.knee_width
    knee_tension = (tendon.stiffness - tendon.after_knee) * width * (1.0 - math.exp(-x / width))
    return float(tendon.knee + tendon.after_knee * x + knee_tension)


@kernel_helper
def _friction_per_speed(tendon: Any, tension_loss: float, tension_times_angle: float) -> float:
    """Compute the friction force on a tendon divided by the speed of the tendon [N s/m].

    The kernel uses the quotient of force and speed (the secant of the friction curve) instead of
    the derivative (the tangent). A friction force computed with the tangent would reverse the motion
    of a light link.

    Args:
        tendon: the tendon, with its present speed.
        tension_loss: loss of tension that friction causes [N].
        tension_times_angle: tension of the tendon times its wrap angle [N rad].
    """
    speed = abs(tendon.speed)
    # When the tendon is almost at rest, the quotient of force and speed would be 0/0. The kernel
    # then returns the limit of the quotient.
    if speed < 1e-3 * CAPSTAN_SPEED_M_PER_S:
        return float(tension_times_angle * tendon.friction / CAPSTAN_SPEED_M_PER_S)
    return float(tension_loss / speed)


@kernel_helper
def _cell_tension(tendon: Any, joints: Any, arms: Any, rotor: Any, q: Any, dq: Any) -> float:
    """Compute the tension of a tendon at the load cell of the tendon [N]."""
    stretch = tendon.radius * rotor.theta - tendon.extra_length
    rate = tendon.radius * rotor.omega
    for i in range(tendon.first, tendon.end):
        stretch -= _wrapped_tendon_length(arms, i, q[joints[i]])
        rate -= _moment_arm_at(arms, i, q[joints[i]]) * dq[joints[i]]
    if stretch <= 0.0:
        return 0.0
    return max(0.0, float(_elastic_tension(tendon, stretch) + tendon.damping * rate))


@kernel_helper
def _add_friction(tendon: Any, joints: Any, arms: Any, q: Any, torque: Any) -> None:
    """Add the joint torques of a taut tendon to ``torque`` [N m].

    The kernel also sets ``tendon.slope``: the damping, plus the friction force divided by the
    tendon speed [N s/m].

    Friction at a pulley changes the tension of the tendon between the pulley and the distal end of
    the tendon. The wrap angle at a pulley includes the wrap of all pulleys nearer to the spool.
    Source: MODEL, section 3.
    """
    tension = tendon.tension
    angle = tendon.wrap
    rate = tendon.friction * math.tanh(tendon.speed / CAPSTAN_SPEED_M_PER_S)
    min_tension = tension
    max_tension = tension
    for i in range(tendon.first, tendon.end):
        # At a prismatic joint, the tendon does not bend.
        if arms[PARAMETERS_PER_PULLEY * i + PRISMATIC_FLAG_INDEX] == 0.0:
            angle += q[joints[i]]
        # The lines below compute the capstan equation. If the tendon speed is positive, the tendon
        # moves towards the spool, and friction reduces the tension beyond the pulley.
        local_tension = tension * math.exp(-rate * angle)
        torque[joints[i]] += _moment_arm_at(arms, i, q[joints[i]]) * local_tension
        if local_tension < min_tension:
            min_tension = local_tension
        elif local_tension > max_tension:
            max_tension = local_tension
    max_tension_change = (
        tension - min_tension
        if tension - min_tension > max_tension - tension
        else max_tension - tension
    )
    tendon.slope = tendon.damping + _friction_per_speed(tendon, max_tension_change, tension * angle)


@kernel_helper
def _add_tendon_torques(
    tendon: Any, joints: Any, arms: Any, rotor: Any, q: Any, dq: Any, torque: Any
) -> None:
    """Add the joint torques of a tendon to ``torque`` [N m].

    The kernel also sets the tension, the speed and the slope of the tendon, and adds the torque of
    the tendon to the load of the rotor.
    """
    stretch = tendon.radius * rotor.theta - tendon.extra_length
    speed = 0.0
    for i in range(tendon.first, tendon.end):
        stretch -= _wrapped_tendon_length(arms, i, q[joints[i]])
        # The stretch of a tendon is the travel at the spool minus the excursions at the joints. A
        # positive spool angle winds the tendon up, and a positive joint angle closes the digit.
        speed += _moment_arm_at(arms, i, q[joints[i]]) * dq[joints[i]]
    tension = 0.0
    if stretch > 0.0:
        tension = _elastic_tension(tendon, stretch) + tendon.damping * (
            tendon.radius * rotor.omega - speed
        )
    tendon.speed = speed
    tendon.slope = 0.0
    tendon.tension = 0.0
    if tension > 0.0:
        tendon.tension = tension
        _add_friction(tendon, joints, arms, q, torque)
    rotor.load += tendon.radius * tendon.tension


@kernel_helper
def _compensate_damping(tendon: Any, joints: Any, arms: Any, dq: Any, torque: Any) -> None:
    """Compensate the damping torque of a tendon, which MuJoCo will subtract from ``torque`` [N m].

    In its next step, MuJoCo subtracts a damping torque for the tendon. This function adds the same
    torque beforehand, so that both cancel out. MuJoCo and this function both compute the damping
    torque with the mean moment arms.
    """
    speed = 0.0
    for i in range(tendon.first, tendon.end):
        speed += arms[PARAMETERS_PER_PULLEY * i] * dq[joints[i]]
    damping_force = tendon.slope * speed
    for i in range(tendon.first, tendon.end):
        torque[joints[i]] += arms[PARAMETERS_PER_PULLEY * i] * damping_force


@kernel_helper
def encoder_angle(theta: float) -> float:
    """Return a spool angle, rounded down to the resolution of the encoder [rad]."""
    return math.floor(theta / ENCODER_STEP_RAD) * ENCODER_STEP_RAD


@kernel_helper
def measure_angle(rotor: Any) -> None:
    """Measure the spool angle with the encoder."""
    rotor.angle = encoder_angle(rotor.theta)


@kernel_helper
def limit_torque_by_speed(
    rotor: Any,
    command: float,
    inertia: float,
    drag_torque: float,
    speed: float,
    slope: float,
    is_braking: bool,
) -> float:
    """Limit a torque command to a range that shifts with the rotor velocity omega [N m].

    The upper limit is slope * (speed - omega), and the lower limit is slope * (-speed - omega). The
    velocity omega is the velocity of the rotor at the end of the step, as in ``compute_command``.

    Args:
        rotor: rotor whose torque is limited.
        command: torque command [N m].
        inertia: inertia of the rotor divided by the step, plus the slope of the friction [N m
            s/rad].
        drag_torque: load of the rotor plus Coulomb friction [N m].
        speed: speed at which the limit is zero [rad/s].
        slope: decrease of the torque limit with the speed [N m s/rad].
        is_braking: True if the limit brakes a rotor above ``speed``, False if such a rotor turns
            freely.
    """
    sign = 1.0 if rotor.gain > 0.0 else -1.0
    mass = inertia + rotor.viscous
    push = inertia * rotor.omega + rotor.gain * (1.0 - rotor.lag) * rotor.torque - drag_torque
    # The lines below solve limit = slope (+-speed - omega), where omega = (push + gain lag limit) /
    # mass.
    scale = mass + slope * abs(rotor.gain) * rotor.lag
    max_torque = (slope * speed * mass - sign * slope * push) / scale
    min_torque = (-slope * speed * mass - sign * slope * push) / scale
    if not is_braking:
        max_torque = max(max_torque, 0.0)
        min_torque = min(min_torque, 0.0)
    return float(min(max_torque, max(min_torque, command)))


@kernel_helper
def compute_command(rotor: Any) -> None:
    """Compute the limited torque command of the servo from the velocity at the end of the step [N m].

    The control loop of a real drive runs at 10 to 20 kHz. The simulation uses the velocity of the
    rotor at the end of the step. So all gains that are stable in the drive are also stable in the
    simulation. If a drive moves its position setpoint itself, the kernel first moves the setpoint
    to its value at the end of the step.
    """
    servo = rotor.own_servo
    current_lag = rotor.lag
    gain = rotor.gain
    smoothed_sign = math.tanh(rotor.omega / COULOMB_SPEED_RAD_PER_S)
    # The slope is the derivative of the smoothed Coulomb friction. The implicit step contains the
    # slope of the friction.
    slope = rotor.coulomb * (1.0 - smoothed_sign * smoothed_sign) / COULOMB_SPEED_RAD_PER_S
    inertia = rotor.inertia / rotor.step + slope
    drag = rotor.load + rotor.coulomb * smoothed_sign
    command = servo.torque
    limit = servo.limit
    if servo.target_speed != 0.0:
        servo.position += rotor.step * servo.target_speed
    if servo.kp != 0.0 or servo.kd != 0.0:
        # The torque command at the end of the step is the sum of a fixed torque and a torque that
        # depends on the new velocity.
        command_at_rest = (
            command + servo.kp * (servo.position - rotor.angle) + servo.kd * servo.velocity
        )
        impedance = servo.kd + rotor.step * servo.kp
        push = (
            inertia * rotor.omega
            + gain * ((1.0 - current_lag) * rotor.torque + current_lag * command_at_rest)
            - drag
        )
        command = command_at_rest - impedance * push / (
            inertia + rotor.viscous + gain * current_lag * impedance
        )
    if command > limit:
        command = limit
    elif command < -limit:
        command = -limit
    if servo.speed_gain > 0.0:
        command = limit_torque_by_speed(
            rotor, command, inertia, drag, servo.speed_limit, servo.speed_gain, True
        )
    if rotor.top_speed > 0.0:
        # The back-EMF reduces the voltage that drives the current. The remaining voltage falls
        # linearly with the speed, and is zero at the no-load speed.
        slope = rotor.stall_torque / rotor.top_speed
        command = limit_torque_by_speed(
            rotor, command, inertia, drag, rotor.top_speed, slope, False
        )
    rotor.command = command
    rotor.drag = drag
    rotor.impedance = inertia


@kernel_helper
def integrate_motor(rotor: Any) -> None:
    """Integrate the torque, the rotor and the velocity estimate of a motor over one step (semi-implicit Euler)."""
    torque = rotor.torque + rotor.lag * (rotor.command - rotor.torque)
    push = rotor.impedance * rotor.omega + rotor.gain * torque - rotor.drag
    omega = push / (rotor.impedance + rotor.viscous)
    # The rotor angle is integrated last, because it is computed from the new velocity
    # (semi-implicit Euler).
    rotor.torque = torque
    rotor.omega = omega
    rotor.theta += rotor.step * omega
    rotor.velocity += rotor.velocity_lag * (omega - rotor.velocity)
    rotor.heat += rotor.step * torque * torque


@compiled(*DRIVETRAIN_ARGUMENT_TYPES, "vector", "vector", "vector")
def tensions(
    tendons: Any, joints: Any, arms: Any, rotors: Any, q: Any, dq: Any, tension: Any
) -> None:
    """Fill ``tension`` with the present tension of each tendon at its load cell [N].

    Args:
        tendons: tendons of the hand.
        joints: joint index of each pulley.
        arms: parameters of each pulley, see ``tendon.PARAMETERS_PER_PULLEY``.
        rotors: rotors of the motors.
        q: joint angles [rad].
        dq: joint velocities [rad/s].
        tension: tension of each tendon, written by the kernel, shape (tendons,) [N].
    """
    for i in range(len(tendons)):
        tension[i] = _cell_tension(tendons[i], joints, arms, rotors[tendons[i].motor], q, dq)


@compiled(*DRIVETRAIN_ARGUMENT_TYPES, "vector", "vector", "vector", "vector", "flag")
def step_drivetrain(
    tendons: Any,
    joints: Any,
    arms: Any,
    rotors: Any,
    q: Any,
    dq: Any,
    torque: Any,
    damping: Any,
    all_rotors: bool,
) -> None:
    """Compute one step of the tendons and the rotors.

    MuJoCo computes the links, but not the tendons and the rotors. The kernel ``_integrate_steps``
    describes the whole step.

    Args:
        tendons: tendons of the hand.
        joints: joint index of each pulley.
        arms: parameters of each pulley, see ``tendon.PARAMETERS_PER_PULLEY``.
        rotors: rotors of the motors.
        q: joint angles [rad].
        dq: joint velocities [rad/s].
        torque: joint torques, written by the kernel [N m].
        damping: damping of each tendon, written by the kernel [N s/m].
        all_rotors: True to step all rotors. False to step only the rotors whose attribute
            ``steps_alone`` is not set.
    """
    for i in range(len(torque)):
        torque[i] = 0.0
    for i in range(len(rotors)):
        rotors[i].load = 0.0
    for i in range(len(tendons)):
        tendon = tendons[i]
        # The two antagonistic tendons of a spool pair pull in opposite directions on one spool. The
        # loads of the two tendons of a pair therefore have opposite signs.
        _add_tendon_torques(tendon, joints, arms, rotors[tendon.motor], q, dq, torque)
        _compensate_damping(tendon, joints, arms, dq, torque)
        damping[i] = tendon.slope
    for i in range(len(rotors)):
        rotor = rotors[i]
        if all_rotors or rotor.steps_alone == 0:
            measure_angle(rotor)
            compute_command(rotor)
            integrate_motor(rotor)


@kernel_helper
def _integrate_steps(
    count: int, tendons: Any, joints: Any, arms: Any, rotors: Any, q: Any, dq: Any, torque: Any, damping: Any,
    step: int, model: int, data: int,
) -> int:  # fmt: skip
    """Integrate tendons, rotors and links over a number of time steps.

    Args:
        count: number of steps.
        tendons: tendons of the hand.
        joints: joint index of each pulley.
        arms: parameters of each pulley, see ``tendon.PARAMETERS_PER_PULLEY``.
        rotors: rotors of the motors.
        q: joint angles in the memory of MuJoCo [rad].
        dq: joint velocities in the memory of MuJoCo [rad/s].
        torque: joint torques in the memory of MuJoCo [N m].
        damping: damping of the tendons in the memory of MuJoCo [N s/m].
        step: address of MuJoCo's step function.
        model: address of the first argument of the step function.
        data: address of the second argument of the step function.

    Returns:
        Number of completed steps. The number of steps is less than ``count`` if the simulation has
        diverged, and 0 if a motor has a fault.
    """
    for i in range(len(rotors)):
        if rotors[i].faulty:
            return 0
    for step_index in range(count):
        speeds = 0.0
        for speed in dq:
            speeds += speed
        # The condition is written in this form so that it is true if the sum of the speeds is NaN.
        if not abs(speeds) < DIVERGENCE_SPEED_RAD_S:
            return step_index
        step_drivetrain(tendons, joints, arms, rotors, q, dq, torque, damping, True)
        # MuJoCo's function mj_step reads and writes the arrays q, dq, torque and damping in place.
        call_c_function(step, model, data)
    return count


REAL_DTYPE = np.dtype(np.float64)
COUNT_DTYPE = np.dtype(np.int64)
TENDON_DTYPE = np.dtype(TendonStruct)
ROTOR_DTYPE = np.dtype(RotorStruct)
"""This constant and the three above are dtypes of arrays that ``steps`` makes from addresses."""


@compiled("count", "counts")
def steps(count: int, at: Any) -> int:
    """Integrate tendons, rotors and links over a number of time steps.

    The caller gives the arrays by their memory addresses.

    The kernel ``_integrate_steps`` describes the step.

    Args:
        count: number of steps.
        at: address and length of each array of ``_integrate_steps`` in their order, then the last three
            arguments of ``_integrate_steps``.

    Returns:
        Number of completed steps.
    """
    return _integrate_steps(
        count, array_at(at[0], at[1], TENDON_DTYPE), array_at(at[2], at[3], COUNT_DTYPE),
        array_at(at[4], at[5], REAL_DTYPE),
        array_at(at[6], at[7], ROTOR_DTYPE), array_at(at[8], at[9], REAL_DTYPE), array_at(at[10], at[11], REAL_DTYPE),
        array_at(at[12], at[13], REAL_DTYPE), array_at(at[14], at[15], REAL_DTYPE), at[16], at[17], at[18],
    )  # fmt: skip
