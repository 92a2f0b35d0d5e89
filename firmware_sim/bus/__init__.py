"""Buses of the simulator: local buses, CAN interfaces of Linux, and local buses with simulated transmission times."""
