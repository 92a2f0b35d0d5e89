"""Registers of a Damiao motor: uint32 or float32, in RAM with a copy in flash. Source: facts, mit_damiao."""

import math
import struct

from firmware_sim.description import MotorSpec

KT, OVER_TEMPERATURE, OVER_CURRENT = 1, 2, 3
MST_ID, ESC_ID, TIMEOUT, CTRL_MODE = 7, 8, 9, 10
PMAX, VMAX, TMAX = 21, 22, 23
VBUS, T_BOARD, T_MOTOR, MOTOR_POSITION, OUTPUT_POSITION = 60, 61, 62, 80, 81

_UINT = {7, 8, 9, 10, 13, 14, 15, 16, 35, 36}
_READ_ONLY = {11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 36, *range(50, 56), 60, 61, 62, 80, 81}
_POSITIVE = {KT, OVER_TEMPERATURE, PMAX, VMAX, TMAX}
MODE_MIT = 1


class Registers:
    """The register file of one motor; a write acts at once and is lost at power-off unless saved."""

    def __init__(self, spec: MotorSpec) -> None:
        """Fill the registers as a commissioned motor has them; its watchdog (TIMEOUT) is off."""
        self._values: dict[int, float] = _factory(spec)
        self._flash = self._values.copy()

    def __contains__(self, register: int) -> bool:
        return register in self._values

    def __getitem__(self, register: int) -> float:
        return self._values[register]

    def show(self, register: int, value: float) -> None:
        """Set a register from the inside: a measurement."""
        self._values[register] = value

    def read(self, register: int) -> bytes:
        """Return a register's four bytes."""
        value = self._values[register]
        return struct.pack("<I", int(value)) if register in _UINT else struct.pack("<f", value)

    def write(self, register: int, raw: bytes) -> None:
        """Take four bytes from the wire; a read-only register or an impossible value leaves all as it was."""
        value = float(struct.unpack("<I" if register in _UINT else "<f", raw)[0])
        if register not in _READ_ONLY and _possible(register, value):
            self._values[register] = value

    def save(self) -> None:
        """Copy RAM to flash."""
        self._flash = self._values.copy()

    def power_cycle(self) -> None:
        """Fall back to what was saved."""
        self._values = self._flash.copy()


def _possible(register: int, value: float) -> bool:
    if register == CTRL_MODE:
        return value == MODE_MIT  # the only mode simulated
    if register in (MST_ID, ESC_ID):
        return 0 <= value < 0x7FF
    if register == 35:
        return value <= 11
    return math.isfinite(value) and (value > 0 or register not in _POSITIVE)


def _factory(spec: MotorSpec) -> dict[int, float]:
    serial = 0x5349_4D00 + spec.node_id if spec.serial is None else spec.serial
    values: dict[int, float] = dict.fromkeys((*range(24, 29), *range(31, 35), *range(50, 56), 4, 5, 6, 18, 19), 0.0)
    values.update({0: 15.0, KT: spec.torque_constant, OVER_TEMPERATURE: 100.0, OVER_CURRENT: 0.98})
    values.update({MST_ID: spec.options.get("reply_id", spec.node_id + 0x10), ESC_ID: spec.node_id})
    values.update({TIMEOUT: 0, CTRL_MODE: MODE_MIT, 11: spec.viscous, 12: spec.inertia})
    values.update({13: 0x0001_0003, 14: 0x0001_0501, 15: serial, 16: 14})
    values.update({17: 0.6, 20: 16.0, PMAX: spec.position_range, VMAX: spec.velocity_range, TMAX: spec.torque_max})
    values.update({29: 32.0, 30: 0.8, 35: 9 if spec.options.get("fd") else 4, 36: 1})
    values.update({VBUS: 24.0, T_BOARD: 25.0, T_MOTOR: 25.0})
    values.update({MOTOR_POSITION: 0.0, OUTPUT_POSITION: 0.0})
    return values
