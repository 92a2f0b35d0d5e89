"""Buses of the simulator: local hubs, Linux CAN interfaces, and wires whose frames take their time."""
