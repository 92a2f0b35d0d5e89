"""Fault campaign: the fault matrix is run on a simulated hand in lockstep."""
