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
IGNORE_BOUNDS = 0x02D
LOWER_BOUND = 0x040
UPPER_BOUND = 0x041
MULTIPLEX_ID = 0x110
SET_NEAREST = 0x130
SET_EXACT = 0x131
RECAPTURE = 0x133
UUID = 0x150
UUID_MASK = 0x154

# Error numbers with which the drive refuses access to a register.
UNKNOWN_REGISTER_ERROR = 1
NOT_WRITEABLE_ERROR = 2
INVALID_VALUE_ERROR = 3

MEASURED_REGISTER_STEPS: Mapping[int, tuple[float, float, float]] = {
    0x001: mp.POSITION, 0x002: mp.VELOCITY, 0x003: mp.TORQUE, 0x004: mp.CURRENT, 0x005: mp.CURRENT,
    0x006: mp.POSITION, 0x007: mp.POWER, 0x00A: mp.TEMPERATURE, 0x00B: mp.PLAIN, 0x00C: mp.PLAIN,
    0x00D: mp.VOLTAGE, 0x00E: mp.TEMPERATURE, 0x00F: mp.PLAIN,
    0x030: mp.TORQUE, 0x031: mp.TORQUE, 0x032: mp.TORQUE, 0x033: mp.TORQUE, 0x034: mp.TORQUE,
    0x038: mp.POSITION, 0x039: mp.VELOCITY, 0x03A: mp.TORQUE, 0x03B: mp.POSITION, 0x03C: mp.VELOCITY, 0x03D: mp.TORQUE,
    0x050: mp.POSITION, 0x051: mp.VELOCITY, 0x070: mp.PLAIN,
}  # fmt: skip
"""Read-only registers with the values of one integer step."""
COMMAND_REGISTER_STEPS: Mapping[int, tuple[float, float, float]] = {
    POSITION: mp.POSITION, VELOCITY: mp.VELOCITY, FEEDFORWARD: mp.TORQUE, KP_SCALE: mp.FRACTION, KD_SCALE: mp.FRACTION,
    MAX_TORQUE: mp.TORQUE, 0x026: mp.POSITION, TIMEOUT: mp.TIME, 0x028: mp.VELOCITY, 0x029: mp.ACCELERATION,
    0x02A: mp.VOLTAGE, INTEGRATOR_SCALE: mp.FRACTION, 0x02C: mp.CURRENT, IGNORE_BOUNDS: mp.PLAIN,
    LOWER_BOUND: mp.POSITION, UPPER_BOUND: mp.POSITION, 0x01C: mp.CURRENT, 0x01D: mp.CURRENT,
}  # fmt: skip
"""Registers of a command with the values of one integer step.

A write of the mode resets these registers to ``REGISTER_DEFAULTS``.
"""
SHADOW_REGISTERS = {
    0x042: FEEDFORWARD, 0x043: KP_SCALE, 0x044: KD_SCALE, 0x045: MAX_TORQUE, 0x046: TIMEOUT, 0x047: INTEGRATOR_SCALE,
    0x048: IGNORE_BOUNDS,
}  # fmt: skip
"""Second register numbers of command registers, for the mode *stay within*."""
NAN = float("nan")
REGISTER_DEFAULTS: Mapping[int, float] = {
    **dict.fromkeys(COMMAND_REGISTER_STEPS, 0.0), KP_SCALE: 1.0, KD_SCALE: 1.0, INTEGRATOR_SCALE: 1.0,
    MAX_TORQUE: NAN, 0x026: NAN,
    0x028: NAN, 0x029: NAN, 0x02A: NAN, 0x02C: NAN, LOWER_BOUND: NAN, UPPER_BOUND: NAN,
}  # fmt: skip
"""Values of the command registers after a write of the mode."""
