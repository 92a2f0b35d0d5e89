"""C structures with the state of tendons and rotors, which compiled kernels read and write.

Kernels that run as interpreted Python accept any object with the attributes of a structure.
"""

import ctypes
from dataclasses import dataclass


@dataclass
class Servo:
    """Setpoints and gains of the servo in a drive, with the signs of the hand: a positive torque winds the tendon up.

    The servo commands the torque kp (position - theta) + kd (velocity - omega) + torque, limited to
    +-limit.

    Attributes:
        kp: stiffness towards the position setpoint [N m/rad].
        kd: damping towards the velocity setpoint [N m s/rad].
        position: position setpoint [rad].
        velocity: velocity setpoint [rad/s].
        torque: feedforward torque [N m].
        limit: torque limit of the drive [N m].
        speed_limit: speed above which the drive brakes [rad/s].
        speed_gain: ratio of the braking torque to the speed above ``speed_limit`` [N m s/rad]. The
            ratio is 0 if there is no speed limit.
        target_speed: speed with which the drive itself moves the position setpoint [rad/s].
    """

    kp: float = 0.0
    kd: float = 0.0
    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0
    limit: float = 0.0
    speed_limit: float = 0.0
    speed_gain: float = 0.0
    target_speed: float = 0.0

    def release(self) -> None:
        """Set gains and setpoints to zero, so that the motor turns freely."""
        self.kp = self.kd = self.position = self.velocity = self.torque = self.speed_gain = 0.0
        self.target_speed = 0.0


class ServoStruct(ctypes.Structure, Servo):
    """Memory layout of the state of a servo, a field of ``RotorStruct``."""

    _fields_ = [
        (name, ctypes.c_double)
        for name in (
            "kp",
            "kd",
            "position",
            "velocity",
            "torque",
            "limit",
            "speed_limit",
            "speed_gain",
            "target_speed",
        )
    ]


class RotorStruct(ctypes.Structure):
    """Memory layout of the state of a rotor, for compiled kernels.

    The class ``motor.Motor`` explains the fields.
    """

    _fields_ = [
        *((name, ctypes.c_double) for name in ("theta", "omega", "torque", "velocity", "heat")),
        *(
            (name, ctypes.c_double)
            for name in ("inertia", "viscous", "coulomb", "gain", "step", "lag", "velocity_lag")
        ),
        *((name, ctypes.c_double) for name in ("load", "angle", "command", "drag", "impedance")),
        *((name, ctypes.c_double) for name in ("top_speed", "stall_torque")),
        *((name, ctypes.c_int64) for name in ("steps_alone", "faulty")),
        ("own_servo", ServoStruct),
    ]


class TendonStruct(ctypes.Structure):
    """Memory layout of the state of a tendon, for compiled kernels.

    The class ``tendon.Tendon`` explains the fields.
    """

    _fields_ = [
        *((name, ctypes.c_double) for name in ("tension", "speed", "slope", "extra_length")),
        *(
            (name, ctypes.c_double)
            for name in ("radius", "stiffness", "after_knee", "knee", "knee_stretch", "knee_width")
        ),
        *((name, ctypes.c_double) for name in ("damping", "friction", "wrap")),
        *((name, ctypes.c_int64) for name in ("motor", "first", "end")),
    ]
