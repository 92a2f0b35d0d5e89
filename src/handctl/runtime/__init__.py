"""Clocks, buses, the fixed-rate loop, and requests from other processes."""
