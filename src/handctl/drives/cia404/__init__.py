"""Measuring amplifiers for load cells over CANopen, with the device profile CiA 404."""
