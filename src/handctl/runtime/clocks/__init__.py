"""Clocks of a run: real time, a real-time clock shared with a simulator, and the virtual time of lockstep."""
