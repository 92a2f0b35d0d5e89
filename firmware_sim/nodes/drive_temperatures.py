"""Temperatures of the winding and the MOSFETs of a drive.

The model treats the winding and the MOSFETs as two separate bodies. Each body has a heat capacity,
and loses heat to the surroundings.
"""

import ctypes
import math

AMBIENT_C = 25.0
"""Ambient temperature [degC]."""
PHASE_RESISTANCE_OHM = 0.6
"""Resistance of the whole current path [ohm].

The value of the resistance is assumed. At a current of 2.1 A (torque of 0.55 N m), the current path
dissipates 2.7 W.
"""
WINDING_K_PER_W = 8.0
"""Thermal resistance of the winding, assumed for an actuator of 40 mm [K/W]."""
WINDING_TIME_CONSTANT_S = 120.0
"""Thermal time constant of the winding, assumed for an actuator of 40 mm [s]."""
MOSFET_K_PER_W = 2.0
"""Thermal resistance of the MOSFETs, assumed for an actuator of 40 mm [K/W]."""
MOSFET_TIME_CONSTANT_S = 20.0
"""Thermal time constant of the MOSFETs, assumed for an actuator of 40 mm [s]."""


class DriveTemperatures:
    """Temperatures of a drive.

    Attributes:
        winding: temperature of the winding [degC].
        mosfet: temperature of the MOSFETs [degC].
        forced: winding temperature that a fault imposes [degC]. None without a fault.
    """

    def __init__(self, torque_constant: float) -> None:
        """Set the winding and the MOSFETs to ambient temperature.

        Args:
            torque_constant: torque constant of the motor [N m/A].
        """
        self.winding = self.mosfet = AMBIENT_C
        self.forced: float | None = None
        self._ohm_per_kt2 = PHASE_RESISTANCE_OHM / torque_constant**2

    def advance(self, elapsed_s: float, torque_squared: float) -> None:
        """Advance the temperatures by an elapsed time.

        Args:
            elapsed_s: elapsed time [s].
            torque_squared: integral of the squared torque over the elapsed time [N2 m2 s].
        """
        if elapsed_s <= 0.0:
            return
        # The mean copper loss is the square of the current times the resistance. The current is the
        # torque divided by the torque constant.
        watt = torque_squared / elapsed_s * self._ohm_per_kt2
        self.winding = _low_pass_value(
            self.winding, AMBIENT_C + WINDING_K_PER_W * watt, elapsed_s / WINDING_TIME_CONSTANT_S
        )
        if self.forced is not None:
            self.winding = self.forced
        self.mosfet = _low_pass_value(
            self.mosfet, AMBIENT_C + MOSFET_K_PER_W * watt, elapsed_s / MOSFET_TIME_CONSTANT_S
        )


class ThermalStruct(ctypes.Structure, DriveTemperatures):
    """Temperatures of a drive, which are stored in the array row of the drive."""

    _fields_ = [(name, ctypes.c_double) for name in ("winding", "mosfet")]


def _low_pass_value(value: float, target_value: float, time_constants: float) -> float:
    """Move a value towards a target, as a first-order lag does.

    The elapsed time is given as a number of time constants.
    """
    return target_value + (value - target_value) * math.exp(-time_constants)
