"""Buses of the simulator: local hubs, Linux CAN interfaces, and local buses whose frames take time on the wire."""
