"""Temperatures of a drive: winding and MOSFETs, each a heat capacity that cools to ambient."""

import ctypes
import math

AMBIENT_C = 25.0
"""Ambient temperature [degC]."""
PHASE_RESISTANCE_OHM = 0.6
"""Resistance of the whole current path [ohm], an assumption: 0.55 N m = 2.1 A dissipate 2.7 W."""
WINDING_K_PER_W = 8.0
"""Thermal resistance of the winding [K/W], an assumption for a 40 mm actuator."""
WINDING_S = 120.0
"""Thermal time constant of the winding [s], an assumption for a 40 mm actuator."""
MOSFET_K_PER_W = 2.0
"""Thermal resistance of the MOSFETs [K/W], an assumption for a 40 mm actuator."""
MOSFET_S = 20.0
"""Thermal time constant of the MOSFETs [s], an assumption for a 40 mm actuator."""


class Thermal:
    """Temperatures of a drive.

    Attributes:
        winding: temperature of the winding [degC].
        mosfet: temperature of the MOSFETs [degC].
        forced: winding temperature imposed by a fault [degC], None without.
    """

    def __init__(self, torque_constant: float) -> None:
        """Start at ambient temperature.

        Args:
            torque_constant: torque constant [N m/A].
        """
        self.winding = self.mosfet = AMBIENT_C
        self.forced: float | None = None
        self._ohm_per_kt2 = PHASE_RESISTANCE_OHM / torque_constant**2

    def advance(self, elapsed_s: float, torque_squared: float) -> None:
        """Integrate the temperatures.

        Args:
            elapsed_s: elapsed time [s].
            torque_squared: integral of the squared torque over this time [N2 m2 s].
        """
        if elapsed_s <= 0.0:
            return
        # Mean copper loss: current squared times resistance, with current = torque / torque
        # constant.
        watt = torque_squared / elapsed_s * self._ohm_per_kt2
        self.winding = _low_pass(self.winding, AMBIENT_C + WINDING_K_PER_W * watt, elapsed_s / WINDING_S)
        if self.forced is not None:
            self.winding = self.forced
        self.mosfet = _low_pass(self.mosfet, AMBIENT_C + MOSFET_K_PER_W * watt, elapsed_s / MOSFET_S)


class ThermalStruct(ctypes.Structure, Thermal):
    """Temperatures in the memory of a drive."""

    _fields_ = [(name, ctypes.c_double) for name in ("winding", "mosfet")]


def _low_pass(value: float, target: float, times: float) -> float:
    """Move a value towards a target by a first-order lag, for a time in time constants."""
    return target + (value - target) * math.exp(-times)
