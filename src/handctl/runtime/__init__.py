"""Execution of the controller: clocks, CAN buses, control loop, and requests from other processes."""
