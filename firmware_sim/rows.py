"""Ropes and rotors as rows of memory that Python reads by name and compiled code in a loop."""

import ctypes
from typing import Any

import numpy as np


class Servo(ctypes.Structure):
    """What the drive regulates, in the hand's sign (positive winds): kp (p - theta) + kd (v - omega) + torque.

    Attributes:
        kp: [N m/rad]. kd: [N m s/rad]. position: [rad]. velocity: [rad/s]. torque: [N m].
        limit: the drive's own limit on the sum [N m].
    """

    _fields_ = [(name, ctypes.c_double) for name in ("kp", "kd", "position", "velocity", "torque", "limit")]
    kp: float
    kd: float
    position: float
    velocity: float
    torque: float
    limit: float

    def release(self) -> None:
        """Command no torque: the motor coasts."""
        self.kp = self.kd = self.position = self.velocity = self.torque = 0.0

    def __eq__(self, other: object) -> bool:
        """Whether both regulate the same."""
        return isinstance(other, Servo) and bytes(self) == bytes(other)

    __hash__ = None  # type: ignore[assignment]


class RotorRow(ctypes.Structure):
    """A rotor with its servo, its ``law``; see ``motor.Motor`` for the state.

    Attributes:
        inertia: [kg m2]. viscous: [N m s/rad]. coulomb: [N m]. gain: torque that appears over the one believed.
        step: [s]. lag, velocity_lag: shares by which current and estimate follow in a step.
        load: torque of the rope [N m]. angle: of the spool as the servo sees it [rad]. command: to the current [N m].
        drag: load and Coulomb friction [N m]. stiff: inertia over step, and the slope of the friction [N m s/rad].
        waits: whether it turns by itself, not with the others.
    """

    _fields_ = [
        *((name, ctypes.c_double) for name in ("theta", "omega", "torque", "velocity", "heat")),
        *((name, ctypes.c_double) for name in ("inertia", "viscous", "coulomb", "gain", "step", "lag", "velocity_lag")),
        *((name, ctypes.c_double) for name in ("load", "angle", "command", "drag", "stiff")),
        ("waits", ctypes.c_int64),
        ("law", Servo),
    ]
    theta: float
    omega: float
    torque: float
    velocity: float
    heat: float
    inertia: float
    viscous: float
    coulomb: float
    gain: float
    step: float
    lag: float
    velocity_lag: float
    load: float
    angle: float
    command: float
    waits: int
    law: Servo


class RopeRow(ctypes.Structure):
    """A rope; see ``tendon.Tendon`` for the state.

    Attributes:
        radius: of the spool [m].
        stiffness, beyond: up to the knee and far beyond it [N/m]. knee: [N]. knee_stretch, knee_width: [m].
        damping: [N s/m]. friction: coefficient. wrap: angle on the way to the first joint [rad].
        motor: row of its rotor. first, end: rows of its joints and arms, ``first`` to before ``end``.
    """

    _fields_ = [
        *((name, ctypes.c_double) for name in ("tension", "speed", "slope", "longer")),
        *((name, ctypes.c_double) for name in ("radius", "stiffness", "beyond", "knee", "knee_stretch", "knee_width")),
        *((name, ctypes.c_double) for name in ("damping", "friction", "wrap")),
        *((name, ctypes.c_int64) for name in ("motor", "first", "end")),
    ]
    tension: float
    speed: float
    slope: float
    longer: float
    radius: float
    stiffness: float
    beyond: float
    knee: float
    knee_stretch: float
    knee_width: float
    damping: float
    friction: float
    wrap: float
    motor: int
    first: int
    end: int


def array_of(memory: Any, structure: type[ctypes.Structure]) -> Any:
    """Return the same memory, of one structure or many, as an array of rows."""
    return np.frombuffer(memory, np.dtype(structure)) if ctypes.sizeof(memory) else np.empty(0, np.dtype(structure))
