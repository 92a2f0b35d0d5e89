"""Registers of a Damiao motor: numbers (uint32 or float32) in working memory, with a copy in flash memory.

Source: fact sheet mit_damiao.
"""

import math
import struct

from firmware_sim.description.hand_description import MotorSpec

KT = 1
"""Register: torque constant [N m/A]."""
OVER_TEMPERATURE = 2
"""Register: temperature limit of the winding [degC]."""
OVER_CURRENT = 3
"""Register: current limit as a fraction."""
ACCELERATION = 4
"""Register: acceleration of the ramps in position-velocity and velocity mode [rad/s2], 0 for no ramp."""
DECELERATION = 5
"""Register: deceleration of the ramps in position-velocity and velocity mode, negative [rad/s2], 0 for no ramp."""
MAX_SPEED = 6
"""Register: largest speed in all modes except MIT mode [rad/s]."""
MST_ID = 7
"""Register: identifier of the motor's answers."""
ESC_ID = 8
"""Register: identifier of commands to the motor."""
TIMEOUT = 9
"""Register: timeout of the watchdog in units of 50 us, 0 to switch the watchdog off."""
CTRL_MODE = 10
"""Register: control mode."""
GEAR_RATIO = 20
"""Register: ratio of the gear, revolutions of the motor per revolution of the output shaft."""
PMAX = 21
"""Register: largest position in frames [rad]."""
VMAX = 22
"""Register: largest velocity in frames [rad/s]."""
TMAX = 23
"""Register: largest torque in frames [N m]."""
VBUS = 60
"""Register: measured supply voltage [V]."""
BOARD_TEMPERATURE = 61
"""Register: measured temperature of the MOSFETs [degC]."""
WINDING_TEMPERATURE = 62
"""Register: measured temperature of the winding [degC]."""
MOTOR_POSITION = 80
"""Register: measured angle of the motor [rad]."""
OUTPUT_POSITION = 81
"""Register: measured angle of the output shaft [rad]."""

DM4310_GEAR_RATIO = 10.0
"""Gear ratio of a DM-J4310.

All MIT motors of a hand have the gear ratio of a DM-J4310, because the hand file does not name the
motor type.
"""
_UINT_REGISTERS = {7, 8, 9, 10, 13, 14, 15, 16, 35, 36}
"""Registers of type uint32. All other registers are float32."""
_READ_ONLY_REGISTERS = {
    11,
    12,
    13,
    14,
    15,
    16,
    17,
    18,
    19,
    20,
    36,
    *range(50, 56),
    60,
    61,
    62,
    80,
    81,
}
_POSITIVE_REGISTERS = {KT, OVER_TEMPERATURE, ACCELERATION, MAX_SPEED, PMAX, VMAX, TMAX}
"""Registers to which only positive values can be written."""
MODE_MIT, MODE_POSITION, MODE_VELOCITY, MODE_FORCE = range(1, 5)
"""Values of the register CTRL_MODE: MIT, position-velocity, velocity and force-position mode."""


class MitRegisters:
    """The registers of one motor.

    A value that a host writes to a register acts at once, but is lost at power-off unless the host
    saves the registers.
    """

    def __init__(self, spec: MotorSpec) -> None:
        """Set the registers to the values of a commissioned motor whose watchdog (register TIMEOUT) is off."""
        self._values: dict[int, float] = _factory_values(spec)
        self._flash = self._values.copy()

    def __contains__(self, register: int) -> bool:
        """Check whether a register exists."""
        return register in self._values

    def __getitem__(self, register: int) -> float:
        """Return the value of a register."""
        return self._values[register]

    def set_measured(self, register: int, value: float) -> None:
        """Set a register from inside the drive, for example to a measured value."""
        self._values[register] = value

    def read(self, register: int) -> bytes:
        """Return the value of a register as four bytes."""
        value = self._values[register]
        return (
            struct.pack("<I", int(value))
            if register in _UINT_REGISTERS
            else struct.pack("<f", value)
        )

    def write(self, register: int, value_bytes: bytes) -> None:
        """Write the four bytes of a value, as received in a frame, to a register.

        The function ignores impossible values, and values for read-only registers.
        """
        value = float(struct.unpack("<I" if register in _UINT_REGISTERS else "<f", value_bytes)[0])
        if register not in _READ_ONLY_REGISTERS and _is_value_possible(register, value):
            self._values[register] = value

    def save(self) -> None:
        """Copy the registers from the working memory to the flash memory."""
        self._flash = self._values.copy()

    def power_cycle(self) -> None:
        """Restore the saved values of all registers."""
        self._values = self._flash.copy()


def _is_value_possible(register: int, value: float) -> bool:
    """Return True if a register accepts a value."""
    if register == CTRL_MODE:
        return MODE_MIT <= value <= MODE_FORCE
    if register in (MST_ID, ESC_ID):
        return 0 <= value < 0x7FF
    if register == DECELERATION:
        return -math.inf < value < 0.0
    # Register 35 contains the code of the bus's bit rate.
    if register == 35:
        return value <= 11
    return math.isfinite(value) and (value > 0 or register not in _POSITIVE_REGISTERS)


def _factory_values(spec: MotorSpec) -> dict[int, float]:
    """Return the register values of a commissioned motor."""
    # The default serial number consists of the ASCII text "SIM" and the node number.
    serial = 0x5349_4D00 + spec.node_id if spec.serial is None else spec.serial
    values: dict[int, float] = dict.fromkeys(
        (*range(24, 29), *range(31, 35), *range(50, 56), 4, 5, 18, 19), 0.0
    )
    values[MAX_SPEED] = spec.velocity_range
    values.update({0: 15.0, KT: spec.torque_constant, OVER_TEMPERATURE: 100.0, OVER_CURRENT: 0.98})
    values.update({MST_ID: spec.options.get("reply_id", spec.node_id + 0x10), ESC_ID: spec.node_id})
    values.update({TIMEOUT: 0, CTRL_MODE: MODE_MIT, 11: spec.viscous, 12: spec.inertia})
    values.update({13: 0x0001_0003, 14: 0x0001_0501, 15: serial, 16: 14})
    values.update(
        {
            17: 0.6,
            GEAR_RATIO: spec.options.get("gear_ratio", DM4310_GEAR_RATIO),
            PMAX: spec.position_range,
            VMAX: spec.velocity_range,
            TMAX: spec.torque_max,
        }
    )
    values.update({29: 32.0, 30: 0.8, 35: 9 if spec.options.get("fd") else 4, 36: 1})
    values.update({VBUS: 24.0, BOARD_TEMPERATURE: 25.0, WINDING_TEMPERATURE: 25.0})
    values.update({MOTOR_POSITION: 0.0, OUTPUT_POSITION: 0.0})
    return values
