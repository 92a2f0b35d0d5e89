"""Temperatures of a drive: winding and MOSFETs, each one heat capacity that cools to the room."""

import ctypes
import math

ROOM_C = 25.0
PHASE_RESISTANCE_OHM = 0.6
"""Of the whole current path, an assumption: 0.55 N m = 2.1 A make 2.7 W."""
WINDING_K_PER_W, WINDING_S = 8.0, 120.0
MOSFET_K_PER_W, MOSFET_S = 2.0, 20.0
"""Thermal resistances and time constants, assumptions for a 40 mm actuator."""


class Thermal:
    """Attributes: winding, mosfet: temperatures [degC]. held: what a fault holds the winding at [degC]."""

    def __init__(self, torque_constant: float) -> None:
        """Args: torque constant [N m/A]."""
        self.winding = self.mosfet = ROOM_C
        self.held: float | None = None
        self._ohm_per_kt2 = PHASE_RESISTANCE_OHM / torque_constant**2

    def advance(self, elapsed_s: float, torque_squared: float) -> None:
        """Warm up or cool down.

        Args:
            elapsed_s: [s].
            torque_squared: integral of the torque squared over that time [N2 m2 s].
        """
        if elapsed_s <= 0.0:
            return
        watt = torque_squared / elapsed_s * self._ohm_per_kt2
        self.winding = _towards(self.winding, ROOM_C + WINDING_K_PER_W * watt, elapsed_s / WINDING_S)
        if self.held is not None:
            self.winding = self.held
        self.mosfet = _towards(self.mosfet, ROOM_C + MOSFET_K_PER_W * watt, elapsed_s / MOSFET_S)


class ThermalRow(ctypes.Structure, Thermal):
    """Temperatures in a row of a drive."""

    _fields_ = [(name, ctypes.c_double) for name in ("winding", "mosfet")]


def _towards(value: float, goal: float, times: float) -> float:
    return goal + (value - goal) * math.exp(-times)
