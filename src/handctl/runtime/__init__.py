"""Execution of the controller: clocks, CAN buses, the control loop, and requests from other processes."""
