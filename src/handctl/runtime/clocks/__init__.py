"""Clocks of a run: real time, a clock shared with a simulator, and virtual time."""
