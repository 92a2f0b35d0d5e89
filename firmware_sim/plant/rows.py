"""Ropes and rotors as rows of memory, for compiled laws; plain ones take any object with the same attributes."""

import ctypes
from dataclasses import dataclass


@dataclass
class Servo:
    """What the drive regulates, in the hand's sign (positive winds): kp (p - theta) + kd (v - omega) + torque.

    Attributes:
        kp: [N m/rad]. kd: [N m s/rad]. position: [rad]. velocity: [rad/s]. torque: [N m].
        limit: the drive's own limit on the sum [N m].
    """

    kp: float = 0.0
    kd: float = 0.0
    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0
    limit: float = 0.0

    def release(self) -> None:
        """Command no torque: the motor coasts."""
        self.kp = self.kd = self.position = self.velocity = self.torque = 0.0


class ServoRow(ctypes.Structure, Servo):
    """A servo in a row of a rotor."""

    _fields_ = [(name, ctypes.c_double) for name in ("kp", "kd", "position", "velocity", "torque", "limit")]


class RotorRow(ctypes.Structure):
    """See ``motor.Motor``."""

    _fields_ = [
        *((name, ctypes.c_double) for name in ("theta", "omega", "torque", "velocity", "heat")),
        *((name, ctypes.c_double) for name in ("inertia", "viscous", "coulomb", "gain", "step", "lag", "velocity_lag")),
        *((name, ctypes.c_double) for name in ("load", "angle", "command", "drag", "stiff")),
        *((name, ctypes.c_int64) for name in ("waits", "faulty")),
        ("law", ServoRow),
    ]


class RopeRow(ctypes.Structure):
    """See ``tendon.Tendon``."""

    _fields_ = [
        *((name, ctypes.c_double) for name in ("tension", "speed", "slope", "longer")),
        *((name, ctypes.c_double) for name in ("radius", "stiffness", "beyond", "knee", "knee_stretch", "knee_width")),
        *((name, ctypes.c_double) for name in ("damping", "friction", "wrap")),
        *((name, ctypes.c_int64) for name in ("motor", "first", "end")),
    ]
