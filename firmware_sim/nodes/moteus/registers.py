"""Registers of a moteus controller: their numbers, quantities and access.

Source: docs/facts/moteus.md.
"""

from collections.abc import Mapping

from firmware_sim.nodes.moteus import multiplex as mp

MODE = 0x000
POSITION = 0x020
VELOCITY = 0x021
FEEDFORWARD = 0x022
KP_SCALE = 0x023
KD_SCALE = 0x024
MAX_TORQUE = 0x025
TIMEOUT = 0x027
INTEGRATOR_SCALE = 0x02B
IGNORE_POSITION_BOUNDS = 0x02D
LOWER_BOUND = 0x040
UPPER_BOUND = 0x041
MULTIPLEX_ID = 0x110
SET_OUTPUT_NEAREST = 0x130
SET_OUTPUT_EXACT = 0x131
RECAPTURE_POSITION = 0x133
UUID = 0x150
UUID_MASK = 0x154

# Error numbers with which the drive refuses access to a register.
UNKNOWN_REGISTER_ERROR = 1
NOT_WRITEABLE_ERROR = 2
INVALID_VALUE_ERROR = 3

LSB_BY_MEASURED_REGISTER: Mapping[int, tuple[float, float, float]] = {
    0x001: mp.POSITION_LSB, 0x002: mp.VELOCITY_LSB, 0x003: mp.TORQUE_LSB,
    0x004: mp.CURRENT_LSB, 0x005: mp.CURRENT_LSB,
    0x006: mp.POSITION_LSB, 0x007: mp.POWER_LSB, 0x00A: mp.TEMPERATURE_LSB,
    0x00B: mp.UNSCALED_LSB, 0x00C: mp.UNSCALED_LSB,
    0x00D: mp.VOLTAGE_LSB, 0x00E: mp.TEMPERATURE_LSB, 0x00F: mp.UNSCALED_LSB,
    0x030: mp.TORQUE_LSB, 0x031: mp.TORQUE_LSB, 0x032: mp.TORQUE_LSB, 0x033: mp.TORQUE_LSB,
    0x034: mp.TORQUE_LSB,
    0x038: mp.POSITION_LSB, 0x039: mp.VELOCITY_LSB, 0x03A: mp.TORQUE_LSB,
    0x03B: mp.POSITION_LSB, 0x03C: mp.VELOCITY_LSB, 0x03D: mp.TORQUE_LSB,
    0x050: mp.POSITION_LSB, 0x051: mp.VELOCITY_LSB, 0x070: mp.UNSCALED_LSB,
}  # fmt: skip
"""Value of one integer step as int8, int16 and int32, for each read-only register."""
LSB_BY_COMMAND_REGISTER: Mapping[int, tuple[float, float, float]] = {
    POSITION: mp.POSITION_LSB, VELOCITY: mp.VELOCITY_LSB, FEEDFORWARD: mp.TORQUE_LSB,
    KP_SCALE: mp.FRACTION_LSB, KD_SCALE: mp.FRACTION_LSB,
    MAX_TORQUE: mp.TORQUE_LSB, 0x026: mp.POSITION_LSB, TIMEOUT: mp.TIME_LSB,
    0x028: mp.VELOCITY_LSB, 0x029: mp.ACCELERATION_LSB,
    0x02A: mp.VOLTAGE_LSB, INTEGRATOR_SCALE: mp.FRACTION_LSB, 0x02C: mp.CURRENT_LSB,
    IGNORE_POSITION_BOUNDS: mp.UNSCALED_LSB,
    LOWER_BOUND: mp.POSITION_LSB, UPPER_BOUND: mp.POSITION_LSB, 0x01C: mp.CURRENT_LSB, 0x01D: mp.CURRENT_LSB,
}  # fmt: skip
"""Value of one integer step as int8, int16 and int32, for each command register.

A write of the mode register resets the command registers to ``REGISTER_DEFAULTS``.
"""
COMMAND_REGISTER_BY_ALIAS = {
    0x042: FEEDFORWARD, 0x043: KP_SCALE, 0x044: KD_SCALE, 0x045: MAX_TORQUE, 0x046: TIMEOUT, 0x047: INTEGRATOR_SCALE,
    0x048: IGNORE_POSITION_BOUNDS,
}  # fmt: skip
"""Command register for each alias, a second register number that the mode *stay within* uses."""
NAN = float("nan")
REGISTER_DEFAULTS: Mapping[int, float] = {
    **dict.fromkeys(LSB_BY_COMMAND_REGISTER, 0.0), KP_SCALE: 1.0, KD_SCALE: 1.0, INTEGRATOR_SCALE: 1.0,
    MAX_TORQUE: NAN, 0x026: NAN,
    0x028: NAN, 0x029: NAN, 0x02A: NAN, 0x02C: NAN, LOWER_BOUND: NAN, UPPER_BOUND: NAN,
}  # fmt: skip
"""Values of the command registers after a write of the mode register."""
