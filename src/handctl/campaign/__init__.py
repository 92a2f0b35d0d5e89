"""Fault campaign: the whole fault matrix against a simulated hand in lockstep."""
