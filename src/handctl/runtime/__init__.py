"""Execution of the controller: clocks, buses, the loop at a fixed rate, and requests from other processes."""
