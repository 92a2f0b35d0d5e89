"""Buses of the simulator: local hubs, Linux CAN interfaces, and local buses with simulated times on the wire."""
