"""Clocks of a run: real time, a real-time clock that a simulator shares, and the virtual time of lockstep."""
