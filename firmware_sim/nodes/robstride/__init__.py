"""Simulated RobStride motors."""
